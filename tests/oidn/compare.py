#!/usr/bin/env python3
"""Filtered light beside Intel Open Image Denoise: the same atlas as stored, with rebake's filter, and through RTLightmap.

    pip install numpy OpenEXR pyoidn
    compare.py PATH/TO/rebake [--samples 4,8,16,64] [--reference 1024] SCENE.glb=SPACING ...

The truth is a bake of another seed. Errors are RMSE over the texels that were read from a surface, of all and without the
worst 1 %; OIDN fills what it is given as black, so texels beside surfaces are those of the page, which is dilated."""
import argparse, os, subprocess, sys, tempfile
import numpy as np
import OpenEXR
import pyoidn


def pages(binary, file, spacing, samples, seed, name):
    with tempfile.TemporaryDirectory() as folder:
        command = [binary, "bake", file, "--atlas", folder, "--spacing", spacing, "--samples", str(samples), "--seed", str(seed)]
        subprocess.run(command + ["--filter", name], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        found = sorted(f for f in os.listdir(folder) if f.endswith(".exr"))
        return [read(os.path.join(folder, f)) for f in found]


def read(path):
    with OpenEXR.File(path, separate_channels=True) as file:
        channels = {name: np.asarray(channel.pixels, np.float32) for name, channel in file.channels().items()}
    return np.stack([channels[c] for c in "RGB"], -1), channels["valid"] > 0.5


def denoise(page):
    return pyoidn.denoise(np.ascontiguousarray(page), filter_type=pyoidn.OIDN_FILTER_TYPE_RT_LIGHTMAP)


def errors(found, truth):
    squares = np.sort(np.concatenate([((a - b[0]) ** 2).mean(-1)[b[1]] for a, b in zip(found, truth)]))
    return np.sqrt(squares.mean()), np.sqrt(squares[: len(squares) * 99 // 100].mean())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("scenes", nargs="+", metavar="SCENE.glb=SPACING")
    parser.add_argument("--samples", default="4,8,16,64")
    parser.add_argument("--reference", type=int, default=1024)
    options = parser.parse_args()
    print("| scene | samples | stored | filtered | OIDN | filtered / stored | OIDN / stored |\n|---|---|---|---|---|---|---|")
    for scene in options.scenes:
        file, spacing = scene.rsplit("=", 1)
        truth = pages(options.binary, file, spacing, options.reference, 2, "none")
        for samples in map(int, options.samples.split(",")):
            stored = [page for page, _ in pages(options.binary, file, spacing, samples, 1, "none")]
            filtered = [page for page, _ in pages(options.binary, file, spacing, samples, 1, "statistical")]
            found = [errors(pages, truth) for pages in (stored, filtered, [denoise(page) for page in stored])]
            cells = [f"{all:.5f} ({most:.5f})" for all, most in found]
            ratios = [f"{f[0] / found[0][0]:.2f} ({f[1] / found[0][1]:.2f})" for f in found[1:]]
            print("|", " | ".join([os.path.basename(file), str(samples)] + cells + ratios), "|", flush=True)


if __name__ == "__main__":
    sys.exit(main())
