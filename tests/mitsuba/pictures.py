#!/usr/bin/env python3
"""Holds `rebake render` against Mitsuba 3: the same scene, camera and size; RMSE and FLIP by `rebake compare`.

    python3 tests/mitsuba/pictures.py SCENE.glb [--size 480x270] [--paths 512] [--spacing 0.03] [--samples 256]

The scene is a binary glTF, lit by emissive surfaces, with a camera. Two pictures of Mitsuba's with different seeds tell
how much of the difference is its own noise. Pictures and the sheet of differences stay in the work folder. Needs what
check.py needs.
"""
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from common import arguments, cargo, load_scene, nodes, prepare, read_document  # noqa: E402


def parse():
    parser = arguments(__doc__, "rebake", "mitsuba-pictures")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--size", default="480x270")
    parser.add_argument("--paths", type=int, default=512, help="Mitsuba: paths per pixel")
    parser.add_argument("--spp", type=int, default=64, help="rebake: samples per pixel")
    parser.add_argument("--samples", type=int, default=256, help="rebake: samples per element of the bake")
    parser.add_argument("--spacing", type=float, help="rebake: largest distance between elements, metres")
    return parser.parse_args()


def outside(args):
    python, environment = prepare(args.venv)
    rebake = [args.binary] if args.binary else cargo()
    args.work.mkdir(parents=True, exist_ok=True)
    work = args.work / args.scene.stem
    again = [python, __file__, "--inside", args.scene, "--size", args.size, "--paths", str(args.paths), "--work", args.work]
    subprocess.run(again, env=environment, check=True)
    bake = ["--samples", str(args.samples), "--spp", str(args.spp), "--size", args.size]
    bake += ["--spacing", str(args.spacing)] if args.spacing else []
    subprocess.run([*rebake, "render", args.scene, "-o", f"{work}.rebake.exr", *bake], check=True)
    for name, other in ("rebake", "rebake"), ("Mitsuba, another seed", "again"):
        print(f"{args.scene.name}, {name} against Mitsuba:", flush=True)
        files = [f"{work}.mitsuba.exr", f"{work}.{other}.exr", "-o", f"{work}.{other}.png"]
        subprocess.run([*rebake, "compare", *files], check=True)


def camera(path):
    """Camera to world and the vertical field of view of the first camera, degrees."""
    import numpy as np
    document, _ = read_document(path)
    node, world = next((node, world) for node, world in nodes(document) if "camera" in node)
    lens = document["cameras"][node["camera"]]["perspective"]
    return world, np.degrees(lens["yfov"])


def inside(args):
    import mitsuba as mi
    import numpy as np
    mi.set_variant("llvm_ad_rgb")
    width, height = map(int, args.size.split("x"))
    matrix, fov = camera(args.scene)
    # glTF's cameras look along -z with x to the right, Mitsuba's along +z with x to the left.
    to_world = mi.ScalarTransform4f((matrix @ np.diag([-1, 1, -1, 1])).tolist())
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    sensor = {"type": "perspective", "fov": float(fov), "fov_axis": "y", "to_world": to_world, "film": film, "near_clip": 1e-3}
    scene = load_scene(args.scene, smooth=True, sensor=sensor)
    integrator = mi.load_dict({"type": "path", "max_depth": 64, "rr_depth": 8})
    # In passes: memory goes with pixels times paths.
    batch = max(1, min(args.paths, 16_000_000 // (width * height)))
    for seed, name in enumerate(("mitsuba", "again")):
        passes = -(-args.paths // batch)
        images = (mi.render(scene, integrator=integrator, spp=batch, seed=seed * 10_000 + k) for k in range(passes))
        mean = sum(np.array(image, np.float64) for image in images) / passes
        mi.Bitmap(mean.astype(np.float32)).write(f"{args.work / args.scene.stem}.{name}.exr")


if __name__ == "__main__":
    args = parse()
    inside(args) if args.inside else outside(args)
