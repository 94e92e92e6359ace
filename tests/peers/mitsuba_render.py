"""A picture of a glTF scene by Mitsuba 3, to hold against `rebake render` from the same camera.

    pip install mitsuba numpy
    python tests/peers/mitsuba_render.py room.glb reference.exr --size 320x180 --spp 1024
    rebake render room.glb -o ours.exr --size 320x180 --spp 256 --samples 512 --spacing 0.05
    rebake compare reference.exr ours.exr -o difference.png

Diffuse surfaces, emissive materials that shine from their front, the file's first camera. Surfaces block and reflect on
the sides that glTF gives them.
"""

import argparse
import json
import struct

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")

NUMBERS = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}


class Glb:
    def __init__(self, path):
        data = open(path, "rb").read()
        length = struct.unpack_from("<I", data, 12)[0]
        self.json = json.loads(data[20 : 20 + length])
        self.bin = data[20 + length + 8 :]

    def accessor(self, index):
        a = self.json["accessors"][index]
        view = self.json["bufferViews"][a["bufferView"]]
        kind, width = NUMBERS[a["componentType"]], {"SCALAR": 1, "VEC3": 3}[a["type"]]
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        return np.frombuffer(self.bin, kind, a["count"] * width, start).reshape(-1, width)

    def nodes(self):
        """Nodes of the scene with their world transforms."""
        stack = [(n, np.eye(4)) for n in self.json["scenes"][self.json.get("scene", 0)]["nodes"]]
        while stack:
            index, parent = stack.pop()
            node = self.json["nodes"][index]
            world = parent @ local(node)
            stack += [(child, world) for child in node.get("children", [])]
            yield node, world


def local(node):
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", [0, 0, 0, 1])
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.array(node.get("scale", [1, 1, 1]))
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def shape(glb, primitive, world, name):
    material = glb.json["materials"][primitive["material"]]
    if material.get("alphaMode") == "BLEND":
        return None
    base = material.get("pbrMetallicRoughness", {}).get("baseColorFactor", [1, 1, 1, 1])[:3]
    strength = material.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1)
    emission = [strength * c for c in material.get("emissiveFactor", [0, 0, 0])]
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": base}}
    if material.get("doubleSided"):
        bsdf = {"type": "twosided", "bsdf": bsdf}
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    if max(emission) > 0:
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": emission}})
    points = glb.accessor(primitive["attributes"]["POSITION"]) @ world[:3, :3].T + world[:3, 3]
    faces = glb.accessor(primitive["indices"]).reshape(-1, 3)
    mesh = mi.Mesh(name, len(points), len(faces), has_vertex_normals=False, props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = points.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def sensor(glb, width, height, spp):
    node, world = next((n, w) for n, w in glb.nodes() if "camera" in n)
    eye, forward, up = world[:3, 3], -world[:3, 2], world[:3, 1]
    return {
        "type": "perspective",
        "fov_axis": "y",
        "fov": float(np.degrees(glb.json["cameras"][node["camera"]]["perspective"]["yfov"])),
        "near_clip": 1e-3,
        "to_world": mi.ScalarTransform4f().look_at(eye.tolist(), (eye + forward).tolist(), up.tolist()),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "independent", "sample_count": spp},
    }


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    arguments.add_argument("scene")
    arguments.add_argument("out")
    arguments.add_argument("--size", default="320x180")
    arguments.add_argument("--spp", type=int, default=256)
    args = arguments.parse_args()
    width, height = map(int, args.size.split("x"))
    glb = Glb(args.scene)
    # Long paths: bright rooms are lit by them.
    scene = {"type": "scene", "integrator": {"type": "path", "max_depth": 64, "rr_depth": 8}}
    scene["sensor"] = sensor(glb, width, height, args.spp)
    for number, (node, world) in enumerate(glb.nodes()):
        mesh = glb.json["meshes"][node["mesh"]] if "mesh" in node else {"primitives": []}
        for part, primitive in enumerate(mesh["primitives"]):
            built = shape(glb, primitive, world, f"{number}-{part}")
            if built is not None:
                scene[f"shape-{number}-{part}"] = built
    mi.Bitmap(mi.render(mi.load_dict(scene))).write(args.out)


if __name__ == "__main__":
    main()
