"""The light map in Blender: one image of all pages with coordinates on the meshes, or colours of their corners, and
nodes that show it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np

from . import colors
from .core.models import AtlasObject

IMAGE, UV_MAP = "rebake light map", "Lightmap"
#: On the mesh: the add-on has made its UV map. On nodes: the add-on has made them. On the tree: what its surface was.
MADE, SURFACE = "rebake_made", "rebake_surface"
#: On objects: where on the image they lie.
SCALE, OFFSET = "rebake_scale", "rebake_offset"


def joined(pages: Sequence[str]) -> np.ndarray:
    """These pages (OpenEXR files) side by side, (rows, columns, 4), the lowest row first. Values are linear: irradiance
    / π."""
    arrays = [_pixels(page) for page in pages]
    width, height = sum(page.shape[1] for page in arrays), max(page.shape[0] for page in arrays)
    whole = np.zeros((height, width, 4), np.float32)
    left = 0
    for page in arrays:
        whole[: page.shape[0], left : left + page.shape[1]] = page
        left += page.shape[1]
    return whole


def set_image(whole: np.ndarray) -> bpy.types.Image:
    """The image with these values, (rows, columns, 4), the lowest row first."""
    height, width = whole.shape[:2]
    image = bpy.data.images.get(IMAGE)
    if image is None:
        image = bpy.data.images.new(IMAGE, width, height, float_buffer=True, is_data=True)
    elif tuple(image.size) != (width, height):
        image.scale(width, height)
    image.pixels.foreach_set(whole.ravel())
    image.update()
    return image


def keep() -> None:
    """Puts the image as it is now into the file, which takes a while for large ones."""
    image = bpy.data.images.get(IMAGE)
    if image is not None:
        image.pack()


def _pixels(path: str) -> np.ndarray:
    """(height, width, 4), the lowest row first."""
    page = bpy.data.images.load(path, check_existing=False)
    try:
        page.colorspace_settings.name = "Non-Color"
        width, height = page.size
        values = np.empty(width * height * 4, np.float32)
        page.pixels.foreach_get(values)
        return values.reshape(height, width, 4)
    finally:
        bpy.data.images.remove(page)


def place(one: bpy.types.Object, where: AtlasObject, sizes: Sequence[tuple[int, int]]) -> None:
    """Tells an object where on the image it lies: coordinates × scale + offset, origin bottom left."""
    width, height = sum(size[0] for size in sizes), max(size[1] for size in sizes)
    left, page = sum(size[0] for size in sizes[: where.page]), sizes[where.page]
    (scale_x, scale_y), (offset_x, offset_y) = where.scale, where.offset
    values = {
        SCALE: [scale_x * page[0] / width, scale_y * page[1] / height, 0.0],
        OFFSET: [(left + offset_x * page[0]) / width, (1 - scale_y - offset_y) * page[1] / height, 0.0],
    }
    for name, value in values.items():
        if not np.array_equal(one.get(name, ()), value):
            one[name] = value


def on_image(one: bpy.types.Object, coordinates: np.ndarray) -> np.ndarray:
    """Where on the image the corners of an object lie, (corners, 2), from their coordinates."""
    return coordinates * np.array(one[SCALE])[:2] + np.array(one[OFFSET])[:2]


def take_off(one: bpy.types.Object) -> None:
    """The object is not on the image: materials show it as they were."""
    for name in (SCALE, OFFSET):
        if name in one:
            del one[name]


def has_own(mesh: bpy.types.Mesh) -> bool:
    """Its UV map is somebody else's, and stays as it is."""
    return UV_MAP in mesh.uv_layers and not mesh.get(MADE)


def set_coordinates(mesh: bpy.types.Mesh, coordinates: np.ndarray) -> None:
    """Writes the UV map."""
    layer = mesh.uv_layers.get(UV_MAP)
    if layer is None:
        active = mesh.uv_layers.active_index
        layer = mesh.uv_layers.new(name=UV_MAP, do_init=False)
        mesh.uv_layers.active_index = max(active, 0)
    mesh[MADE] = True
    layer.uv.foreach_set("vector", coordinates.astype(np.float32).ravel())


def coordinates_of(mesh: bpy.types.Mesh) -> np.ndarray:
    """The UV map that it has, (corners, 2)."""
    values = np.empty(2 * len(mesh.loops), np.float32)
    mesh.uv_layers[UV_MAP].uv.foreach_get("vector", values)
    return values.reshape(-1, 2)


def show(material: bpy.types.Material, image: bpy.types.Image | None) -> None:
    """The material sends out what the light map says instead of being lit: base colour × light map, and what it
    emits. The light map is the image, or without one the colours of the corners."""
    if not material.use_nodes or SURFACE in material.node_tree:
        return
    tree = material.node_tree
    output = tree.get_output_node("ALL")
    shader = next((node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"), None)
    if output is None or shader is None:
        return
    surface = output.inputs["Surface"]
    link = surface.links[0] if surface.is_linked else None
    tree[SURFACE] = [link.from_node.name, link.from_socket.identifier] if link else ["", ""]
    add = _Adder(tree, output.location)
    scale = add("ShaderNodeAttribute", 1, attribute_type="OBJECT", attribute_name=SCALE)
    if image is None:
        light = add("ShaderNodeAttribute", 4, attribute_name=colors.ATTRIBUTE)
    else:
        light = _on_image(tree, add, scale, image)
    lit = add("ShaderNodeVectorMath", 5, operation="MULTIPLY")
    tree.links.new(light.outputs["Color"], lit.inputs[0])
    _copy(tree, shader.inputs["Base Color"], lit.inputs[1])
    sent = add("ShaderNodeEmission", 6)
    tree.links.new(lit.outputs["Vector"], sent.inputs["Color"])
    own = add("ShaderNodeEmission", 7)
    _copy(tree, shader.inputs["Emission Color"], own.inputs["Color"])
    _copy(tree, shader.inputs["Emission Strength"], own.inputs["Strength"])
    both = add("ShaderNodeAddShader", 8)
    tree.links.new(sent.outputs[0], both.inputs[0])
    tree.links.new(own.outputs[0], both.inputs[1])
    # Objects that are not on the image have no place: they are what they were.
    size = add("ShaderNodeVectorMath", 9, operation="LENGTH")
    tree.links.new(scale.outputs["Vector"], size.inputs[0])
    is_there = add("ShaderNodeMath", 10, operation="GREATER_THAN")
    tree.links.new(size.outputs["Value"], is_there.inputs[0])
    is_there.inputs[1].default_value = 0
    either = add("ShaderNodeMixShader", 11)
    tree.links.new(is_there.outputs[0], either.inputs["Fac"])
    if link is not None:
        tree.links.new(link.from_socket, either.inputs[1])
    tree.links.new(both.outputs[0], either.inputs[2])
    tree.links.new(either.outputs[0], surface)


def _on_image(tree: bpy.types.NodeTree, add: _Adder, scale: bpy.types.Node, image: bpy.types.Image) -> bpy.types.Node:
    """The image, read where the object lies on it."""
    coordinates = add("ShaderNodeUVMap", 0, uv_map=UV_MAP)
    offset = add("ShaderNodeAttribute", 2, attribute_type="OBJECT", attribute_name=OFFSET)
    on_page = add("ShaderNodeVectorMath", 3, operation="MULTIPLY_ADD")
    for at, source in enumerate((coordinates.outputs["UV"], scale.outputs["Vector"], offset.outputs["Vector"])):
        tree.links.new(source, on_page.inputs[at])
    light = add("ShaderNodeTexImage", 4, image=image, extension="EXTEND")
    tree.links.new(on_page.outputs["Vector"], light.inputs["Vector"])
    return light


def _image_of(material: bpy.types.Material) -> bpy.types.Image | None:
    """The image that its nodes of the add-on show; none where they show colours of corners."""
    made = (node for node in material.node_tree.nodes if node.get(MADE) and node.type == "TEX_IMAGE")
    return next((node.image for node in made), None)


def hide(material: bpy.types.Material) -> None:
    """The material is what it was."""
    tree = material.node_tree
    if tree is None or SURFACE not in tree:
        return
    name, socket = tree[SURFACE]
    for node in [node for node in tree.nodes if node.get(MADE)]:
        tree.nodes.remove(node)
    output, source = tree.get_output_node("ALL"), tree.nodes.get(name)
    if output is not None and source is not None:
        found = next(one for one in source.outputs if one.identifier == socket)
        tree.links.new(found, output.inputs["Surface"])
    del tree[SURFACE]


def is_shown(material: bpy.types.Material) -> bool:
    """The light map stands in for its surface."""
    return material.node_tree is not None and SURFACE in material.node_tree


@contextmanager
def as_they_were(materials: Iterable[bpy.types.Material]) -> Iterator[None]:
    """Materials without the light map, until the end: what is sent is the scene and not what is shown of it."""
    shown = [(material, _image_of(material)) for material in materials if is_shown(material)]
    for material, _ in shown:
        hide(material)
    try:
        yield
    finally:
        for material, image in shown:
            show(material, image)


class _Adder:
    """Adds nodes to a tree, marked as the add-on's."""

    def __init__(self, tree: bpy.types.NodeTree, beside: Sequence[float]) -> None:
        self.tree, self.beside = tree, beside

    def __call__(self, kind: str, row: int, **values: object) -> bpy.types.Node:
        node = self.tree.nodes.new(kind)
        node[MADE] = True
        node.location = (self.beside[0] - 250, self.beside[1] - 200 - 60 * row)
        node.hide = True
        for name, value in values.items():
            setattr(node, name, value)
        return node


def _copy(tree: bpy.types.NodeTree, source: bpy.types.NodeSocket, target: bpy.types.NodeSocket) -> None:
    """The same value, or the same link."""
    if source.is_linked:
        tree.links.new(source.links[0].from_socket, target)
        return
    value = source.default_value
    target.default_value = value if isinstance(value, float) else tuple(value)[: len(target.default_value)]
