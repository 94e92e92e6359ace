#!/usr/bin/env python3
"""Holds the light of a sky and of a sun with a disc against Mitsuba 3, at elements of a scene that the service has baked.

    python3 tests/mitsuba/sky.py SCENE.glb [--points 3000] [--paths 1024] [--samples 256] [--sun-angle 2]

The sky is made here: a horizon that is brighter to one side, a dark ground, a bright patch, turned by 40 degrees. The sun is
the file's directional light. What blends is left out of the scene. Needs what check.py needs, and httpx for the Python client.
Ends with 1 where the mean of direct or of indirect light differs by more than 1 % and its error.
"""
import os
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from common import (  # noqa: E402
    arguments, baked, load_scene, nodes, prepare_service, radiance_at, read_document, without_blending)

SKY_TURN = 40.0
DISC = 64           # directions that stand for the sun's disc


def parse():
    parser = arguments(__doc__, "rebake", "mitsuba-sky")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--points", type=int, default=3000)
    parser.add_argument("--paths", type=int, default=1024, help="Mitsuba: paths per point")
    parser.add_argument("--samples", type=int, default=256, help="rebake: samples per element")
    parser.add_argument("--spacing", type=float, help="rebake: largest distance between elements, metres")
    parser.add_argument("--sun-angle", type=float, default=2.0, help="diameter of the sun's disc, degrees")
    return parser.parse_args()


def outside(args):
    python, environment, binary = prepare_service(args)
    options = [f"--{name}={getattr(args, name.replace('-', '_'))}" for name in ("points", "paths", "samples", "sun-angle")]
    options += [f"--spacing={args.spacing}"] if args.spacing else []
    again = [python, __file__, "--inside", args.scene, "--binary", binary, "--work", args.work, *options]
    return subprocess.run(again, env=environment).returncode


def sky_picture():
    """Equirectangular radiance, up at the top: rows, columns, RGB."""
    import numpy as np
    height, width = 128, 256
    v, u = (np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width
    up = np.cos(np.pi * v)[:, None]
    side = np.cos(2 * np.pi * (u - 0.7))[None, :]
    horizon = np.exp(-((up - 0.1) / 0.25) ** 2) * (1.2 + side)
    patch = 40 * np.exp(-((v[:, None] - 0.3) ** 2 + (0.5 * (u[None, :] - 0.35)) ** 2) / 0.002)
    grey = np.where(up > 0, 0.6 + 0.5 * up + horizon, 0.1) + patch
    return (grey[..., None] * np.array([0.9, 1.0, 1.3])).astype(np.float32)


def sun_of(path):
    """Direction to the sun and its irradiance across the light, per channel."""
    import numpy as np
    document, _ = read_document(path)
    lights = document["extensions"]["KHR_lights_punctual"]["lights"]
    for node, world in nodes(document):
        index = node.get("extensions", {}).get("KHR_lights_punctual", {}).get("light")
        if index is not None and lights[index]["type"] == "directional":
            light = lights[index]
            to_sun = world[:3, 2] / np.linalg.norm(world[:3, 2])
            return to_sun, np.array(light.get("color", [1, 1, 1])) * light.get("intensity", 1)
    raise SystemExit("the scene has no directional light")


def inside(args):
    import mitsuba as mi
    import numpy as np
    mi.set_variant("llvm_ad_rgb")
    file, sky = args.work / f"{args.scene.stem}.glb", args.work / "sky.exr"
    without_blending(args.scene, file)
    picture = sky_picture()
    mi.Bitmap(picture).write(str(sky))
    settings = {"sky_rotation": SKY_TURN, "sun_angle": args.sun_angle}
    settings |= {"spacing": args.spacing} if args.spacing else {}
    (positions, normals, areas, *ours), = baked(args.binary, [file], args.samples, sky, **settings)
    rng = np.random.default_rng(1)
    chosen = rng.choice(len(areas), args.points, p=areas / areas.sum())
    # A lamp that shines from +z of its picture's middle there is at +x here.
    turn = mi.ScalarTransform4f().rotate([0, 1, 0], 90 + SKY_TURN)
    lights = {"sky": {"type": "envmap", "bitmap": mi.Bitmap(picture), "to_world": turn}}
    to_sun, irradiance = sun_of(args.scene)
    across = np.cross(to_sun, [0.3, 0.5, 0.8])
    across /= np.linalg.norm(across)
    other = np.cross(to_sun, across)
    for k in range(DISC):
        # A spiral that covers the disc evenly.
        r, angle = np.tan(np.radians(args.sun_angle / 2)) * np.sqrt((k + 0.5) / DISC), 2.399963 * k
        way = to_sun + r * (np.cos(angle) * across + np.sin(angle) * other)
        lights[f"sun{k}"] = {
            "type": "directional", "direction": [float(x) for x in -way], "sampling_weight": 1 / DISC,
            "irradiance": {"type": "rgb", "value": [float(x) / DISC for x in irradiance]}}
    scene = load_scene(file, **lights)
    origins = (positions[chosen] + 1e-4 * normals[chosen]).astype(np.float32)
    batch = max(1, min(args.paths // 8, 2_000_000 // args.points))
    runs = range(max(2, args.paths // batch))
    theirs = np.mean([radiance_at(scene, origins, normals[chosen].astype(np.float32), seed, batch) for seed in runs], 0)
    print(f"{args.points} elements by area, {batch * len(runs)} paths each in Mitsuba")
    agree = True
    for name, here, there in zip(("direct", "indirect"), ours, theirs):
        difference = (here[chosen] - there).mean(1)
        error = difference.std(ddof=1) / np.sqrt(len(difference)) / there.mean()
        ratio = here[chosen].mean() / there.mean()
        print(f"{name:<10} mean {there.mean():.4f}, ratio {ratio:.5f} ± {error:.5f}")
        agree &= abs(ratio - 1) < 0.01 + 2 * error
    return 0 if agree else 1


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    args = parse()
    sys.exit(inside(args) if args.inside else outside(args))
