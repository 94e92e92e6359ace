"""The add-on in Blender without a window, end to end: a scene made here is sent, baked, edited and shown, and its
light map is compared with Cycles' own bake of the same objects.

    in_blender.py ARCHIVE SERVER PICTURES

ARCHIVE: what build.py has made. SERVER: a service to use. PICTURES: a folder for pictures of what was compared.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

# Settings and extensions of whoever runs this stay out of it.
os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp()

import bpy  # noqa: E402 - before its other modules
import bmesh  # noqa: E402
import numpy as np  # noqa: E402

ARCHIVE, SERVER, PICTURES = sys.argv[1:4]
ADD_ON = "bl_ext.user_default.rebake"
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.extensions.package_install_files(filepath=ARCHIVE, repo="user_default", enable_on_install=True)
colors, display, live = (import_module(f"{ADD_ON}.{name}") for name in ("colors", "display", "live"))

SAMPLES = 128


def paint(name: str, color: tuple[float, float, float]) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    inputs = material.node_tree.nodes["Principled BSDF"].inputs
    inputs["Base Color"].default_value = (*color, 1)
    inputs["Specular IOR Level"].default_value, inputs["Roughness"].default_value = 0, 1
    return material


def make_scene() -> None:
    """A room of 4 × 4 × 3 m with a crate, a ball and a lamp that is a point."""
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 1.5), scale=(4, 4, 3))
    room = bpy.context.object
    room.name = "room"
    bpy.ops.object.transform_apply(location=False, scale=True)
    mesh = bmesh.new()
    mesh.from_mesh(room.data)
    bmesh.ops.reverse_faces(mesh, faces=mesh.faces)
    mesh.to_mesh(room.data)
    room.data.materials.append(paint("wall", (0.6, 0.55, 0.5)))
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0.9, -0.6, 0.5))
    bpy.context.object.name = "crate"
    bpy.context.object.data.materials.append(paint("crate paint", (0.6, 0.15, 0.1)))
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=0.5, location=(-1, 0.8, 0.7))
    bpy.context.object.name = "ball"
    bpy.context.object.data.materials.append(paint("ball paint", (0.2, 0.5, 0.3)))
    small = bpy.context.object.copy()
    small.name, small.location, small.scale = "small ball", (0.3, 1.2, 0.3), (0.6, 0.6, 0.6)
    bpy.context.collection.objects.link(small)
    bpy.ops.object.light_add(type="POINT", location=(0, 0.2, 2.6))
    bpy.context.object.name = "lamp"
    bpy.context.object.data.energy, bpy.context.object.data.shadow_soft_size = 100, 0
    bpy.ops.object.camera_add(location=(1.8, -1.8, 2.2), rotation=(1.15, 0, 0.75))
    bpy.context.scene.camera, bpy.context.object.data.lens = bpy.context.object, 20
    settings = bpy.context.scene.rebake
    settings.server, settings.texels_per_metre, settings.spacing, settings.samples = SERVER, 10, 0.1, 128


def wait(until: Callable[[], bool], seconds: float = 120) -> float:
    """What Blender's own loop does: updates, and the add-on's timer. Answers the longest that one of its turns took."""
    end, longest = time.monotonic() + seconds, 0.0
    while time.monotonic() < end:
        bpy.context.view_layer.update()
        start = time.monotonic()
        live.link.tick()
        longest = max(longest, time.monotonic() - start)
        assert not live.link.status.problem, live.link.status.problem
        if until():
            return longest
        time.sleep(0.02)
    raise AssertionError(f"nothing came of it within {seconds} s: {live.link.status}")


def is_done(after: int) -> bool:
    job, is_newer = live.link.status.job, live.link.status.version > after
    return is_newer and job is not None and job.has_ended and not live.link.worker.is_sending


def edit(what: str) -> None:
    """Waits until an edit that was just made is lit."""
    before, start = live.link.status.version, time.monotonic()
    longest = wait(lambda: is_done(before))
    print(f"{what}: {time.monotonic() - start:.2f} s, Blender held up for {1000 * longest:.0f} ms at most", flush=True)


def ours() -> np.ndarray:
    """The image of the light map, (rows, columns, 3)."""
    image = bpy.data.images[display.IMAGE]
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)[..., :3]


def light_at(name: str) -> np.ndarray:
    """What the image has where the loops of an object lie, (loops, 3)."""
    image, places = ours(), on_image(bpy.data.objects[name])
    size = np.array(image.shape[1::-1])
    columns, rows = np.clip((places * size).astype(int), 0, size - 1).T
    return image[rows, columns]


def on_image(one: bpy.types.Object) -> np.ndarray:
    """Where the loops of an object lie on the image, (loops, 2): UV map × scale + offset."""
    values = np.empty(2 * len(one.data.loops), np.float32)
    one.data.uv_layers[display.UV_MAP].uv.foreach_get("vector", values)
    return values.reshape(-1, 2) * np.array(one[display.SCALE])[:2] + np.array(one[display.OFFSET])[:2]


def cycles(one: bpy.types.Object, shape: tuple[int, ...], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The same image with one object by Cycles: diffuse light without colour; and which texels it has baked."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.seed = SAMPLES, seed
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.sample_clamp_indirect = 0
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 32
    image = bpy.data.images.new("baked", shape[1], shape[0], float_buffer=True, is_data=True, alpha=True)
    image.generated_color = (0, 0, 0, 0)
    nodes = one.material_slots[0].material.node_tree.nodes
    node = nodes.new("ShaderNodeTexImage")
    node.image = image
    nodes.active = node
    for other in scene.objects:
        other.select_set(other == one)
    bpy.context.view_layer.objects.active = one
    places = on_image(one)
    layer = one.data.uv_layers.new(name="on image")
    layer.uv.foreach_set("vector", places.astype(np.float32).ravel())
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, margin=0, uv_layer="on image")
    one.data.uv_layers.remove(one.data.uv_layers["on image"])
    values = np.empty(shape[0] * shape[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(*shape[:2], 4)
    nodes.remove(node)
    bpy.data.images.remove(image)
    return values[..., :3], values[..., 3] > 0.5


def inner(mask: np.ndarray) -> np.ndarray:
    """Texels whose neighbours are all covered too: at edges Cycles looks elsewhere in a texel than at its middle."""
    padded = np.pad(mask, 1)
    height, width = mask.shape
    return np.logical_and.reduce([padded[y : y + height, x : x + width] for y in range(3) for x in range(3)])


def compare(when: str) -> None:
    """Light maps of all objects against Cycles'. What half of the texels differ by gives a standard deviation that
    edges of hard shadows, which the map has within its spacing only, do not decide."""
    live.link.show(False)
    meshes = {one.name for one in bpy.context.scene.objects if one.type == "MESH"}
    assert {one.name for one in bpy.context.scene.objects if display.SCALE in one} == meshes - live.link.unshown
    mine, stated = ours(), live.link.status.stated_error
    for one in [one for one in bpy.context.scene.objects if display.SCALE in one]:
        first, covered = cycles(one, mine.shape, 1)
        second, _ = cycles(one, mine.shape, 2)
        theirs = (first + second) / 2
        # Where something stands on it no light comes to, and nothing looks.
        mask = inner(covered & (theirs.max(axis=-1) > 0))
        noise = np.sqrt(np.mean((first - second)[mask] ** 2) / 4)
        difference = (mine - theirs)[mask]
        typical = np.median(abs(difference)) / 0.6745
        mean, off = theirs[mask].mean(), difference.mean() / theirs[mask].mean()
        print(
            f"{when}, {one.name}: {mask.sum()} texels, mean {mine[mask].mean():.4f}, by Cycles {mean:.4f} "
            f"({100 * off:+.2f} %); typical difference {typical:.4f}, stated error {stated:.4f}, "
            f"noise of Cycles {noise:.4f}",
            flush=True,
        )
        assert mask.sum() > 50
        assert typical < 1.25 * np.hypot(stated, noise), "no further apart than both say"
        assert abs(off) < 0.01 + 3 * noise / mean / np.sqrt(mask.sum()), "and about the same mean"
    live.link.show(True)


def picture(name: str) -> np.ndarray:
    """A picture of the scene by Cycles, (rows, columns, 3), linear; written as PNG too."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 64, False
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 240, 180, 100
    scene.render.image_settings.file_format = "OPEN_EXR"
    path = Path(PICTURES, f"{name}.exr").absolute()
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    values = np.empty(240 * 180 * 4, np.float32)
    image.pixels.foreach_get(values)
    scene.render.image_settings.file_format = "PNG"
    image.save_render(str(path.with_suffix(".png")))
    bpy.data.images.remove(image)
    path.unlink()
    return values.reshape(180, 240, 4)[..., :3]


def compare_pictures() -> None:
    """What the nodes show looks as the scene does, by Cycles."""
    link = live.link
    before = {one.name: sorted(node.name for node in one.node_tree.nodes) for one in bpy.data.materials}
    shown = picture("light-map")
    assert bpy.ops.rebake.show(on=False) == {"FINISHED"} and not link.is_shown
    after = {one.name: sorted(node.name for node in one.node_tree.nodes) for one in bpy.data.materials}
    assert all(len(after[name]) == 2 < len(before[name]) for name in before), "materials are what they were"
    traced = picture("cycles")
    assert bpy.ops.rebake.show(on=True) == {"FINISHED"} and link.is_shown
    off = np.median(abs(shown - traced)) / traced.mean()
    means = f"mean {shown.mean():.4f}, by Cycles {traced.mean():.4f}"
    print(f"pictures: {means}, typical difference {100 * off:.1f} %", flush=True)
    assert off < 0.08 and abs(shown.mean() / traced.mean() - 1) < 0.03


def change_everything() -> None:
    """An object comes, one goes, colours, a lamp and the sky change: one request."""
    data = bpy.data
    copy = data.objects["ball"].copy()
    copy.data = data.objects["ball"].data.copy()
    copy.name, copy.location = "ball 2", (1.1, 0.9, 1.4)
    bpy.context.collection.objects.link(copy)
    data.objects.remove(data.objects["crate"])
    wall = data.materials["wall"].node_tree.nodes["Principled BSDF"]
    wall.inputs["Base Color"].default_value = (0.3, 0.4, 0.6, 1)
    lamp = data.objects["lamp"]
    lamp.data.energy, lamp.data.color, lamp.location.x = 160, (1, 0.8, 0.6), 0.5


def color_attribute() -> None:
    """The light map as colours of corners, of a finely divided mesh, against what Cycles bakes there."""
    one = bpy.data.objects["ball 2"]
    layers = set(one.data.uv_layers.keys())
    bpy.context.scene.rebake.target = "COLORS"
    assert bpy.ops.rebake.bake() == {"FINISHED"}
    edit("baked into colours")
    assert live.link.is_shown and set(one.data.uv_layers.keys()) == layers, "it needs no UV map of its own"
    first = colors_of(one, colors.ATTRIBUTE)
    one.location.z -= 0.2
    edit("moved, with colours")
    mine = colors_of(one, colors.ATTRIBUTE)
    assert abs(mine - first).max() > 0.01, "colours follow edits"
    live.link.show(False)
    first, second = (cycles_colors(one, seed) for seed in (1, 2))
    theirs, noise = (first + second) / 2, np.sqrt(np.mean((first - second) ** 2) / 4)
    typical, off = np.median(abs(mine - theirs)) / 0.6745, mine.mean() / theirs.mean() - 1
    stated = live.link.status.stated_error
    print(
        f"colours of {len(mine)} corners: mean {mine.mean():.4f}, by Cycles {theirs.mean():.4f} ({100 * off:+.2f} %); "
        f"typical difference {typical:.4f}, stated error {stated:.4f}, noise of Cycles {noise:.4f}",
        flush=True,
    )
    assert len(mine) == len(one.data.loops) and abs(off) < 0.02
    assert typical < 1.25 * np.hypot(stated, noise), "no further apart than both say"
    live.link.show(True)


def cycles_colors(one: bpy.types.Object, seed: int) -> np.ndarray:
    """What Cycles bakes into a colour attribute of its corners, (corners, 3)."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.seed = "CYCLES", SAMPLES, seed
    baked = one.data.color_attributes.new("baked", "FLOAT_COLOR", "CORNER")
    one.data.attributes.active_color = baked
    for other in scene.objects:
        other.select_set(other == one)
    bpy.context.view_layer.objects.active = one
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, target="VERTEX_COLORS")
    values = colors_of(one, "baked")
    one.data.color_attributes.remove(one.data.color_attributes["baked"])
    return values


def colors_of(one: bpy.types.Object, name: str) -> np.ndarray:
    """A colour attribute of its corners, (corners, 3)."""
    values = np.empty(4 * len(one.data.loops), np.float32)
    one.data.color_attributes[name].data.foreach_get("color", values)
    return values.reshape(-1, 4)[:, :3]


def cancel() -> None:
    """A bake that would take an hour ends when it is told to."""
    bpy.context.scene.rebake.samples = 65536
    assert bpy.ops.rebake.bake() == {"FINISHED"}
    link = live.link
    wait(lambda: link.status.job is not None and link.status.job.progress.fraction > 0)
    assert bpy.ops.rebake.cancel() == {"FINISHED"}
    wait(lambda: link.status.job.state == "canceled")
    print("canceled", flush=True)


def main() -> None:
    make_scene()
    start = time.monotonic()
    assert bpy.ops.rebake.bake() == {"FINISHED"}
    print(f"exported in {time.monotonic() - start:.2f} s", flush=True)
    wait(lambda: live.link.status.version > 0)
    print(f"first light after {time.monotonic() - start:.2f} s", flush=True)
    longest = wait(lambda: is_done(0))
    print(
        f"baked after {time.monotonic() - start:.2f} s, Blender held up for {1000 * longest:.0f} ms at most", flush=True
    )
    assert bpy.data.images[display.IMAGE].packed_file is not None, "the light map is in the file"
    # It has the mesh of the ball, but needs coordinates of its own.
    assert live.link.unshown == {"small ball"}
    ids = {one.name: one.get("id") for one in bpy.context.scene.objects}
    bpy.data.objects["crate"].location = (-0.6, -0.9, 0.5)
    edit("crate moved")
    compare("crate moved")
    compare_pictures()
    change_everything()
    edit("all kinds of edits")
    bpy.data.objects["ball 2"].location.z = 1.2
    edit("what came moved")
    assert live.link.unshown == {"small ball"}
    assert bpy.data.objects["ball 2"]["id"] not in ids.values(), "a copy has an id of its own"
    compare("all kinds of edits")
    # Sent again the coordinates that were made are the file's own, and the light is the same.
    before = light_at("ball 2")
    assert bpy.ops.rebake.bake() == {"FINISHED"}
    edit("baked anew")
    assert {place.texcoord for place in live.link.places} == {"file"}
    assert abs(light_at("ball 2").mean() / before.mean() - 1) < 0.05
    color_attribute()
    cancel()
    bpy.ops.preferences.addon_disable(module=ADD_ON)
    assert live.link is None and not hasattr(bpy.types.Scene, "rebake")


try:
    main()
    status = 0
except BaseException:
    traceback.print_exc()
    status = 1
sys.stdout.flush()
# Blender as a module does not survive the end of Python.
os._exit(status)
