"""The link between a scene in Blender and the one at the service: sends, watches what is edited, shows what comes."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty

import bpy
import numpy as np

from . import colors, display, send, settings
from .core.models import AtlasObject, JobInfo
from .scan import Scanner
from .state import Changes, Known, SceneState, changes
from .worker import Accepted, Failed, Light, Progress, Uploaded, Worker

#: Seconds: between looks at what has happened; without a change until an edit is sent; with changes without end.
TICK, SETTLED, LONGEST = 0.1, 0.2, 1.0


@dataclass
class Status:
    """What the panel tells."""

    jobs: dict[str, JobInfo] = field(default_factory=dict)
    version: int = 0
    stated_error: float | None = None
    elements: int = 0
    warnings: list[str] = field(default_factory=list)
    problem: str = ""

    @property
    def job(self) -> JobInfo | None:
        """The job that runs, else one that waits, else the last one."""
        of_state = {job.state: job for job in self.jobs.values()}
        return of_state.get("running") or of_state.get("queued") or next(reversed(self.jobs.values()), None)


class Link:
    """One scene of Blender at one service, from a bake until it is stopped."""

    def __init__(self, scene: bpy.types.Scene) -> None:
        wanted = scene.rebake
        # Not the scene itself: to undo makes another one of it.
        self.scene_uid = scene.session_uid
        self.scanner = Scanner()
        self.known = Known()
        self.status = Status()
        self.is_ready = False
        #: Colours of corners hold the light map, and no image.
        self.as_colors = wanted.target == "COLORS"
        #: The newest light map is shown, but not in the file yet.
        self.is_unkept = False
        self.places: tuple[AtlasObject, ...] = ()
        #: Objects, by their names at the service, whose light cannot be shown on them.
        self.unshown: set[str] = set()
        #: By mesh: the object whose coordinates it has, and those.
        self.laid_out: dict[int, tuple[int, np.ndarray]] = {}
        self.first_change: float | None = None
        self.last_change = 0.0
        self.scanner.choose(scene, wanted.only_selected)
        self.sent = self.scan()
        self.worker = Worker(wanted.server, settings.token(), wanted.samples)
        objects = [one for one in self._counted() if self._is_sent(one)]
        glb, corners = self._export(objects)
        # The exporter leaves names as they are: they are unique in a file.
        self._names = {one.name: self.scanner.id_of(one) for one in objects}
        query = {"name": scene.name, "samples": wanted.samples, "texels_per_metre": round(wanted.texels_per_metre, 3)}
        if wanted.spacing > 0:
            query["spacing"] = round(wanted.spacing, 5)
        if max(self.sent.world) > 0:
            query["environment"] = self.sent.world
        self.worker.start(glb, query, corners)

    @property
    def scene(self) -> bpy.types.Scene:
        """The scene of Blender. Raises `LookupError` where it is gone."""
        found = next((one for one in bpy.data.scenes if one.session_uid == self.scene_uid), None)
        if found is None:
            raise LookupError("the scene is gone")
        return found

    def scan(self) -> SceneState:
        """The scene as it is now."""
        return self.scanner.read(self.scene, bpy.context.evaluated_depsgraph_get())

    def _counted(self) -> list[bpy.types.Object]:
        return [one for one in self.scene.objects if self.scanner.counts(one)]

    def _is_sent(self, one: bpy.types.Object) -> bool:
        id = self.scanner.id_of(one)
        return id in self.sent.lights or (id in self.sent.objects and not self.sent.objects[id].is_hidden)

    def _left_out(self) -> list[str]:
        """What of the scene the service is not told of."""
        areas = [one.name for one in self._counted() if one.type == "LIGHT" and one.data.type == "AREA"]
        return [f"glTF has no area lamps, use surfaces that emit: {', '.join(areas)}"] if areas else []

    def _materials(self) -> list[bpy.types.Material]:
        return list({slot.material for one in self._counted() for slot in one.material_slots if slot.material})

    def _export(self, objects: list[bpy.types.Object]) -> tuple[bytes, dict[str, send.Corners | None]]:
        depsgraph = bpy.context.evaluated_depsgraph_get()
        corners = {one.name: send.corners(one, depsgraph) for one in objects if one.type != "LIGHT"}
        with display.as_they_were(self._materials()):
            return send.glb(objects), corners

    def changed(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Something was edited: remembers what has to be looked at again."""
        for update in depsgraph.updates:
            if isinstance(update.id, bpy.types.Object) and update.is_updated_geometry:
                self.scanner.forget_shape(update.id.original)
        self.last_change = time.monotonic()
        self.first_change = self.first_change or self.last_change

    def tick(self) -> None:
        """Takes in what has come, sends what has settled."""
        self._receive()
        if self.is_unkept and self.status.job is not None and self.status.job.has_ended:
            display.keep()
            self.is_unkept = False
        now = time.monotonic()
        is_due = self.first_change is not None and (
            now - self.last_change >= SETTLED or now - self.first_change >= LONGEST
        )
        # A mesh that is being edited is sent when that is done.
        if is_due and self.is_ready and not self.worker.is_sending and bpy.context.mode == "OBJECT":
            self.first_change = None
            if self.scene.rebake.follow_edits:
                self.send_changes()

    def send_changes(self) -> bool:
        """Sends how the scene differs from what the service has; answers whether it does."""
        state = self.scan()
        found = changes(self.sent, state, self.known)
        self.sent = state
        if found.edits:
            self.worker.send(found.edits, *self._assets(found))
        return bool(found.edits)

    def _assets(self, found: Changes) -> tuple[dict[str, bytes], dict[str, send.Corners | None]]:
        assets: dict[str, bytes] = {}
        corners: dict[str, send.Corners | None] = {}
        for one in self.scene.objects if found.inserts else ():
            id = one.get("id")
            if id in found.inserts:
                file, its_corners = self._export([one])
                assets[id] = send.without_place(file)
                corners[self.known.objects[id]] = its_corners[one.name]
        return assets, corners

    def _receive(self) -> None:
        newest: Light | None = None
        while True:
            try:
                message = self.worker.messages.get_nowait()
            except Empty:
                break
            if isinstance(message, Light):
                if newest is not None:
                    _remove(newest.pages)
                    message.coordinates.update({**newest.coordinates, **message.coordinates})
                newest = message
            else:
                self._take(message)
        if newest is not None:
            self._show(newest)
        _redraw()

    def _take(self, message: object) -> None:
        if isinstance(message, Uploaded):
            scene = message.scene
            self.known.objects = {one.id: one.name for one in scene.objects if one.id}
            lamps = [one.name for one in scene.lights if one.kind != "emissive" and one.name in self._names]
            self.known.lights = {self._names[name]: name for name in lamps}
            self.status.elements, self.status.warnings = scene.elements, [*self._left_out(), *scene.warnings]
            self.is_ready = True
        elif isinstance(message, Accepted):
            # Its events may have come before the answer.
            self.status.jobs.setdefault(message.job.id, message.job)
            self.status.problem = ""
        elif isinstance(message, Progress):
            job = message.job
            self.status.jobs = {id: one for id, one in self.status.jobs.items() if not one.has_ended} | {job.id: job}
            self.status.problem = job.error or self.status.problem
        elif isinstance(message, Failed):
            self.status.problem = message.why + ("" if message.is_over else "; bake anew to bring both together")
            self.is_ready = self.is_ready and not message.is_over

    def _show(self, light: Light) -> None:
        by_name = {self.known.objects.get(str(one.get("id"))): one for one in self._counted()}
        sizes = [(page.width, page.height) for page in light.atlas.pages]
        self.places = light.atlas.objects
        for where in light.atlas.objects:
            one = by_name.get(where.object)
            if one is None:
                continue
            if where.object in light.coordinates and not self._lay_out(one, where, light.coordinates[where.object]):
                self.unshown.add(where.object)
                display.take_off(one)
            elif where.object not in self.unshown:
                display.place(one, where, sizes)
        whole = display.joined(light.pages)
        _remove(light.pages)
        if self.as_colors:
            self._color(whole)
        else:
            display.set_image(whole)
        self.is_unkept = not self.as_colors
        if self.status.version == 0:
            # What an earlier bake shows may be held by something else.
            self.show(False)
            self.show(True)
        elif self.is_shown:
            self.show(True)
        self.status.version, self.status.stated_error = light.version, light.stated_error

    def _color(self, whole: np.ndarray) -> None:
        """Writes what is on the image into the corners of the meshes."""
        for one in self._counted():
            if display.SCALE not in one or one.type != "MESH":
                continue
            mesh = one.data
            own = display.coordinates_of(mesh) if display.has_own(mesh) else self.laid_out[mesh.session_uid][1]
            colors.write(mesh, colors.read(whole, display.on_image(one, own)))

    def _lay_out(self, one: bpy.types.Object, where: AtlasObject, coordinates: np.ndarray | None) -> bool:
        """Sees to it that the UV map of an object holds its coordinates; answers whether it can."""
        self.unshown.discard(where.object)
        if one.type != "MESH":
            return False
        mesh = one.data
        # Colours are of the mesh: of its instances the first one has them.
        if self.as_colors:
            owner, _ = self.laid_out.setdefault(mesh.session_uid, (one.session_uid, coordinates))
            if owner != one.session_uid:
                return False
        if display.has_own(mesh):
            return where.texcoord == "file"
        if coordinates is None or len(coordinates) != len(mesh.loops):
            return False
        # Instances in other sizes may be laid out otherwise, but have one UV map together.
        owner, known = self.laid_out.get(mesh.session_uid, (one.session_uid, coordinates))
        if owner != one.session_uid and not (
            known.shape == coordinates.shape and np.allclose(known, coordinates, atol=1e-4)
        ):
            return False
        self.laid_out[mesh.session_uid] = owner, coordinates
        if not self.as_colors:
            display.set_coordinates(mesh, coordinates)
        return True

    def show(self, on: bool) -> None:
        """Materials show the light map, or what they were."""
        image = None if self.as_colors else bpy.data.images.get(display.IMAGE)
        for material in self._materials():
            if on and (image is not None or self.as_colors):
                display.show(material, image)
            else:
                display.hide(material)

    @property
    def is_shown(self) -> bool:
        """Some material shows the light map."""
        return any(display.is_shown(material) for material in self._materials())

    def cancel(self) -> None:
        """Cancels the job that runs."""
        if self.status.job is not None and not self.status.job.has_ended:
            self.worker.cancel(self.status.job.id)

    def stop(self) -> None:
        """Ends the link. The image and the nodes stay."""
        self.worker.stop()


#: The link, while there is one.
link: Link | None = None


def start(scene: bpy.types.Scene) -> Link:
    """Sends the scene and begins to follow it, in place of what was followed."""
    global link
    stop()
    link = Link(scene)
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=TICK)
    return link


def stop() -> None:
    """Ends the link, where there is one."""
    global link
    if link is not None:
        link.stop()
        link = None


def _tick() -> float | None:
    if link is None:
        return None
    try:
        link.tick()
    except LookupError:
        stop()
        return None
    return TICK


@bpy.app.handlers.persistent
def _on_update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if link is not None and scene.session_uid == link.scene_uid:
        link.changed(depsgraph)


@bpy.app.handlers.persistent
def _on_load(*_: object) -> None:
    stop()


def _redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("PROPERTIES", "VIEW_3D"):
                area.tag_redraw()


def _remove(pages: list[str]) -> None:
    for page in pages:
        Path(page).unlink(missing_ok=True)


def register() -> None:
    bpy.app.handlers.depsgraph_update_post.append(_on_update)
    bpy.app.handlers.load_pre.append(_on_load)


def unregister() -> None:
    stop()
    bpy.app.handlers.load_pre.remove(_on_load)
    bpy.app.handlers.depsgraph_update_post.remove(_on_update)
