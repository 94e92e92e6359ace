"""Blender's scene as data: what of it counts, stable ids, and its light in the service's terms."""

from __future__ import annotations

import hashlib
import math
import uuid
from collections.abc import Iterable
from dataclasses import dataclass, field

import bpy
import numpy as np

from .state import Color, LightState, ObjectState, Rows, SceneState

#: glTF's axes (+y up) from Blender's (+z up).
GLTF_FROM_BLENDER = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], float)

SURFACES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}
LAMPS = {"POINT": "point", "SPOT": "spot", "SUN": "directional"}


@dataclass
class Scanner:
    """Reads a scene again and again; shapes only where they may have changed."""

    #: Which object an id belongs to: a copy of an object brings the id of the original along.
    owners: dict[str, int] = field(default_factory=dict)
    #: Fingerprints of surfaces by id.
    shapes: dict[str, str] = field(default_factory=dict)
    #: Ids of objects that were not chosen and do not count.
    left_out: set[str] = field(default_factory=set)

    def choose(self, scene: bpy.types.Scene, only_selected: bool) -> None:
        """From now on what is there counts, or of that what is selected, and all that comes new."""
        self.left_out = {self.id_of(one) for one in scene.objects if only_selected and not one.select_get()}

    def id_of(self, one: bpy.types.Object) -> str:
        """The stable id of an object, kept in its custom property `id`: glTF's `extras.id`."""
        found = one.get("id")
        text = str(found) if found not in (None, "") else uuid.uuid4().hex[:12]
        if self.owners.setdefault(text, one.session_uid) != one.session_uid:
            text = uuid.uuid4().hex[:12]
            self.owners[text] = one.session_uid
        if found != text:
            one["id"] = text
        return text

    def counts(self, one: bpy.types.Object) -> bool:
        """It is part of what is sent."""
        return (one.type in SURFACES or one.type == "LIGHT") and self.id_of(one) not in self.left_out

    def forget_shape(self, one: bpy.types.Object) -> None:
        """Its surface may have changed."""
        self.shapes.pop(str(one.get("id")), None)

    def read(self, scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> SceneState:
        """The scene as it is now."""
        objects: dict[str, ObjectState] = {}
        lights: dict[str, LightState] = {}
        albedos: dict[str, Color] = {}
        for one in scene.objects:
            if not self.counts(one):
                continue
            id = self.id_of(one)
            if one.type == "LIGHT":
                if one.data.type in LAMPS and is_shown(one):
                    lights[id] = lamp(one)
                continue
            if id not in self.shapes:
                self.shapes[id] = shape_of(one.evaluated_get(depsgraph))
            used = [slot.material for slot in one.material_slots if slot.material]
            albedos.update({material.name: base_color(material) for material in used})
            shape = self.shapes[id] + "".join(str(emission(material)) for material in used)
            names = tuple(material.name for material in used)
            matrix = rows(GLTF_FROM_BLENDER @ np.array(one.matrix_world) @ GLTF_FROM_BLENDER.T)
            objects[id] = ObjectState(one.name, matrix, shape, names, not is_shown(one))
        return SceneState(objects, lights, albedos, radiance(scene.world))


def is_shown(one: bpy.types.Object) -> bool:
    """It counts for light: neither hidden in the view nor in renders."""
    return not one.hide_render and one.visible_get()


def rows(matrix: np.ndarray) -> Rows:
    return tuple(tuple(float(value) for value in row) for row in matrix)


def lamp(one: bpy.types.Object) -> LightState:
    """A lamp. Blender's watts are those of all directions: 1 / 4π of them per steradian. A sun's strength is W/m²."""
    data = one.data
    world = GLTF_FROM_BLENDER @ np.array(one.matrix_world)
    position, direction = world[:3, 3], -world[:3, 2] / np.linalg.norm(world[:3, 2])
    angles: tuple[float, ...] = ()
    if data.type == "SPOT":
        outer = data.spot_size / 2
        angles = (outer * (1 - data.spot_blend), outer)
    if data.type == "SUN":
        angles = (0.0,)
    intensity = data.energy if data.type == "SUN" else data.energy / (4 * math.pi)
    return LightState(LAMPS[data.type], color3(position), color3(direction), color3(data.color), intensity, angles)


def color3(values: Iterable[float]) -> Color:
    first, second, third = (float(value) for value in list(values)[:3])
    return first, second, third


def principled(material: bpy.types.Material) -> bpy.types.Node | None:
    """The node that glTF's exporter reads."""
    if not material.use_nodes:
        return None
    return next((node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED"), None)


def base_color(material: bpy.types.Material) -> Color:
    """Base colour where no texture gives it; white before a texture."""
    node = principled(material)
    if node is None:
        return color3(material.diffuse_color)
    socket = node.inputs["Base Color"]
    return (1.0, 1.0, 1.0) if socket.is_linked else color3(socket.default_value)


def emission(material: bpy.types.Material) -> tuple[float, ...]:
    """Radiance that a material sends out by itself, before a texture; empty for none."""
    node = principled(material)
    if node is None:
        return ()
    strength = float(node.inputs["Emission Strength"].default_value)
    color = color3(node.inputs["Emission Color"].default_value)
    return tuple(round(strength * one, 6) for one in color) if strength > 0 and max(color) > 0 else ()


def radiance(world: bpy.types.World | None) -> Color:
    """What a plain background sends in from everywhere; nothing where textures give it."""
    if world is None:
        return 0.0, 0.0, 0.0
    if not world.use_nodes:
        return color3(world.color)
    node = next((node for node in world.node_tree.nodes if node.type == "BACKGROUND"), None)
    if node is None or node.inputs["Color"].is_linked:
        return 0.0, 0.0, 0.0
    strength = float(node.inputs["Strength"].default_value)
    return color3(strength * value for value in color3(node.inputs["Color"].default_value))


def shape_of(evaluated: bpy.types.Object) -> str:
    """Fingerprint of a surface, with its modifiers."""
    mesh = evaluated.to_mesh()
    digest = hashlib.blake2b(digest_size=8)
    try:
        if mesh is not None:
            for values in (positions(mesh), triangles(mesh)[1]):
                digest.update(values.tobytes())
            materials = np.empty(len(mesh.polygons), np.int32)
            mesh.polygons.foreach_get("material_index", materials)
            digest.update(materials.tobytes())
    finally:
        evaluated.to_mesh_clear()
    return digest.hexdigest()


def positions(mesh: bpy.types.Mesh) -> np.ndarray:
    """(vertices, 3), Blender's axes."""
    values = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", values)
    return values.reshape(-1, 3)


def triangles(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Loops and vertices of the corners of triangles, (triangles, 3) each."""
    mesh.calc_loop_triangles()
    loops = np.empty(3 * len(mesh.loop_triangles), np.int32)
    vertices = np.empty_like(loops)
    mesh.loop_triangles.foreach_get("loops", loops)
    mesh.loop_triangles.foreach_get("vertices", vertices)
    return loops.reshape(-1, 3), vertices.reshape(-1, 3)
