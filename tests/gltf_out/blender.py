"""Blender's importer on files: blender.py FOLDER. Fails where hierarchy, names, coordinates or materials are missing."""

import pathlib
import sys

import bpy

ROOM = ["House", "Walls", "Floor", "Furniture", "Table", "Vase", "Bulb", "Window", "Spot", "Camera", "Marker"]
PARENTS = {"Vase": "Table", "Table": "Furniture", "Furniture": "House", "Spot": "House"}
NAMES = {"room": [*ROOM, "Screen", "Pane"], "edited": [*ROOM, "stool"]}
GONE = {"room": [], "edited": ["Screen", "Pane"]}


def check(path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert bpy.ops.import_scene.gltf(filepath=str(path)) == {"FINISHED"}
    scene, variant = path.name.split(".")[-3:-1]
    objects = bpy.data.objects
    print(f"{path.name}: {len(objects)} objects, {len(bpy.data.materials)} materials, {len(bpy.data.images)} images")
    if scene not in NAMES:
        return
    missing = [name for name in NAMES[scene] if name not in objects]
    assert not missing, missing
    assert not [name for name in GONE[scene] if name in objects]
    for name, parent in PARENTS.items():
        assert objects[name].parent is objects[parent], name
    assert objects["Spot"].type == "LIGHT" and objects["Camera"].type == "CAMERA" and objects["Marker"].type == "EMPTY"
    floor = objects["Floor"].data
    has_pages = variant in ("atlas", "plain-atlas")
    assert len(floor.uv_layers) == (3 if has_pages else 2), [layer.name for layer in floor.uv_layers]
    assert bool(floor.color_attributes) != has_pages
    materials = {material.name.split(".")[0] for material in bpy.data.materials}
    assert {"Plaster", "Planks", "Red", "Glow", "Glass"} <= materials, materials
    assert any(image.name.startswith("planks") for image in bpy.data.images)
    assert objects["Table"]["light_map"]["object"] == "Table"


for path in sorted(pathlib.Path(sys.argv[1]).glob("*.*.glb")):
    check(path)
