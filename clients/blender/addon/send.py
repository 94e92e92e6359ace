"""Objects of Blender as binary glTF, and the corners of their triangles, by which coordinates of an atlas are found."""

from __future__ import annotations

import json
import struct
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .scan import positions, triangles


@dataclass(frozen=True)
class Corners:
    """Triangles of an object as they are exported: what each has for corners, and which loops of its mesh those are."""

    #: (triangles, 3, 3), object space, glTF's axes.
    positions: np.ndarray
    #: (triangles, 3).
    loops: np.ndarray
    loop_count: int


@contextmanager
def selected(objects: Iterable[bpy.types.Object]) -> Iterator[None]:
    """Nothing but these is selected, until the end."""
    layer = bpy.context.view_layer
    before = [one for one in layer.objects if one.select_get()]
    active = layer.objects.active
    try:
        for one in before:
            one.select_set(False)
        for one in objects:
            one.select_set(True)
        yield
    finally:
        for one in layer.objects:
            one.select_set(False)
        for one in before:
            one.select_set(True)
        layer.objects.active = active


def glb(objects: Iterable[bpy.types.Object]) -> bytes:
    """The objects with their materials and lamps, each by itself at its place, modifiers applied. Lamps and emissive
    surfaces go together: W/sr, W/m² and W/(m² sr)."""
    with tempfile.TemporaryDirectory() as folder, selected(objects):
        path = Path(folder, "scene.glb")
        bpy.ops.export_scene.gltf(
            filepath=str(path),
            export_format="GLB",
            use_selection=True,
            export_extras=True,
            export_apply=True,
            export_lights=True,
            export_import_convert_lighting_mode="COMPAT",
            export_hierarchy_flatten_objs=True,
            export_animations=False,
            export_skins=False,
            export_morph=False,
        )
        return path.read_bytes()


def without_place(file: bytes) -> bytes:
    """The same binary glTF with its nodes at the origin: what is inserted gets its place by the edit."""
    length = struct.unpack_from("<I", file, 12)[0]
    document = json.loads(file[20 : 20 + length])
    for node in document["nodes"]:
        for name in ("translation", "rotation", "scale", "matrix"):
            node.pop(name, None)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = file[20 + length :]
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


def corners(one: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Corners | None:
    """The triangles of a mesh; none where modifiers make others of them, so that the mesh has no loops for those."""
    if one.type != "MESH":
        return None
    evaluated = one.evaluated_get(depsgraph)
    mesh = evaluated.to_mesh()
    try:
        if len(mesh.loops) != len(one.data.loops):
            return None
        loops, vertices = triangles(mesh)
        return Corners(turned(positions(mesh))[vertices], loops, len(mesh.loops))
    finally:
        evaluated.to_mesh_clear()


def turned(places: np.ndarray) -> np.ndarray:
    """Blender's axes to glTF's."""
    return np.stack([places[..., 0], places[..., 2], -places[..., 1]], axis=-1)
