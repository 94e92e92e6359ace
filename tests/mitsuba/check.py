#!/usr/bin/env python3
"""Compares rebake's path tracer with Mitsuba 3 on a generated room: mean ratio and RMSE, with the noise of both.

    python3 tests/mitsuba/check.py [--paths 1024] [--venv DIR] [--binary PATH]

Makes a virtual environment with `mitsuba` and `numpy` from PyPI on the first run (beside the build, in target/mitsuba)
and needs LLVM's shared library for it (Debian: libllvm19). Ends with 1 where the two differ by more than their noise.
"""
import argparse
import glob
import json
import os
import struct
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def parse():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--paths", type=int, default=1024, help="paths per element, both renderers")
    parser.add_argument("--venv", type=Path, default=ROOT / "target/mitsuba")
    parser.add_argument("--binary", type=Path, help="a built example path_points; default: cargo builds it")
    parser.add_argument("--work", type=Path, default=ROOT / "target/mitsuba-check")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


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


def outside(args):
    """Makes the environment, renders with rebake, and goes on inside the environment."""
    python, environment = prepare(args.venv)
    command = [args.binary] if args.binary else [
        "cargo", "run", "--release", "--quiet", "--manifest-path", str(ROOT / "core/Cargo.toml"),
        "--example", "path_points", "--"]
    subprocess.run([*command, str(args.work), str(args.paths)], check=True)
    again = [python, __file__, "--inside", "--paths", str(args.paths), "--work", str(args.work)]
    return subprocess.run(again, env=environment).returncode


def read_document(path):
    """A binary glTF's JSON and its binary chunk."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20:20 + length]), data[20 + length + 8:]


def read_glb(path):
    """Objects of a binary glTF without node hierarchy: positions in world space, triangles, albedo, emission, normals
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

    for node in document["nodes"]:
        if "mesh" not in node:
            continue
        matrix = np.array(node.get("matrix", np.eye(4).ravel()), float).reshape(4, 4).T
        if "matrix" not in node and {"translation", "rotation", "scale"} & node.keys():
            x, y, z, w = node.get("rotation", [0, 0, 0, 1])
            turn = np.array([
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
            matrix[:3, :3] = turn @ np.diag(node.get("scale", [1, 1, 1]))
            matrix[:3, 3] = node.get("translation", [0, 0, 0])
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


def radiance_at(scene, origins, normals, seed, samples):
    """Mean incoming radiance by the cosine, direct and indirect, with Mitsuba's own path integrator.

    Direct light by Mitsuba's emitter sampling; indirect light by its path integrator along cosine-distributed rays, with
    what those rays meet of the lamps themselves hidden."""
    import drjit as dr
    import mitsuba as mi
    import numpy as np
    count = len(origins)
    index = dr.repeat(dr.arange(mi.UInt32, count), samples)
    origin = dr.gather(mi.Point3f, mi.Point3f(origins.T.copy()), index)
    normal = dr.gather(mi.Normal3f, mi.Normal3f(normals.T.copy()), index)
    sampler = mi.load_dict({"type": "independent", "sample_count": samples})
    sampler.seed(seed, count * samples)
    point = dr.zeros(mi.SurfaceInteraction3f)
    point.p, point.n, point.t, point.sh_frame = origin, normal, mi.Float(1), mi.Frame3f(normal)
    sample, weight = scene.sample_emitter_direction(point, sampler.next_2d(), True)
    direct = weight * dr.maximum(0, dr.dot(sample.d, normal)) / dr.pi
    direction = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
    ray = mi.RayDifferential3f(mi.Ray3f(origin, direction))
    integrator = mi.load_dict({"type": "path", "max_depth": 64, "rr_depth": 5})
    total, _, _ = integrator.sample(scene, sampler, ray)
    hit = scene.ray_intersect(ray)
    emitted = dr.select(hit.is_valid(), hit.emitter(scene).eval(hit), 0)
    indirect = total - emitted

    def mean(color):
        return np.stack([np.array(dr.block_sum(channel, samples)) for channel in color], 1) / samples

    return mean(direct), mean(indirect)


def inside(args):
    import mitsuba as mi
    mi.set_variant("llvm_ad_rgb")
    import numpy as np
    table = np.fromfile(args.work / "points.f32", "<f4").reshape(-1, 15)
    positions, normals, direct, indirect, variance = (table[:, 3 * k:3 * k + 3] for k in range(5))
    scene = load_scene(args.work / "scene.glb")
    origins = (positions + 1e-4 * normals).astype(np.float32)
    batch = max(1, min(args.paths // 8, 8_000_000 // len(table)))
    batches = max(2, args.paths // batch)
    runs = np.array([radiance_at(scene, origins, normals, seed, batch) for seed in range(batches)], np.float64)
    theirs_direct, theirs_indirect = runs[:, 0].mean(0), runs[:, 1].mean(0)
    scatter = runs.sum(1).var(0, ddof=1) / batches
    print(f"{len(table)} elements, {args.paths} paths each here, {batch * batches} there")
    agree = True
    for name, ours, theirs in (
            ("direct", direct, theirs_direct), ("indirect", indirect, theirs_indirect),
            ("all light", direct + indirect, theirs_direct + theirs_indirect)):
        # Standard error of the ratio: from the scatter of the difference over elements, which includes all noise.
        difference = (ours - theirs).mean(1)
        error = difference.std(ddof=1) / np.sqrt(len(difference)) / theirs.mean()
        ratio = ours.mean() / theirs.mean()
        print(f"{name:<10} mean ratio {ratio:.5f} ± {error:.5f}, RMSE of the difference {np.sqrt(((ours - theirs) ** 2).mean()):.5f}")
        agree &= abs(ratio - 1) < 4 * error + 2e-4
    noise = np.sqrt(variance.mean() + scatter.mean())
    found = np.sqrt(((direct + indirect - theirs_direct - theirs_indirect) ** 2).mean())
    print(f"noise of both together {noise:.5f}: the difference is {found / noise:.3f} of it")
    return 0 if agree and found < 1.15 * noise else 1


if __name__ == "__main__":
    arguments = parse()
    sys.exit(inside(arguments) if arguments.inside else outside(arguments))
