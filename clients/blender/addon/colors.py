"""The light map as colours of the corners of meshes, where no image is wanted."""

from __future__ import annotations

import bpy
import numpy as np

#: The attribute on meshes: linear, irradiance / π.
ATTRIBUTE = "rebake light map"


def write(mesh: bpy.types.Mesh, light: np.ndarray) -> None:
    """Gives the corners of a mesh this light, (corners, 3)."""
    attribute = mesh.color_attributes.get(ATTRIBUTE)
    if attribute is not None and (attribute.domain, attribute.data_type) != ("CORNER", "FLOAT_COLOR"):
        mesh.color_attributes.remove(attribute)
        attribute = None
    if attribute is None:
        active = mesh.color_attributes.active_color_index
        attribute = mesh.color_attributes.new(ATTRIBUTE, "FLOAT_COLOR", "CORNER")
        # Colours of the mesh's own stay those that are shown and painted.
        mesh.color_attributes.active_color_index = max(active, 0)
    rgba = np.ones((len(light), 4), np.float32)
    rgba[:, :3] = light
    attribute.data.foreach_set("color", rgba.ravel())
    mesh.update()


def read(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """What an image, (rows, columns, channels) from the bottom, has at places from 0 to 1, (n, 2): (n, 3), interpolated
    between the four texels around each."""
    size = np.array(image.shape[1::-1])
    at = np.clip(places * size - 0.5, 0, size - 1)
    low = np.minimum(at.astype(int), np.maximum(size - 2, 0))
    high = np.minimum(low + 1, size - 1)
    (u, v), (left, down), (right, up) = (at - low).T[..., None], low.T, high.T
    lower = image[down, left, :3] * (1 - u) + image[down, right, :3] * u
    upper = image[up, left, :3] * (1 - u) + image[up, right, :3] * u
    return lower * (1 - v) + upper * v
