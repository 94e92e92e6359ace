#!/usr/bin/env python3
"""Holds rooms with textures against the same rooms with geometry in their place, and both against Mitsuba 3.

    python3 tests/mitsuba/textures.py [--samples 1024] [--paths 4096] [--spacing 0.1]

Three pairs, made here: a floor of black, red and white squares (base colour texture; one quad a square), a screen of four
colours (emissive texture; four quads), and a canopy with square holes (alpha mask; the quads that are left). Compared is the
light of the walls and the ceiling, area-weighted. Needs what sky.py needs. Ends with 1 where a pair differs by more than 4 %,
or a room from Mitsuba by more than 1 % and its error.
"""
import json
import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from common import arguments, baked, prepare_service, radiance_at  # noqa: E402

ROOM = (4.0, 3.0, 5.0)
SQUARES = 8
POINTS = 1500


def parse():
    parser = arguments(__doc__, "rebake", "mitsuba-textures")
    parser.add_argument("--samples", type=int, default=1024, help="rebake: samples per element")
    parser.add_argument("--paths", type=int, default=4096, help="Mitsuba: paths per point")
    parser.add_argument("--spacing", type=float, default=0.1, help="rebake: largest distance between elements, metres")
    return parser.parse_args()


def outside(args):
    python, environment, binary = prepare_service(args)
    options = [f"--{name}={getattr(args, name)}" for name in ("samples", "paths", "spacing")]
    again = [python, __file__, "--inside", "--binary", binary, "--work", args.work, *options]
    return subprocess.run(again, env=environment).returncode


def quad(corner, right, up, **look):
    """A quad that faces right x up: its corners and what it looks like (`albedo`, `emission`, `colors`, `alpha`, `name`)."""
    corner, right, up = map(tuple, (corner, right, up))
    add = lambda *vectors: tuple(map(sum, zip(*vectors)))  # noqa: E731
    corners = [corner, add(corner, right), add(corner, right, up), add(corner, up)]
    return {"albedo": (0.7, 0.7, 0.7), "emission": (0, 0, 0), "corners": corners, **look}


def tiles(corner, right, up, count, look):
    """A quad as count x count quads; `look(column, row)` is what each looks like, none where there is a hole."""
    part = lambda vector, k: tuple(x * k / count for x in vector)  # noqa: E731
    for row in range(count):
        for column in range(count):
            if (its := look(column, row)) is not None:
                at = tuple(map(sum, zip(corner, part(right, column), part(up, row))))
                yield quad(at, part(right, 1), part(up, 1), **its)


def walls(without_floor):
    x, y, z = ROOM
    sides = [
        quad((0, y, 0), (x, 0, 0), (0, 0, z), name="ceiling"), quad((0, 0, 0), (x, 0, 0), (0, y, 0), name="back"),
        quad((x, 0, z), (-x, 0, 0), (0, y, 0), name="front"), quad((0, 0, z), (0, 0, -z), (0, y, 0), name="left"),
        quad((x, 0, 0), (0, 0, z), (0, y, 0), name="right")]
    return sides if without_floor else [*sides, floor(albedo=(0.6, 0.6, 0.6))]


def floor(**look):
    x, _, z = ROOM
    return quad((0, 0, z), (x, 0, 0), (0, 0, -z), name="floor", **look)


def lamp():
    return quad((1.5, 2.9, 2.0), (1, 0, 0), (0, 0, 1), albedo=(0, 0, 0), emission=(8, 7, 6), name="lamp")


def rooms():
    """Name, the room with a texture, the same without."""
    colors = [(0, 0, 0), (0.8, 0.05, 0.05), (0.9, 0.9, 0.9)]
    of = lambda column, row: colors[(column + 2 * row) % 3]  # noqa: E731
    plain = floor()["corners"]
    right, up = [tuple(b - a for a, b in zip(plain[0], plain[k])) for k in (1, 3)]
    squares = list(tiles(plain[0], right, up, SQUARES, lambda c, r: {"albedo": of(c, r), "name": f"floor-{c}-{r}"}))
    yield "floor", [*walls(True), lamp(), floor(albedo=(1, 1, 1), colors=of)], [*walls(True), lamp(), *squares]

    shines = lambda column, row: [(6, 0, 0), (0, 4, 1), (0, 1, 8), (0, 0, 0)][(column // 4) + 2 * (row // 4)]  # noqa: E731
    at = ((1, 1, 0.05), (2, 0, 0), (0, 1.2, 0))
    dark = {"albedo": (0, 0, 0)}
    quarters = list(tiles(*at, 2, lambda c, r: {**dark, "emission": shines(4 * c, 4 * r), "name": f"screen-{c}-{r}"}))
    yield "screen", [*walls(False), quad(*at, **dark, shines=shines, name="screen")], [*walls(False), *quarters]

    stands = lambda column, row: (column + row) % 2 == 0  # noqa: E731
    canopy = ((0.5, 2, 4.0), (3, 0, 0), (0, 0, -3))
    left = list(tiles(*canopy, SQUARES, lambda c, r: {"both": True, "name": f"canopy-{c}-{r}"} if stands(c, r) else None))
    masked = quad(*canopy, both=True, alpha=stands, name="canopy")
    yield "canopy", [*walls(False), lamp(), masked], [*walls(False), lamp(), *left]


def png(size, texel):
    """A square picture; `texel(x, y)` has four bytes, rows from the top."""
    rows = b"".join(b"\0" + b"".join(bytes(texel(x, y)) for x in range(size)) for y in range(size))
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))  # noqa: E731
    head = struct.pack(">IIBBBBB", size, size, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def srgb(x):
    return round(255 * (12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055))


def linear(byte):
    x = byte / 255
    return x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4


def picture_of(one):
    """The picture of a quad, 64 x 64, and what it multiplies: a texel of square (column, row), rows from below."""
    step = 64 // SQUARES
    square = lambda x, y: (x // step, (63 - y) // step)  # noqa: E731
    if "colors" in one:
        return png(64, lambda x, y: [*(srgb(c) for c in one["colors"](*square(x, y))), 255]), (1, 1, 1)
    if "shines" in one:
        return png(64, lambda x, y: [*(srgb(c / 8) for c in one["shines"](*square(x, y))), 255]), (8, 8, 8)
    return png(64, lambda x, y: [255, 255, 255, 255 * one["alpha"](*square(x, y))]), one["albedo"]


def write_glb(quads, path):
    binary = bytearray()
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(quads)))}], "nodes": [], "meshes": [],
        "materials": [], "accessors": [], "bufferViews": [], "images": [], "textures": [],
        "samplers": [{"magFilter": 9728, "minFilter": 9728, "wrapS": 33071, "wrapT": 33071}],
        "extensionsUsed": ["KHR_materials_emissive_strength"]}

    def view(data):
        binary.extend(b"\0" * (-len(binary) % 4))
        document["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary.extend(data)
        return len(document["bufferViews"]) - 1

    def accessor(rows, kind, component, code, **more):
        data = b"".join(struct.pack(f"<{len(row)}{code}", *row) for row in rows)
        document["accessors"].append(
            {"bufferView": view(data), "componentType": component, "count": len(rows), "type": kind, **more})
        return len(document["accessors"]) - 1

    uv = accessor([(0, 1), (1, 1), (1, 0), (0, 0)], "VEC2", 5126, "f")
    indices = accessor([(k,) for k in (0, 1, 2, 0, 2, 3)], "SCALAR", 5125, "I")
    for index, one in enumerate(quads):
        low, high = ([f(corner[k] for corner in one["corners"]) for k in range(3)] for f in (min, max))
        position = accessor(one["corners"], "VEC3", 5126, "f", min=low, max=high)
        base = {"baseColorFactor": [*one["albedo"], 1], "metallicFactor": 0}
        material = {"pbrMetallicRoughness": base, "doubleSided": one.get("both", False)}
        strength = max(*one["emission"], 1)
        emission = [c / strength for c in one["emission"]]
        if any(key in one for key in ("colors", "shines", "alpha")):
            data, factor = picture_of(one)
            document["images"].append({"bufferView": view(data), "mimeType": "image/png"})
            document["textures"].append({"source": len(document["images"]) - 1, "sampler": 0})
            texture = {"index": len(document["textures"]) - 1}
            if "shines" in one:
                material["emissiveTexture"], emission, strength = texture, [1, 1, 1], factor[0]
            else:
                base["baseColorTexture"] = texture
            if "alpha" in one:
                material["alphaMode"] = "MASK"
        if any(emission):
            material["emissiveFactor"] = emission
            material["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
        document["materials"].append(material)
        attributes = {"POSITION": position, "TEXCOORD_0": uv}
        document["meshes"].append({"primitives": [{"attributes": attributes, "indices": indices, "material": index}]})
        document["nodes"].append({"mesh": index, "name": one["name"]})
    document = {key: value for key, value in document.items() if value != []}
    document["buffers"] = [{"byteLength": len(binary)}]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary.extend(b"\0" * (-len(binary) % 4))
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary)) + struct.pack("<I4s", len(text), b"JSON")
    path.write_bytes(head + text + struct.pack("<I4s", len(binary), b"BIN\0") + bytes(binary))


def mitsuba_scene(quads):
    """The same room, its pictures as bitmaps without interpolation."""
    import mitsuba as mi
    import numpy as np

    def bitmap(one, texel, scale=1.0):
        rows = [[texel(x // (64 // SQUARES), (63 - y) // (64 // SQUARES)) for x in range(64)] for y in range(64)]
        data = np.array(rows, np.float32).reshape(64, 64, -1) * scale
        return {"type": "bitmap", "bitmap": mi.Bitmap(data), "raw": True, "filter_type": "nearest", "wrap_mode": "clamp"}

    scene = {"type": "scene"}
    exact = lambda colors: lambda c, r: [linear(srgb(x)) for x in colors(c, r)]  # noqa: E731
    for index, one in enumerate(quads):
        reflectance = {"type": "rgb", "value": list(map(float, one["albedo"]))}
        if "colors" in one:
            reflectance = bitmap(one, exact(one["colors"]))
        bsdf = {"type": "diffuse", "reflectance": reflectance}
        if one.get("both"):
            bsdf = {"type": "twosided", "material": bsdf}
        if "alpha" in one:
            bsdf = {"type": "mask", "opacity": bitmap(one, lambda c, r: [float(one["alpha"](c, r))]), "nested": bsdf}
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(bsdf)
        radiance = {"type": "rgb", "value": list(map(float, one["emission"]))} if any(one["emission"]) else None
        if "shines" in one:
            radiance = bitmap(one, exact(lambda c, r: [x / 8 for x in one["shines"](c, r)]), 8.0)
        if radiance:
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
        mesh = mi.Mesh(f"mesh{index}", 4, 2, props=properties, has_vertex_texcoords=True)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = np.array(one["corners"], np.float32).ravel()
        # Mitsuba's bitmaps have their first row at v = 1.
        parameters["vertex_texcoords"] = np.array([0, 0, 1, 0, 1, 1, 0, 1], np.float32)
        parameters["faces"] = np.array([0, 1, 2, 0, 2, 3], np.uint32)
        parameters.update()
        scene[f"shape{index}"] = mesh
    return mi.load_dict(scene)


def inside(args):
    import mitsuba as mi
    import numpy as np
    mi.set_variant("llvm_ad_rgb")
    agree, rng = True, np.random.default_rng(1)
    made = list(rooms())
    files = []
    for name, *pair in made:
        for kind, quads in zip(("tex", "geo"), pair):
            files.append(args.work / f"{name}.{kind}.glb")
            write_glb(quads, files[-1])
    results = list(baked(args.binary, files, args.samples, spacing=args.spacing))
    for index, (name, textured, plain) in enumerate(made):
        (positions, normals, areas, *light), (positions_g, _, _, *light_g) = results[2 * index:2 * index + 2]
        # The walls and the ceiling come first in both.
        count = wall_elements(positions, positions_g)
        ours, others = (sum(one)[:count] for one in (light, light_g))
        weight = areas[:count, None]
        means = [(values * weight).sum(0) / weight.sum() for values in (ours, others)]
        pair = means[0].mean() / means[1].mean()
        scatter = np.sqrt((((ours - others) ** 2).mean(1) * weight[:, 0]).sum() / weight.sum()) / means[1].mean()
        chosen = rng.choice(count, POINTS, p=weight[:, 0] / weight.sum())
        origins = (positions[chosen] + 1e-4 * normals[chosen]).astype(np.float32)
        batch = max(1, min(args.paths // 8, 1_000_000 // POINTS))
        runs = range(max(2, args.paths // batch))
        scene = mitsuba_scene(textured)
        theirs = np.mean([sum(radiance_at(scene, origins, normals[chosen].astype(np.float32), k, batch)) for k in runs], 0)
        difference = (sum(light)[chosen] - theirs).mean(1)
        error = difference.std(ddof=1) / np.sqrt(POINTS) / theirs.mean()
        ratio = sum(light)[chosen].mean() / theirs.mean()
        print(f"{name:<8} textured over geometry {pair:.4f} (element by element {scatter:.4f}), "
              f"textured over Mitsuba {ratio:.4f} ± {error:.4f}")
        agree &= abs(pair - 1) < 0.04 and abs(ratio - 1) < 0.01 + 2 * error
    return 0 if agree else 1


def wall_elements(one, other):
    """How many elements both rooms begin with alike."""
    import numpy as np
    count = min(len(one), len(other))
    alike = np.all(one[:count] == other[:count], axis=1)
    return count if alike.all() else int(np.argmin(alike))


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    args = parse()
    sys.exit(inside(args) if args.inside else outside(args))
