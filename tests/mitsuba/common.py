"""What the checks against Mitsuba 3 share: its virtual environment, the words of the command line, glTF as its scene.

What runs inside the environment imports what is installed only there, so those imports stand in functions.
"""
import argparse
import glob
import json
import os
import struct
import subprocess
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def arguments(about, binary, work):
    """A parser of what both checks take; `binary` is what cargo builds for it, `work` where its files go."""
    parser = argparse.ArgumentParser(description=about.split("\n\n")[0])
    parser.add_argument("--venv", type=Path, default=ROOT / "target/mitsuba")
    parser.add_argument("--binary", type=Path, help=f"a built {binary}; default: cargo builds it")
    parser.add_argument("--work", type=Path, default=ROOT / "target" / work)
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    return parser


def cargo(*options):
    """The command that builds and runs it; its arguments follow."""
    return ["cargo", "run", "--release", "--quiet", *options, "--"]


def prepare(folder):
    """The Python of a virtual environment that has Mitsuba, and the process environment it needs."""
    python = folder / "bin/python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    if subprocess.run([python, "-c", "import mitsuba, numpy"], capture_output=True).returncode != 0:
        subprocess.run([python, "-m", "pip", "install", "--quiet", "mitsuba", "numpy"], check=True)
    environment = dict(os.environ)
    libraries = sorted(glob.glob("/usr/lib/*/libLLVM-19.so*") + glob.glob("/usr/lib/llvm-19/lib/libLLVM*.so*"))
    if libraries:
        environment.setdefault("DRJIT_LIBLLVM_PATH", libraries[0])
    return python, environment


def read_document(path):
    """A binary glTF's JSON and its binary chunk."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20:20 + length]), data[20 + length + 8:]


def nodes(document):
    """Nodes of the scene, each with the matrix from its space to the world's."""
    import numpy as np
    root = document["scenes"][document.get("scene", 0)]
    stack = [(index, np.eye(4)) for index in reversed(root["nodes"])]
    while stack:
        index, parent = stack.pop()
        node = document["nodes"][index]
        world = parent @ local_matrix(node)
        stack += [(child, world) for child in reversed(node.get("children", []))]
        yield node, world


def local_matrix(node):
    import numpy as np
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", [0, 0, 0, 1])
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    matrix = np.eye(4)
    matrix[:3, :3] = turn @ np.diag(node.get("scale", [1, 1, 1]))
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def read_glb(path):
    """Objects of a binary glTF: positions in world space, triangles, albedo, emission, normals
    (none where the file has none), whether both sides reflect. What blends neither blocks nor reflects: left out."""
    import numpy as np
    document, binary = read_document(path)
    kinds = {5123: np.uint16, 5125: np.uint32, 5126: np.float32}
    widths = {"SCALAR": 1, "VEC3": 3}

    def accessor(index):
        a = document["accessors"][index]
        view = document["bufferViews"][a["bufferView"]]
        offset = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        width = widths[a["type"]]
        values = np.frombuffer(binary, kinds[a["componentType"]], a["count"] * width, offset)
        return values.reshape(-1, width)

    for node, matrix in nodes(document):
        if "mesh" not in node:
            continue
        for primitive in document["meshes"][node["mesh"]]["primitives"]:
            material = document["materials"][primitive["material"]]
            if material.get("alphaMode") == "BLEND":
                continue
            albedo = material.get("pbrMetallicRoughness", {}).get("baseColorFactor", [1, 1, 1, 1])[:3]
            strength = material.get("extensions", {}).get("KHR_materials_emissive_strength", {})
            emission = np.array(material.get("emissiveFactor", [0, 0, 0])) * strength.get("emissiveStrength", 1.0)
            positions = accessor(primitive["attributes"]["POSITION"]) @ matrix[:3, :3].T + matrix[:3, 3]
            normals = None
            if "NORMAL" in primitive["attributes"]:
                normals = accessor(primitive["attributes"]["NORMAL"]) @ np.linalg.inv(matrix[:3, :3])
                normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
            triangles = accessor(primitive["indices"]).reshape(-1, 3)
            double_sided = material.get("doubleSided", False)
            yield positions.astype(np.float32), triangles, albedo, emission, normals, double_sided


def load_scene(path, smooth=False, **more):
    """The scene; with the file's normals if `smooth`; `more` goes into the scene's description."""
    import mitsuba as mi
    scene = {"type": "scene", **more}
    for index, (positions, triangles, albedo, emission, normals, double_sided) in enumerate(read_glb(path)):
        properties = mi.Properties()
        reflectance = {"type": "rgb", "value": [float(x) for x in albedo]}
        # One-sided: the plain diffuse BSDF is black from behind.
        diffuse = {"type": "diffuse", "reflectance": reflectance}
        properties["bsdf"] = mi.load_dict({"type": "twosided", "material": diffuse} if double_sided else diffuse)
        if max(emission) > 0:
            radiance = {"type": "rgb", "value": [float(x) for x in emission]}
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
        smoothed = smooth and normals is not None
        mesh = mi.Mesh(
            f"mesh{index}", len(positions), len(triangles), props=properties, has_vertex_normals=smoothed)
        parameters = mi.traverse(mesh)
        if smoothed:
            parameters["vertex_normals"] = normals.ravel()
        parameters["vertex_positions"] = positions.ravel()
        parameters["faces"] = triangles.astype("uint32").ravel()
        parameters.update()
        scene[f"shape{index}"] = mesh
    return mi.load_dict(scene)
