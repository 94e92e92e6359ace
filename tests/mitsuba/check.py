#!/usr/bin/env python3
"""Compares rebake's path tracer with Mitsuba 3 on a generated room: mean ratio and RMSE, with the noise of both.

    python3 tests/mitsuba/check.py [--paths 1024] [--venv DIR] [--binary PATH]

Makes a virtual environment with `mitsuba` and `numpy` from PyPI on the first run (beside the build, in target/mitsuba)
and needs LLVM's shared library for it (Debian: libllvm19). Ends with 1 where the two differ by more than their noise.
"""
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from common import ROOT, arguments, cargo, load_scene, prepare, radiance_at  # noqa: E402


def parse():
    parser = arguments(__doc__, "example path_points", "mitsuba-check")
    parser.add_argument("--paths", type=int, default=1024, help="paths per element, both renderers")
    return parser.parse_args()


def outside(args):
    """Makes the environment, renders with rebake, and goes on inside the environment."""
    python, environment = prepare(args.venv)
    example = ["--manifest-path", ROOT / "lab/Cargo.toml", "--example", "path_points"]
    command = [args.binary] if args.binary else cargo(*example)
    subprocess.run([*command, str(args.work), str(args.paths)], check=True)
    again = [python, __file__, "--inside", "--paths", str(args.paths), "--work", str(args.work)]
    return subprocess.run(again, env=environment).returncode


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
    args = parse()
    sys.exit(inside(args) if args.inside else outside(args))
