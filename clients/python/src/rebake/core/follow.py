"""Following the light map of a scene: events tell of new versions, deltas between two versions bring them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .decode import decode
from .delta import LightMap, read_frames
from .flows import SceneFlows
from .jobs import EventFlows
from .models import JobInfo, SceneInfo
from .problems import Problem
from .sse import Event
from .steps import Enough, Flow, Item, Stream, for_each


def _nothing() -> NDArray[np.intp]:
    return np.zeros(0, np.intp)


@dataclass(frozen=True)
class Snapshot:
    """A consistent light map, as a scene has published it."""

    light_map: LightMap
    #: Elements that have another value than in the snapshot before.
    changed: NDArray[np.intp] = field(default_factory=_nothing)
    #: Area-weighted RMSE of the map, irradiance / π; none where the service states none, or old light may stand on new
    #: geometry.
    stated_error: float | None = None
    #: No job of the scene waits or runs: nothing better comes by itself.
    complete: bool = False
    #: Version at which elements, objects or lights last changed: fetch `Scene.elements` again where this did.
    elements_version: int = 0
    #: Accepted edits whose light is not in the map; above 0 in a complete snapshot where jobs failed or were canceled.
    unlit_edits: int = 0

    @property
    def version(self) -> int:
        """Version of the light map."""
        return self.light_map.version

    @property
    def values(self) -> NDArray[np.float32]:
        """The light map's values, (elements, 3), read-only."""
        return self.light_map.values


@dataclass
class Follower:
    """One client's copy of a scene's light map."""

    scene: SceneFlows
    light_map: LightMap

    def snapshots(self) -> Stream[Snapshot]:
        """Snapshots as they are published, until the scene is deleted. One that is known to be the last for now comes
        as `complete`, the same version a second time where it was given out before. Versions that were replaced by
        newer ones before they could be fetched are skipped."""
        yield from for_each(EventFlows(self.scene.patience, f"{self.scene.path}/events").events(), self._read)

    def _read(self, event: Event) -> Stream[Snapshot]:
        if event.name == "scene" and event.data["what"] == "deleted":
            raise Enough
        if event.name in ("scene_state", "reset"):
            yield from self._state(is_first=True)
        elif event.name == "job" and decode(JobInfo, event.data).has_ended:
            yield from self._state(is_first=False)
        elif event.name == "snapshot" and event.data["version"] > self.light_map.version:
            changed = yield from self._advance(event.data["version"])
            if changed is not None:
                # Without samples it is old light on new geometry: the service tells the error of before the edit.
                error = event.data.get("estimated_rmse") if event.data.get("samples_per_element") else None
                elements = event.data["elements_version"]
                yield Item(Snapshot(self.light_map, changed, error, elements_version=elements))

    def _state(self, is_first: bool) -> Stream[Snapshot]:
        """The scene as a whole: where following begins, and where work may be done."""
        asked: int | None = None
        while True:
            scene: SceneInfo = yield from self.scene.info()
            if scene.version < self.light_map.version or scene.version == asked:
                # Not the map that the copy was made of, or no more known to the service: begin anew.
                self.light_map = LightMap()
            asked = scene.version
            changed = yield from self._advance(scene.version)
            if changed is not None:
                break
        is_complete = scene.current_job is None
        if len(changed) or is_complete or (is_first and scene.version > 0):
            yield Item(
                Snapshot(
                    self.light_map,
                    changed,
                    scene.estimated_rmse if scene.unlit_edits == 0 else None,
                    is_complete,
                    scene.elements_version,
                    scene.unlit_edits,
                )
            )

    def _advance(self, version: int) -> Flow[NDArray[np.intp] | None]:
        """Brings the copy to a version; answers the elements that changed, none where that version is gone: a newer one
        is on its way."""
        before = self.light_map
        if version == before.version:
            return _nothing()
        try:
            response = yield from self.scene.get(f"/lightmap/deltas/{before.version}-{version}")
        except Problem as problem:
            if problem.kind == "version-forgotten":
                return None
            raise
        frames = read_frames(response.body)
        self.light_map = before.apply(frames)
        if any(frame.replaces for frame in frames):
            return np.arange(len(self.light_map), dtype=np.intp)
        return np.unique(np.concatenate([_nothing(), *(frame.indices for frame in frames)]))
