"""Small scenes as binary glTF, made in code."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Triangles of a box with corners (0, 0, 0) … (1, 1, 1), numbered x + 2 y + 4 z, seen from outside.
_BOX = [0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5]


def box(low: tuple[float, float, float], high: tuple[float, float, float], inside_out: bool = False) -> NDArray[Any]:
    """Corners of the triangles of a box, (36, 3)."""
    corners = np.array([[(high if at >> axis & 1 else low)[axis] for axis in range(3)] for at in range(8)], np.float32)
    triangles = np.array(_BOX).reshape(-1, 3)
    found: NDArray[Any] = corners[(triangles[:, ::-1] if inside_out else triangles).ravel()]
    return found


def glb(meshes: dict[str, tuple[NDArray[Any], tuple[float, float, float]]], lamp: bool = True) -> bytes:
    """Objects by name, with the corners of their triangles and their albedo; a point light `lamp` under the ceiling."""
    document: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0}
    nodes, views, accessors, materials, shapes = [], [], [], [], []
    binary = b""
    for at, (name, (corners, albedo)) in enumerate(meshes.items()):
        data = corners.astype("<f4").tobytes()
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        bounds = {"min": corners.min(axis=0).tolist(), "max": corners.max(axis=0).tolist()}
        accessors.append({"bufferView": at, "componentType": 5126, "count": len(corners), "type": "VEC3", **bounds})
        factor = {"baseColorFactor": [*albedo, 1], "metallicFactor": 0, "roughnessFactor": 1}
        materials.append({"name": f"paint of {name}", "pbrMetallicRoughness": factor})
        shapes.append({"primitives": [{"attributes": {"POSITION": at}, "material": at}]})
        nodes.append({"name": name, "mesh": at, "extras": {"id": f"id of {name}"}})
        binary += data
    if lamp:
        light = {"name": "lamp", "type": "point", "color": [1, 1, 1], "intensity": 4}
        document["extensionsUsed"] = ["KHR_lights_punctual"]
        document["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
        extensions = {"KHR_lights_punctual": {"light": 0}}
        nodes.append({"name": "lamp", "translation": [1, 1.7, 1], "extensions": extensions})
    document |= {"nodes": nodes, "scenes": [{"nodes": list(range(len(nodes)))}], "meshes": shapes}
    document |= {"materials": materials, "bufferViews": views, "accessors": accessors}
    document["buffers"] = [{"byteLength": len(binary)}]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def room() -> bytes:
    """2 × 2 × 2 m with a crate in it, 40 cm across."""
    return glb(
        {
            "room": (box((0, 0, 0), (2, 2, 2), inside_out=True), (0.6, 0.6, 0.6)),
            "crate": (box((0.8, 0, 0.8), (1.2, 0.4, 1.2)), (0.5, 0.2, 0.1)),
        }
    )


def crate() -> bytes:
    """A crate to insert, 20 cm across, at the origin."""
    return glb({"crate": (box((0, 0, 0), (0.2, 0.2, 0.2)), (0.2, 0.5, 0.1))}, lamp=False)
