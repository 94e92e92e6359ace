"""What the checks against Mitsuba 3 share: its virtual environment, the words of the command line, glTF as its scene.

What runs inside the environment imports what is installed only there, so those imports stand in functions.
"""
import argparse
import glob
import json
import os
import socket
import struct
import subprocess
import venv
from contextlib import contextmanager
from dataclasses import dataclass, replace
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


@dataclass
class Part:
    """Triangles of an object that share a material: positions and normals (none where the file has none) in the object's space,
    diffuse albedo, emission, whether both sides reflect."""
    positions: object
    triangles: object
    albedo: tuple
    emission: tuple
    normals: object
    double_sided: bool

    def placed(self, matrix):
        """It in world space, where its object is there."""
        import numpy as np
        positions, normals = self.positions @ matrix[:3, :3].T + matrix[:3, 3], None
        if self.normals is not None:
            normals = self.normals @ np.linalg.inv(matrix[:3, :3])
            normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
        return replace(self, positions=positions.astype(np.float32), normals=normals)


def read_objects(path):
    """Objects of a binary glTF: their names, the matrices to world space, their parts. What blends neither blocks nor
    reflects: left out."""
    import numpy as np
    document, binary = read_document(path)
    kinds = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
    widths = {"SCALAR": 1, "VEC3": 3}

    def accessor(index):
        a = document["accessors"][index]
        view = document["bufferViews"][a["bufferView"]]
        offset = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        width = widths[a["type"]]
        values = np.frombuffer(binary, kinds[a["componentType"]], a["count"] * width, offset)
        return values.reshape(-1, width)

    def part(primitive):
        material = document["materials"][primitive["material"]]
        albedo = material.get("pbrMetallicRoughness", {}).get("baseColorFactor", [1, 1, 1, 1])[:3]
        strength = material.get("extensions", {}).get("KHR_materials_emissive_strength", {})
        emission = np.array(material.get("emissiveFactor", [0, 0, 0])) * strength.get("emissiveStrength", 1.0)
        attributes = primitive["attributes"]
        normals = accessor(attributes["NORMAL"]) if "NORMAL" in attributes else None
        triangles = accessor(primitive["indices"]).reshape(-1, 3)
        return Part(accessor(attributes["POSITION"]), triangles, albedo, emission, normals, material.get("doubleSided", False))

    for node, matrix in nodes(document):
        primitives = document["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []
        blends = [document["materials"][one["material"]].get("alphaMode") == "BLEND" for one in primitives]
        if not all(blends):
            parts = [part(one) for one, is_blend in zip(primitives, blends) if not is_blend]
            yield node.get("name", ""), matrix, parts


def without_blending(path, to):
    """Writes a binary glTF without the primitives that blend, but for that the same."""
    document, binary = read_document(path)
    is_blend = [material.get("alphaMode") == "BLEND" for material in document["materials"]]
    for mesh in document["meshes"]:
        mesh["primitives"] = [p for p in mesh["primitives"] if not is_blend[p["material"]]] or mesh["primitives"]
    empty = {i for i, mesh in enumerate(document["meshes"]) if any(is_blend[p["material"]] for p in mesh["primitives"])}
    for node in document["nodes"]:
        if node.get("mesh") in empty:
            del node["mesh"]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<I4s", len(text), b"JSON")
    to.write_bytes(head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary)


def load_scene(path, smooth=False, **more):
    """The scene; with the file's normals if `smooth`; `more` goes into the scene's description."""
    return mitsuba_scene((part.placed(matrix) for _, matrix, parts in read_objects(path) for part in parts), smooth, **more)


def mitsuba_scene(parts, smooth=False, **more):
    """As `load_scene`, of parts in world space."""
    import mitsuba as mi
    scene = {"type": "scene", **more}
    for index, part in enumerate(parts):
        properties = mi.Properties()
        reflectance = {"type": "rgb", "value": [float(x) for x in part.albedo]}
        # One-sided: the plain diffuse BSDF is black from behind.
        diffuse = {"type": "diffuse", "reflectance": reflectance}
        properties["bsdf"] = mi.load_dict({"type": "twosided", "material": diffuse} if part.double_sided else diffuse)
        if max(part.emission) > 0:
            radiance = {"type": "rgb", "value": [float(x) for x in part.emission]}
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
        smoothed = smooth and part.normals is not None
        mesh = mi.Mesh(
            f"mesh{index}", len(part.positions), len(part.triangles), props=properties, has_vertex_normals=smoothed)
        parameters = mi.traverse(mesh)
        if smoothed:
            parameters["vertex_normals"] = part.normals.ravel()
        parameters["vertex_positions"] = part.positions.ravel()
        parameters["faces"] = part.triangles.astype("uint32").ravel()
        parameters.update()
        scene[f"shape{index}"] = mesh
    return mi.load_dict(scene)


def radiance_at(scene, origins, normals, seed, samples):
    """Mean incoming radiance by the cosine (irradiance / pi) per point, direct and indirect, with Mitsuba's own path integrator.

    Direct light by Mitsuba's emitter sampling and by cosine-distributed rays, combined by the balance heuristic; indirect light
    by its path integrator along those rays, with what they meet of the lamps and the sky themselves hidden."""
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

    def spread():
        """A pair of numbers for each ray, the first spread evenly over those of a point: it chooses among lamps, too."""
        pair = sampler.next_2d()
        return mi.Point2f((dr.arange(mi.UInt32, count * samples) % samples + pair.x) / samples, pair.y)

    sample, weight = scene.sample_emitter_direction(point, spread(), True)
    by_cosine = dr.maximum(0, dr.dot(sample.d, normal)) / dr.pi
    share = dr.select(sample.delta, 1, sample.pdf / (sample.pdf + by_cosine))
    direct = dr.select(by_cosine > 0, weight * by_cosine * share, 0)
    direction = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(spread()))
    ray = mi.RayDifferential3f(mi.Ray3f(origin, direction))
    integrator = mi.load_dict({"type": "path", "max_depth": 64, "rr_depth": 5})
    total, _, _ = integrator.sample(scene, sampler, ray)
    hit = scene.ray_intersect(ray)
    emitted = hit.emitter(scene).eval(hit)
    indirect = total - emitted
    met = mi.DirectionSample3f(scene, hit, point)
    by_cosine = dr.maximum(0, dr.dot(direction, normal)) / dr.pi
    by_emitter = scene.pdf_emitter_direction(point, met, met.emitter != None)  # noqa: E711
    direct += dr.select(by_cosine > 0, emitted * by_cosine / (by_cosine + by_emitter), 0)

    def mean(color):
        return np.stack([np.array(dr.block_sum(channel, samples)) for channel in color], 1) / samples

    return mean(direct), mean(indirect)


def prepare_service(args):
    """As `prepare`, with what the Python client of the service needs, and the service's binary."""
    python, environment = prepare(args.venv)
    subprocess.run([python, "-m", "pip", "install", "--quiet", "httpx", "OpenEXR"], check=True)
    args.work.mkdir(parents=True, exist_ok=True)
    if not args.binary:
        subprocess.run(["cargo", "build", "--release"], cwd=ROOT, check=True)
    environment["PYTHONPATH"] = str(ROOT / "clients/python/src")
    return python, environment, args.binary or ROOT / "target/release/rebake"


@contextmanager
def serving(binary):
    """The address of a service that runs meanwhile."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    command = [binary, "serve", "--listen", address]
    service = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield f"http://{address}"
    finally:
        service.terminate()
        service.wait()


@contextmanager
def served(binary):
    """A client of a service that runs meanwhile."""
    from rebake import Client
    with serving(binary) as server, Client(server, patience=60) as client:
        yield client


def baked(binary, files, samples, sky=None, **settings):
    """Per file positions, normals, areas, direct and indirect light of all elements, by a service that runs meanwhile."""
    import numpy as np
    with served(binary) as client:
        if sky:
            settings["sky"] = client.add_asset(sky).asset
        for file in files:
            scene = client.upload(file, bake=False, **settings)
            info = scene.bake(samples=samples)
            error, warnings = info.estimated_rmse, "; ".join(info.warnings)
            print(f"{Path(file).name}: {info.elements} elements, stated error {error:.4f} {warnings}", flush=True)
            elements = scene.elements()
            light = (np.array(scene.light_map(part=part).values) for part in ("direct", "indirect"))
            yield elements.position, elements.normal, elements.area, *light
