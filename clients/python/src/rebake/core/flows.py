"""Every call of the API as a flow, once for both kinds of client."""

from __future__ import annotations

import json
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar
from urllib.parse import quote

import numpy as np
from numpy.typing import ArrayLike

from . import models
from .decode import decode
from .delta import Elements, LightMap
from .edits import Edit, Redo, Undo, budget_json, edit_json
from .jobs import JobFlows
from .problems import Problem, RebakeError
from .steps import FIRST_WAIT, LONGEST_WAIT, Flow, Now, Patience, Request, Response, Sleep, call
from .tiles import AtlasPages, read_tiles
from .uploads import File, Upload, media_type, read_file, upload_query

T = TypeVar("T")
_JSON = {"content-type": "application/json"}


def _query(**values: Any) -> dict[str, str]:
    """A query of what is given."""
    return {name: str(value) for name, value in values.items() if value is not None}


def _body(value: Any) -> bytes:
    return json.dumps(value, allow_nan=False).encode()


@dataclass(frozen=True)
class ServiceFlows:
    """Calls that are about the service as a whole."""

    patience: Patience = field(default_factory=Patience)

    def request(self, method: str, path: str, /, **parts: Any) -> Flow[Response]:
        """Any call of the API, repeated as :func:`.steps.call` says where it is a GET."""
        return call(Request(method, path, **parts), self.patience, repeatable=method == "GET")

    def upload(self, file: File, settings: Upload) -> Flow[models.SceneInfo]:
        """Uploads a scene: binary glTF, or a zip archive of a `.gltf` with its files. Its bake starts at once. Answers
        when the scene is laid out: before, nothing is known of what is in it."""
        data = read_file(file)
        # With a key, what is sent again after a connection broke makes no second scene.
        headers = {"content-type": media_type(data), "idempotency-key": uuid.uuid4().hex}
        request = Request("POST", "/v1/scenes", upload_query(settings), headers, data)
        response = yield from call(request, self.patience)
        scene = decode(models.SceneInfo, response.json())
        pause = FIRST_WAIT
        while scene.state == "preparing":
            yield Sleep(pause)
            pause = min(1.5 * pause, LONGEST_WAIT)
            scene = yield from SceneFlows(self.patience, scene.id).info()
        return scene

    def plan(self, file: File, settings: Upload) -> Flow[models.ScenePlan]:
        """What a file would take with these settings: elements, memory, warnings. Keeps nothing."""
        data = read_file(file)
        query = {**upload_query(settings), "dry_run": "true"}
        request = Request("POST", "/v1/scenes", query, {"content-type": media_type(data)}, data)
        response = yield from call(request, self.patience)
        return decode(models.ScenePlan, response.json())

    def add_asset(self, file: File) -> Flow[models.Asset]:
        """Uploads what edits can insert, or a picture of the sky. The same bytes give the same id."""
        data = read_file(file)
        request = Request("POST", "/v1/assets", headers={"content-type": media_type(data)}, body=data)
        response = yield from call(request, self.patience)
        return decode(models.Asset, response.json())

    def delete_asset(self, asset: str) -> Flow[None]:
        """Deletes an asset that no scene needs."""
        yield from call(Request("DELETE", f"/v1/assets/{quote(asset, '')}"), self.patience)

    def assets(self) -> Flow[list[models.AssetSummary]]:
        """All assets, newest first."""
        return (yield from self.all_pages("/v1/assets", models.AssetSummary))

    def scenes(self) -> Flow[list[models.SceneSummary]]:
        """All scenes, newest first."""
        return (yield from self.all_pages("/v1/scenes", models.SceneSummary))

    def jobs(self, scene: str | None = None, state: str | None = None) -> Flow[list[models.JobInfo]]:
        """Jobs, newest first, of one scene or in one state where asked for. Finished ones are forgotten after a
        while."""
        return (yield from self.all_pages("/v1/jobs", models.JobInfo, **_query(scene=scene, state=state)))

    def is_ready(self) -> Flow[bool]:
        """Whether the service takes requests now."""
        try:
            yield from call(Request("GET", "/readyz"), Patience(0))
        except RebakeError:
            return False
        return True

    def all_pages(self, path: str, kind: type[T], **query: str) -> Flow[list[T]]:
        """The items of all pages of a list."""
        found: list[T] = []
        while True:
            response = yield from call(Request("GET", path, query), self.patience)
            page = response.json()
            found += [decode(kind, item) for item in page["items"]]
            if page.get("next_cursor") is None:
                return found
            query = {**query, "cursor": page["next_cursor"]}


@dataclass(frozen=True)
class SceneFlows:
    """Calls that are about one scene."""

    patience: Patience
    id: str

    @property
    def path(self) -> str:
        return f"/v1/scenes/{quote(self.id, '')}"

    def get(self, path: str = "", accept: str | None = None, **query: Any) -> Flow[Response]:
        headers = {"accept": accept} if accept else {}
        return call(Request("GET", self.path + path, _query(**query), headers), self.patience)

    def info(self) -> Flow[models.SceneInfo]:
        """The scene as it is now: objects, lights, version, stated error, current job."""
        response = yield from self.get()
        return decode(models.SceneInfo, response.json())

    def change(
        self,
        name: str | None = None,
        samples: int | None = None,
        max_seconds: float | None = None,
        target_rmse: float | None = None,
    ) -> Flow[models.SceneInfo]:
        """Changes its name or its target, towards which jobs go on or begin to. Does not wait for them."""
        target = budget_json(samples, max_seconds, target_rmse)
        patch = {**({"name": name} if name is not None else {}), **({"target": target} if target else {})}
        response = yield from call(Request("PATCH", self.path, headers=_JSON, body=_body(patch)), self.patience)
        return decode(models.SceneInfo, response.json())

    def bake(
        self,
        samples: int | None = None,
        max_seconds: float | None = None,
        target_rmse: float | None = None,
        timeout: float | None = None,
    ) -> Flow[models.SceneInfo]:
        """Bakes towards a target (where none is given, the one that the scene has) and waits until that is reached;
        answers the scene as it is then. Raises :class:`JobFailed`, and `TimeoutError` after `timeout` seconds."""
        if (samples, max_seconds, target_rmse) != (None, None, None):
            yield from self.change(None, samples, max_seconds, target_rmse)
        return (yield from self.wait(timeout))

    def wait(self, timeout: float | None = None) -> Flow[models.SceneInfo]:
        """Waits until no job of the scene waits or runs; answers the scene as it is then. Raises :class:`JobFailed`
        where one did not succeed, and `TimeoutError` after `timeout` seconds."""
        end = None if timeout is None else (yield Now()) + timeout
        while True:
            scene = yield from self.info()
            if scene.current_job is None:
                return scene
            left = None if end is None else max(end - (yield Now()), 0.0)
            yield from JobFlows(self.patience, scene.current_job).wait(left)

    def edit(
        self,
        *edits: Edit,
        samples: int | None = None,
        max_seconds: float | None = None,
        target_rmse: float | None = None,
        focus: Mapping[str, Any] | None = None,
        tiles: Mapping[str, Any] | None = None,
        priority: str | None = None,
        if_accepted: int | None = None,
        key: str | None = None,
    ) -> Flow[models.JobInfo]:
        """Edits the scene: all edits take effect or none. Answers the job that lights them; does not wait for it.

        `samples`, `max_seconds`, `target_rmse`: when that job stops. `focus`: what is lit first, as in the API
        (`{"point": [x, y, z], "radius": r}` or a camera). `if_accepted`: refuse with `precondition-failed` unless the
        scene has accepted exactly so many edits (`SceneInfo.accepted_edits`). `key`: makes the request safe to repeat;
        one is made where absent, so that a lost connection makes no edit twice.
        """
        more = {"focus": focus, "tiles": tiles, "priority": priority}
        request: dict[str, Any] = {name: value for name, value in more.items() if value is not None}
        if budget := budget_json(samples, max_seconds, target_rmse):
            request["budget"] = budget
        if len(edits) == 1:
            request.update(edit_json(edits[0]))
        else:
            request["edits"] = [edit_json(edit) for edit in edits]
        headers = {**_JSON, "idempotency-key": key or uuid.uuid4().hex}
        if if_accepted is not None:
            headers["if-match"] = f'"{if_accepted}"'
        post = Request("POST", f"{self.path}/edits", headers=headers, body=_body(request))
        response = yield from call(post, self.patience)
        return decode(models.JobInfo, response.json())

    def undo(self) -> Flow[models.JobInfo]:
        """Takes the last edit request back that counts."""
        return self.edit(Undo())

    def redo(self) -> Flow[models.JobInfo]:
        """Makes the last request again that was taken back."""
        return self.edit(Redo())

    def history(self) -> Flow[list[models.HistoryEntry]]:
        """All edit requests since the upload, newest last."""
        return (yield from ServiceFlows(self.patience).all_pages(f"{self.path}/edits", models.HistoryEntry))

    def jobs(self, state: str | None = None) -> Flow[list[models.JobInfo]]:
        """Its jobs, newest first."""
        return ServiceFlows(self.patience).jobs(self.id, state)

    def light_map(self, part: str | None = None, layer: str | None = None, filter: str | None = None) -> Flow[LightMap]:
        """The light map as it is now: one value per element. `part`: `full`, `direct`, `indirect` or `error` (the
        standard error of each element); the scene's mode where absent. `filter`: `statistical` averages noise away
        where the errors allow it."""
        response = yield from self.get("/lightmap", format="raw", part=part, layer=layer, filter=filter)
        return LightMap.read(response.body)

    def export(
        self, format: str, layout: str | None = None, part: str | None = None, layer: str | None = None
    ) -> Flow[bytes]:
        """The light map as a file: `exr`, `glb` (`layout`: `vertices` or `atlas`) or `raw`."""
        response = yield from self.get("/lightmap", format=format, layout=layout, part=part, layer=layer)
        return response.body

    def elements(self) -> Flow[Elements]:
        """Where every element of the light map is; fetch it again where `elements_version` has changed."""
        response = yield from self.get("/elements")
        return Elements.read(response.body)

    def object_file(self, name: str) -> Flow[bytes]:
        """One object as binary glTF: its mesh, and in scene 1 the mesh between its elements with their light."""
        response = yield from self.get(f"/objects/{quote(name, '')}", format="glb")
        return response.body

    def atlas(self) -> Flow[models.Atlas]:
        """Where objects lie on the pages of the atlas."""
        response = yield from self.get("/atlas")
        return decode(models.Atlas, response.json())

    def atlas_page(
        self,
        page: int,
        format: str = "exr",
        precision: str | None = None,
        part: str | None = None,
        layer: str | None = None,
    ) -> Flow[bytes]:
        """A page of the atlas as a file: OpenEXR (`precision`: `half` or `float`; :func:`rebake.exr.read` reads it) or
        `png`."""
        response = yield from self.get(f"/atlas/{page}", format=format, precision=precision, part=part, layer=layer)
        return response.body

    def atlas_pages(
        self,
        known: AtlasPages | None = None,
        precision: str | None = None,
        part: str | None = None,
        layer: str | None = None,
    ) -> Flow[AtlasPages]:
        """All pages of the atlas as arrays, up to date. Of pages that are known, from an earlier call with the same
        `precision` (`half` or `float`), `part` and `layer`, only tiles that changed are fetched."""
        known = known or AtlasPages()
        query = {"precision": precision, "part": part, "layer": layer}
        try:
            response = yield from self.get("/atlas/deltas", since=known.version, **query)
        except Problem as problem:
            if problem.kind != "version-ahead":
                raise
            # Another life of the service.
            known = AtlasPages()
            response = yield from self.get("/atlas/deltas", since=0, **query)
        return known.apply(read_tiles(response.body))

    def render(self, /, **query: Any) -> Flow[bytes]:
        """A picture of the scene as it is lit now, by default PNG. Takes what the API takes: `camera`, or `eye`,
        `target`, `up` (three numbers) and `fov_y`; `width`, `height`, `spp`, `view`, `format`, `exposure`, `tone`,
        …"""
        texts = {
            name: ",".join(map(str, value)) if isinstance(value, (tuple, list, np.ndarray)) else value
            for name, value in query.items()
        }
        response = yield from self.get("/render", **texts)
        return response.body

    def sample(self, points: ArrayLike, samples: int | None = None, part: str | None = None) -> Flow[models.Samples]:
        """Light that a small surface would get at points of any place, (points, 6): position and normal of each."""
        rows = np.asarray(points, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != 6:
            raise ValueError(f"points: have to be (points, 6), positions and normals, not {rows.shape}")
        query = _query(part=part)
        body: dict[str, Any] = {"points": rows.tolist(), **query, **({"samples": samples} if samples else {})}
        post = Request("POST", f"{self.path}/sample", headers=_JSON, body=_body(body))
        found = (yield from call(post, self.patience)).json()
        light = np.array([point["light"] for point in found["points"]], np.float32).reshape(-1, 3)
        error = np.array([point.get("error") for point in found["points"]], np.float32)
        return models.Samples(found["version"], found["part"], light, error)

    def delete(self) -> Flow[None]:
        """Deletes the scene, cancels its jobs and ends its streams."""
        yield from call(Request("DELETE", self.path), self.patience)
