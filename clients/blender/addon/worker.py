"""The threads that talk to the service. They know nothing of Blender: what they find they put into a queue."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from .coordinates import loop_coordinates, page_coordinates
from .core.decode import decode
from .core.edits import Edit, Insert
from .core.flows import SceneFlows, ServiceFlows
from .core.jobs import EventFlows, JobFlows
from .core.models import Atlas, JobInfo, SceneInfo
from .core.problems import RebakeError
from .core.sse import Event
from .core.steps import Enough, Item, Patience, Stream, for_each
from .core.uploads import Upload
from .http import Driver, Stopped
from .send import Corners

PATIENCE = Patience(10)


@dataclass(frozen=True)
class Uploaded:
    """The service has the scene."""

    scene: SceneInfo


@dataclass(frozen=True)
class Progress:
    """A job of the scene is as far as this."""

    job: JobInfo


@dataclass(frozen=True)
class Light:
    """A version of the light map: pages of the atlas as files, and coordinates by name of the objects that had none
    yet; None for what cannot have any."""

    version: int
    stated_error: float | None
    atlas: Atlas
    pages: list[str]
    coordinates: dict[str, np.ndarray | None]


@dataclass(frozen=True)
class Accepted:
    """An edit was accepted; this job lights it."""

    job: JobInfo


@dataclass(frozen=True)
class Failed:
    """The service, or the way to it, did not do something. `is_over`: nothing more will come."""

    why: str
    is_over: bool


class Worker:
    """One scene at a service. Methods are called from Blender's thread, and return at once."""

    def __init__(self, server: str, token: str | None, samples: int) -> None:
        self.messages: SimpleQueue[Any] = SimpleQueue()
        #: Samples per element of updates.
        self.samples = samples
        self._address = server, token
        self._scene: SceneFlows | None = None
        #: Triangles of the objects, by the names that the service has for them.
        self._corners: dict[str, Corners | None] = {}
        self._placed: set[str] = set()
        self._outbox: SimpleQueue[tuple[list[Edit], dict[str, bytes]] | None] = SimpleQueue()
        self._watcher = Driver(server, token)
        self._sender = Driver(server, token)
        self._folder = tempfile.TemporaryDirectory(prefix="rebake-")
        self.is_sending = False

    def start(self, glb: bytes, settings: Upload, corners: dict[str, Corners | None]) -> None:
        """Uploads the scene, then follows its light."""
        self._corners.update(corners)
        self._thread(lambda: self._watch(glb, settings))

    def send(self, edits: list[Edit], assets: dict[str, bytes], corners: dict[str, Corners | None]) -> None:
        """Sends edits as one request. The `asset` of each insertion is a name in `assets`."""
        self._corners.update(corners)
        # What comes anew has coordinates anew.
        self._placed -= corners.keys()
        self.is_sending = True
        self._outbox.put((edits, assets))

    def cancel(self, job: str) -> None:
        """Cancels a job."""
        driver = Driver(*self._address)
        self._thread(lambda: self._try(lambda: driver.run(JobFlows(PATIENCE, job).cancel())))

    def stop(self) -> None:
        """Ends the threads. The scene stays at the service."""
        self._outbox.put(None)
        self._watcher.stop()
        self._sender.stop()

    def _thread(self, do: Callable[[], None]) -> None:
        threading.Thread(target=do, name="rebake", daemon=True).start()

    def _try(self, do: Callable[[], Any], is_over: bool = False) -> Any:
        try:
            return do()
        except Stopped:
            return None
        except RebakeError as error:
            self.messages.put(Failed(str(error), is_over))
        except Exception as error:  # Whatever it is, it is told: a thread that dies silently looks like a slow service.
            self.messages.put(Failed(f"{type(error).__name__}: {error}", is_over))
        return None

    def _watch(self, glb: bytes, settings: Upload) -> None:
        def watch() -> None:
            scene = self._watcher.run(ServiceFlows(PATIENCE).upload(glb, settings))
            self._scene = SceneFlows(PATIENCE, scene.id)
            self.messages.put(Uploaded(scene))
            self._thread(self._send)
            for message in self._watcher.items(self._light()):
                self.messages.put(message)

        self._try(watch, is_over=True)

    def _send(self) -> None:
        while (batch := self._outbox.get()) is not None:
            job = self._try(lambda: self._sender.run(self._edit(*batch)))
            self.is_sending = not self._outbox.empty()
            if job is not None:
                self.messages.put(Accepted(job))

    def _edit(self, edits: list[Edit], assets: dict[str, bytes]) -> Any:
        known = {}
        for name, glb in assets.items():
            known[name] = (yield from ServiceFlows(PATIENCE).add_asset(glb)).asset
        named = [replace(edit, asset=known[edit.asset]) if isinstance(edit, Insert) else edit for edit in edits]
        return (yield from self._scene.edit(*named, samples=self.samples))

    def _light(self) -> Stream[Progress | Light]:
        shown = 0

        def each(event: Event) -> Stream[Progress | Light]:
            nonlocal shown
            if event.name == "scene" and event.data["what"] == "deleted":
                raise Enough
            if event.name == "job":
                yield Item(Progress(decode(JobInfo, event.data)))
            elif event.name in ("snapshot", "scene_state", "reset") and event.data["version"] > shown:
                light = yield from self._fetch(event.data["version"], event.data.get("estimated_rmse"))
                shown = light.version
                yield Item(light)

        return for_each(EventFlows(PATIENCE, f"{self._scene.path}/events").events(), each)

    def _fetch(self, version: int, error: float | None) -> Any:
        """The pages as they are now: at this version or a newer one."""
        atlas = yield from self._scene.atlas()
        pages = []
        for page in range(len(atlas.pages)):
            path = Path(self._folder.name, f"{atlas.version}-{page}.exr")
            path.write_bytes((yield from self._scene.atlas_page(page)))
            pages.append(str(path))
        wanted = {place.object: place for place in atlas.objects if place.object not in self._placed}
        coordinates: dict[str, np.ndarray | None] = {}
        if wanted:
            theirs = page_coordinates((yield from self._scene.export("glb", layout="atlas")))
            for name, place in wanted.items():
                ours = self._corners.get(name)
                can = ours is not None and name in theirs
                coordinates[name] = loop_coordinates(theirs[name], place, ours) if can else None
            self._placed |= wanted.keys()
        return Light(max(version, atlas.version), error, atlas, pages, coordinates)
