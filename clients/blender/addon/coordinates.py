"""Coordinates of an atlas, from the glTF that the service makes of it, on the loops of Blender's meshes."""

from __future__ import annotations

import json
import struct
from collections import defaultdict
from typing import Any

import numpy as np

from .core.models import AtlasObject
from .core.problems import RebakeError
from .send import Corners

_TYPES = {5126: "<f4", 5125: "<u4", 5123: "<u2"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}


def page_coordinates(glb: bytes) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """By name of an object: corners of its triangles (triangles, 3, 3) in object space, and where they lie on their
    page (triangles, 3, 2)."""
    length = struct.unpack_from("<I", glb, 12)[0]
    document = json.loads(glb[20 : 20 + length])
    binary = memoryview(glb)[20 + length + 8 :]
    found = {}
    for node in document["nodes"]:
        if "mesh" in node:
            parts = [_part(document, binary, part) for part in document["meshes"][node["mesh"]]["primitives"]]
            places, uvs = zip(*parts, strict=True)
            found[node["name"]] = np.concatenate(places), np.concatenate(uvs)
    return found


def _part(document: dict[str, Any], binary: memoryview, part: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    corners = _array(document, binary, part["indices"]).reshape(-1, 3)
    places = _array(document, binary, part["attributes"]["POSITION"])
    return places[corners], _array(document, binary, part["attributes"]["TEXCOORD_1"])[corners]


def _array(document: dict[str, Any], binary: memoryview, index: int) -> np.ndarray:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    kind, width = _TYPES[accessor["componentType"]], _WIDTHS[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    if "byteStride" in view:
        raise RebakeError("the atlas has interleaved attributes, which this add-on does not read")
    return np.frombuffer(binary, kind, accessor["count"] * width, start).reshape(-1, width)


def loop_coordinates(theirs: tuple[np.ndarray, np.ndarray], place: AtlasObject, ours: Corners) -> np.ndarray | None:
    """Coordinates of an object by loop, (loops, 2), origin bottom left as in Blender, before scale and offset of its
    place. None where its triangles are others than those that were sent."""
    places, uvs = theirs
    if len(places) != len(ours.positions):
        return None
    by_key: dict[bytes, list[np.ndarray]] = defaultdict(list)
    for key, uv in zip(_keys(places), _rolled(places, uvs), strict=True):
        by_key[key].append(uv)
    found = np.zeros((ours.loop_count, 2))
    for key, loops in zip(_keys(ours.positions), _rolled(ours.positions, ours.loops), strict=True):
        if not by_key[key]:
            return None
        found[loops] = by_key[key].pop()
    texcoord = (found - np.array(place.offset)) / np.array(place.scale)
    return np.stack([texcoord[:, 0], 1 - texcoord[:, 1]], axis=-1)


def _firsts(places: np.ndarray) -> np.ndarray:
    """Which corner of each triangle comes first: triangles begin anywhere, and keep their turn."""
    _, rank = np.unique(places.reshape(-1, 3) + np.float32(0), axis=0, return_inverse=True)
    return np.argmin(rank.reshape(-1, 3), axis=1)


def _rolled(places: np.ndarray, values: np.ndarray) -> np.ndarray:
    turn = (_firsts(places)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(values, turn.reshape(turn.shape + (1,) * (values.ndim - 2)), axis=1)


def _keys(places: np.ndarray) -> list[bytes]:
    # Adding zero makes one of both zeros.
    exact = np.ascontiguousarray(_rolled(places, places) + np.float32(0), "<f4")
    return [one.tobytes() for one in exact]
