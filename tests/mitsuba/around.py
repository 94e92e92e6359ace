#!/usr/bin/env python3
"""Holds the light around points, as spherical harmonics, against Mitsuba 3: probes in the air of a room, and its directional light map.

    python3 tests/mitsuba/around.py ROOM.glb [--points 200] [--paths 65536] [--samples 256]

Probes hold the radiance from all around, an element of the directional light map that which comes to the hemisphere above it. Here
Mitsuba's path integrator is asked along directions that are spread evenly, and its emitters are sampled. Probes stand between a
random element and what lies across from it. What blends is left out of the room. Needs what sky.py needs.

Prints, for every function of the basis, how much of it is there: the slope of ours over Mitsuba's, through zero, by points and colour
channels. Ends with 1 where one differs from 1 by more than 2 % and its error.
"""
import os
import struct
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from common import arguments, load_scene, prepare_service, serving, without_blending  # noqa: E402

NAMES = ["1", "y", "z", "x", "xy", "yz", "3z²-1", "xz", "x²-y²"]
FIRST_BAND = slice(1, 4)        # what a directional light map holds
BATCHES = 16                    # of Mitsuba's paths: their scatter is its error
PATHS_AT_ONCE = 1 << 22
FRAME = struct.Struct("<4sHHQQIIII")
HALF = 4                        # flag of frames that are not expected here


def parse():
    parser = arguments(__doc__, "rebake", "mitsuba-around")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--points", type=int, default=200, help="probes, and elements of the directional light map")
    parser.add_argument("--paths", type=int, default=65536, help="Mitsuba: paths per point")
    parser.add_argument("--samples", type=int, default=256, help="rebake: samples per element of the bake")
    parser.add_argument("--probe-samples", type=int, default=4096, help="rebake: samples per probe")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def outside(args):
    python, environment, binary = prepare_service(args)
    options = [f"--{name}={getattr(args, name.replace('-', '_'))}" for name in ("points", "paths", "samples", "probe-samples", "seed")]
    again = [python, __file__, "--inside", args.scene, "--binary", binary, "--work", args.work, *options]
    return subprocess.run(again, env=environment).returncode


def basis(direction):
    """The nine functions of docs/use.md, per direction."""
    import drjit as dr
    x, y, z = direction
    a, b, c, d, e = (dr.sqrt(k / dr.pi) for k in (1 / 4, 3 / 4, 15 / 4, 5 / 16, 15 / 16))
    return [a, b * y, b * z, b * x, c * x * y, c * y * z, d * (3 * z * z - 1), c * x * z, e * (x * x - y * y)]


def light_around(scene, origins, normals, paths, seed):
    """Coefficients (points, 9, 3) of the radiance that comes to each point, and the variance of each; only from above where there
    are normals."""
    import numpy as np
    samples = max(1, min(paths // BATCHES, PATHS_AT_ONCE // len(origins)))
    rounds = max(1, paths // (BATCHES * samples))
    batch = lambda k: np.mean(  # noqa: E731
        [coefficients(scene, origins, normals, samples, seed + k * rounds + r) for r in range(rounds)], 0, dtype=float)
    batches = np.array([batch(k) for k in range(BATCHES)])
    return batches.mean(0), batches.var(0, ddof=1) / BATCHES


def coefficients(scene, origins, normals, samples, seed):
    """One estimate: emitters by their own sampling and along even directions, by the balance heuristic; all other light along
    these."""
    import drjit as dr
    import mitsuba as mi
    import numpy as np
    count = len(origins)
    index = dr.repeat(dr.arange(mi.UInt32, count), samples)
    origin = dr.gather(mi.Point3f, mi.Point3f(origins.T.copy()), index)
    sampler = mi.load_dict({"type": "independent", "sample_count": samples})
    sampler.seed(seed, count * samples)
    point = dr.zeros(mi.SurfaceInteraction3f)
    point.p, point.t = origin, mi.Float(1)
    if normals is None:
        even, is_seen = 1 / (4 * dr.pi), lambda way: mi.Bool(True)
    else:
        normal = dr.gather(mi.Normal3f, mi.Normal3f(normals.T.copy()), index)
        point.n, point.sh_frame = normal, mi.Frame3f(normal)
        even, is_seen = 1 / (2 * dr.pi), lambda way: dr.dot(way, normal) > 0

    def spread():
        pair = sampler.next_2d()
        return mi.Point2f((dr.arange(mi.UInt32, count * samples) % samples + pair.x) / samples, pair.y)

    def told(way, light):
        """Means per point of light times each function."""
        light = dr.select(is_seen(way), light, 0)
        of = lambda y: np.stack([np.array(dr.block_sum(channel * y, samples)) for channel in light], 1)  # noqa: E731
        return np.stack([of(y) for y in basis(way)], 1) / samples

    sample, weight = scene.sample_emitter_direction(point, spread(), True)
    share = dr.select(sample.delta, 1, sample.pdf / (sample.pdf + even))
    found = told(sample.d, weight * share)
    if normals is None:
        direction = mi.warp.square_to_uniform_sphere(spread())
    else:
        direction = mi.Frame3f(normal).to_world(mi.warp.square_to_uniform_hemisphere(spread()))
    ray = mi.RayDifferential3f(mi.Ray3f(origin, direction))
    integrator = mi.load_dict({"type": "path", "max_depth": 64, "rr_depth": 5})
    total, _, _ = integrator.sample(scene, sampler, ray)
    hit = scene.ray_intersect(ray)
    emitted = hit.emitter(scene).eval(hit)
    met = mi.DirectionSample3f(scene, hit, point)
    by_emitter = scene.pdf_emitter_direction(point, met, met.emitter != None)  # noqa: E711
    straight = emitted * even / (even + by_emitter)
    return found + told(direction, (total - emitted + straight) / even)


def across(scene, elements, chosen, rng):
    """Points in the air, each somewhere between an element and what lies across from it."""
    import mitsuba as mi
    import numpy as np
    origins = (elements.position[chosen] + 1e-3 * elements.normal[chosen]).astype(np.float32)
    ways = elements.normal[chosen].astype(np.float32)
    ray = mi.Ray3f(mi.Point3f(origins.T.copy()), mi.Vector3f(ways.T.copy()))
    distance = np.array(scene.ray_intersect_preliminary(ray).t)
    distance = np.where(np.isfinite(distance), distance, 1.0)
    return origins + (distance * rng.uniform(0.1, 0.9, len(chosen)))[:, None] * ways


def directional_light(http, scene, count):
    """(elements, 3, 3): the coefficients of y, z and x of every element; and their stated error."""
    import numpy as np
    answer = http.get(f"/v1/scenes/{scene}/lightmap", params={"format": "raw", "part": "directional"})
    answer.raise_for_status()
    data, values = answer.content, []
    while data:
        magic, version, flags, _, _, runs, count_here, size, _ = FRAME.unpack_from(data)
        assert magic == b"RBKD" and version == 1 and not flags & HALF, (magic, version, flags)
        payload = data[FRAME.size:FRAME.size + size]
        values.append(np.frombuffer(payload, "<f4", 3 * count_here, 8 * runs).reshape(-1, 3))
        data = data[FRAME.size + size:]
    return np.concatenate(values).reshape(3, count, 3).swapaxes(0, 1), float(answer.headers["x-rebake-estimated-rmse"])


def report(title, names, places, ours, theirs, variances, own):
    """Prints what is there of each function, and where most of the difference is; whether all of it is there. `own` is our
    standard error."""
    import numpy as np
    print(title, flush=True)
    agrees = True
    for k, name in enumerate(names):
        a, b, noise = ours[:, k].astype(float), theirs[:, k], variances[:, k]
        # Noise of what is divided by makes a slope too small by as much as its square has of it.
        square = (b ** 2).sum() - noise.sum()
        slope = (a * b).sum() / square
        # By points: the channels of one go together.
        off = ((a - slope * b) * b).sum(1)
        error = np.sqrt((off ** 2).sum()) / square
        known = noise.mean() + (own[:, k] ** 2).mean()
        differs, squares = ((a - b) ** 2).mean(), ((a - b) ** 2).sum(1)
        worst = squares.argmax()
        print(f"  {name:>6}: {slope:.4f} ± {error:.4f} of it; root mean square {np.sqrt((b ** 2).mean()):.4f}, "
              f"off by {np.sqrt(differs):.4f}, known noise {np.sqrt(known):.4f}; {100 * squares[worst] / squares.sum():.0f} % of the "
              f"square at {' '.join(f'{x:.3f}' for x in places[worst])}: {a[worst].mean():.4f} and {b[worst].mean():.4f} there",
              flush=True)
        agrees &= abs(slope - 1) < 0.02 + 2 * error
    return agrees


def inside(args):
    import httpx
    import mitsuba as mi
    import numpy as np
    from rebake import Client
    mi.set_variant("llvm_ad_rgb")
    file, rng = args.work / f"{args.scene.stem}.glb", np.random.default_rng(args.seed)
    without_blending(args.scene, file)
    theirs = load_scene(file)
    with serving(args.binary) as server, Client(server, patience=60) as client, httpx.Client(base_url=server, timeout=600) as http:
        scene = client.upload(file, bake=False)
        scene.bake(samples=args.samples)
        elements = scene.elements()
        area = elements.area.astype(float)
        chosen = rng.choice(len(area), args.points, p=area / area.sum())
        places = across(theirs, elements, chosen, rng)
        body = {"points": places.astype(float).tolist(), "samples": args.probe_samples}
        answer = http.post(f"/v1/scenes/{scene.id}/probes", json=body)
        answer.raise_for_status()
        probes = answer.json()["probes"]
        directional, stated = directional_light(http, scene.id, len(area))
    # Where backs are seen the light is that of no place.
    is_free = np.array([probe["validity"] > 0.999 for probe in probes])
    ours = np.array([probe["coefficients"] for probe in probes])[is_free]
    own = np.array([probe["error"] for probe in probes], float)[is_free]
    there = places[is_free]
    mean, variance = light_around(theirs, there.astype(np.float32), None, args.paths, args.seed)
    # Cavities that are sealed have their neighbours' light here.
    lit = mean[:, 0].max(1) > 0
    title = f"{args.scene.stem}: {lit.sum()} of {args.points} probes, {(~lit).sum()} without light in Mitsuba left out"
    agrees = report(title, NAMES, there[lit], ours[lit], mean[lit], variance[lit], own[lit])
    normals = elements.normal[chosen].astype(np.float32)
    origins = (elements.position[chosen] + 1e-4 * normals).astype(np.float32)
    mean, variance = light_around(theirs, origins, normals, args.paths, args.seed + 1000)
    title = f"{args.scene.stem}: {args.points} elements of the directional light map"
    own = np.full((args.points, 3), stated)
    agrees &= report(title, NAMES[FIRST_BAND], origins, directional[chosen], mean[:, FIRST_BAND], variance[:, FIRST_BAND], own)
    return 0 if agrees else 1


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    args = parse()
    sys.exit(inside(args) if args.inside else outside(args))
