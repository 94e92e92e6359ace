#!/usr/bin/env python3
"""Holds the light of a real room after its bake and after each of a row of edits and the error stated with it, against Mitsuba 3.

    python3 tests/mitsuba/edits.py ROOM.glb [--asset OBJECT.glb] [--row insert,move,relight] [--seed 1] [--points 2000]

Every edit is applied to the room here, too (room.py), and Mitsuba lights what comes of that at elements drawn by their area.
Where edits go is chosen by chance (choice.py). Elements whose own point tells little (places.py) are counted apart. What blends
is left out of the room; emissive surfaces are to shine to one side and evenly. Needs what sky.py needs.

Ends with 1 where, by more than chance explains, light differs by more than 1 % on the mean, the stated error is not within 2/3
and 3/2 of the true one, or more than 1 % of the elements are off by more than three times their error. The worst of these are
named with what is around them: `near`, the share of the hemisphere that lies within a spacing, and `alike`, how many elements
of the object hold the same to the last bit: what a surface hides takes its neighbours' light.
"""
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from choice import choose  # noqa: E402
from common import arguments, prepare_service, radiance_at, served, without_blending  # noqa: E402
from places import kinds_of  # noqa: E402
from room import read_room  # noqa: E402

ROW = "insert,insert_light,move,material,move_light,relight,hide,remove,remove_light"
BATCHES = 32        # of Mitsuba's paths at a point: their scatter is its error
UNKNOWN = 0.5       # relative error of the true error, due to Mitsuba's noise and few bad elements, from which it tells nothing
OPTIONS = {"asset": Path, "row": str, "seed": int, "points": int, "paths": int, "samples": int, "edit_samples": int,
           "elements": int, "offset": float, "worst": int}


def parse():
    parser = arguments(__doc__, "rebake", "mitsuba-edits")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--asset", type=Path, help="what `insert` inserts, its base at the origin")
    parser.add_argument("--row", default=ROW, help="kinds of the edits, one after the other")
    parser.add_argument("--seed", type=int, default=1, help="of the choices and of the elements")
    parser.add_argument("--points", type=int, default=2000)
    parser.add_argument("--paths", type=int, default=1024, help="Mitsuba: paths per point")
    parser.add_argument("--samples", type=int, default=64, help="rebake: samples per element of the bake")
    parser.add_argument("--edit-samples", type=int, help="rebake: samples per element of edits; default: the service's budget")
    parser.add_argument("--elements", type=int, help="rebake: how many")
    parser.add_argument("--offset", type=float, default=2e-5, help="how far off the surface Mitsuba looks, metres")
    parser.add_argument("--worst", type=int, default=4, help="how many elements to name in a state out of bounds")
    parser.add_argument("--keep", action="store_true", help="write every state to a file in --work")
    return parser.parse_args()


def outside(args):
    python, environment, binary = prepare_service(args)
    given = ((name, getattr(args, name)) for name in OPTIONS)
    options = [f"--{name.replace('_', '-')}={value}" for name, value in given if value is not None]
    options += ["--keep"] if args.keep else []
    again = [python, __file__, "--inside", args.scene, "--binary", binary, "--work", args.work, *options]
    return subprocess.run(again, env=environment).returncode


@dataclass
class State:
    """What the service tells of a state."""
    info: object
    elements: object
    light: list         # direct, indirect
    error: object       # per element

    @property
    def mean(self):
        return sum(light.mean(1) for light in self.light) @ self.elements.area / self.elements.area.sum()

    def owner(self, element):
        index = self.elements.object[element]
        return next((found.name for found in self.info.objects if found.index == index), "?")


def read_state(scene):
    info = scene.wait()
    light = [scene.light_map(part=part).values for part in ("direct", "indirect")]
    return State(info, scene.elements(), light, scene.light_map(part="error").values[:, 0])


@dataclass
class Comparison:
    """Elements with their stated errors; ours less Mitsuba's light (points, 3), Mitsuba's and the variance of its mean over RGB:
    of direct, indirect and all light."""
    chosen: object
    error: object
    differences: list
    theirs: list
    variances: list

    def keep(self, mask):
        parts = [[one[mask] for one in several] for several in (self.differences, self.theirs, self.variances)]
        return Comparison(self.chosen[mask], self.error[mask], *parts)

    @property
    def squares(self):
        """Per point: squared error of all light, without Mitsuba's own."""
        return (self.differences[2] ** 2).mean(1) - self.variances[2]

    @property
    def z(self):
        import numpy as np
        square = self.error ** 2 + self.variances[2]
        return np.sqrt((self.differences[2] ** 2).mean(1) / np.maximum(square, 1e-30))


def compare(state, scene, args):
    """`args.points` elements, drawn by area, against Mitsuba's scene."""
    import numpy as np
    elements, rng = state.elements, np.random.default_rng(args.seed)
    chosen = rng.choice(len(elements.area), args.points, p=elements.area / elements.area.sum(dtype=float))
    normals = elements.normal[chosen].astype(np.float32)
    origins = (elements.position[chosen] + args.offset * normals).astype(np.float32)
    many = [np.repeat(one, BATCHES, 0) for one in (origins, normals)]
    found = radiance_at(scene, *many, args.seed, max(2, args.paths // BATCHES))
    batches = [one.reshape(args.points, BATCHES, 3) for one in (*found, sum(found))]
    theirs = [one.mean(1, dtype=float) for one in batches]
    assert np.isfinite(theirs).all(), "Mitsuba's light is no number"
    variances = [one.var(1, ddof=1, dtype=float).mean(1) / BATCHES for one in batches]
    ours = [light[chosen].astype(float) for light in (*state.light, sum(state.light))]
    return Comparison(chosen, state.error[chosen], [a - b for a, b in zip(ours, theirs)], theirs, variances)


def root(square):
    return max(square, 0.0) ** 0.5


def means(comparison):
    """Ours over Mitsuba's mean light, with its error, of direct, indirect and all light."""
    import numpy as np
    for difference, theirs in zip(comparison.differences, comparison.theirs):
        mean, each = max(theirs.mean(), 1e-30), difference.mean(1)
        yield 1 + each.mean() / mean, each.std(ddof=1) / np.sqrt(len(each)) / mean


def report(state, comparison):
    """Prints how a state compares; what is out of bounds, as words."""
    import numpy as np
    count, broken, ratios = len(comparison.chosen), [], list(means(comparison))
    ratio, error = ratios[2]
    if abs(ratio - 1) > max(0.01, 3 * error):
        broken.append(f"mean {100 * (ratio - 1):+.1f} %")
    quotient, error, usual = quotients(comparison)
    if error < UNKNOWN and not (2 / 3) * (1 - 2 * error) < quotient < 1.5 * (1 + 2 * error):
        broken.append(f"stated/true {quotient:.2f}")
    far = (comparison.z > 3).mean()
    if far > 0.01 + 2 * np.sqrt(0.01 / count):
        broken.append(f"|z| > 3: {100 * far:.1f} %")
    parts = ", ".join(f"{part} {a:.4f} ± {b:.4f}" for part, (a, b) in zip(("direct", "indirect", "all"), ratios))
    print(f"  {state.info.live_elements} elements, {count} compared: {parts}\n"
          f"  {errors(comparison)}, stated/true {quotient:.2f} ± {error * quotient:.2f}, without the worst 0.1 % {usual:.2f}; "
          f"|z| > 3: {100 * far:.2f} %{'  OUT: ' + ', '.join(broken) if broken else ''}", flush=True)
    return broken


def quotients(comparison):
    """Stated over true error of these elements, its relative error, and the quotient without the worst 0.1 % of them."""
    import numpy as np
    squares, stated = comparison.squares, comparison.error.astype(float) ** 2
    count, true = len(squares), root(squares.mean())
    rest = np.argsort(squares)[:count - max(1, count // 1000)]
    error = squares.std(ddof=1) / np.sqrt(count) / max(2 * true ** 2, 1e-30)
    return root(stated.mean()) / (true or np.nan), error, root(stated[rest].mean()) / (root(squares[rest].mean()) or np.nan)


def errors(comparison):
    stated, own = (root(square.mean()) for square in (comparison.error.astype(float) ** 2, comparison.variances[2]))
    return f"stated {stated:.4g}, true {root(comparison.squares.mean()):.4g} (Mitsuba's own {own:.4g})"


def report_apart(comparison, kinds, stated):
    """Prints how all elements compare with the scene's stated error, and those that do not count."""
    print(f"  of all {len(kinds)}: {errors(comparison)}, |z| > 3: {100 * (comparison.z > 3).mean():.2f} %; "
          f"the scene states {stated:.4g}")
    for kind in ("inside", "edge", "cut off"):
        few = comparison.keep(kinds == kind)
        if len(few.chosen):
            print(f"  apart, {kind}: {len(few.chosen)}, mean of theirs {few.theirs[2].mean():.4g}, "
                  f"off {few.differences[2].mean():+.4g} and {root(few.squares.mean()):.4g} by root mean square, "
                  f"|z| > 3: {100 * (few.z > 3).mean():.0f} %")
    dark = comparison.keep((comparison.theirs[2].max(1) <= 0) & (kinds == "open"))
    if len(dark.chosen):
        print(f"  of those compared without any light in Mitsuba: {len(dark.chosen)}, ours {dark.differences[2].mean():.4g}, "
              f"|z| > 3: {100 * (dark.z > 3).mean():.0f} %")


def name_worst(state, comparison, scene, many):
    """Prints those of the largest error and those of the largest z."""
    import numpy as np
    positive = np.maximum(comparison.squares, 0)
    share = positive / max(positive.sum(), 1e-30)
    shown = [*np.argsort(-share)[:many], *np.argsort(-comparison.z)[:many]]
    for k in dict.fromkeys(int(k) for k in shown):
        element, elements = comparison.chosen[k], state.elements
        place, normal = elements.position[element], elements.normal[element]
        text = " ".join(f"{x:.3f}" for x in place) + " n " + " ".join(f"{x:.2f}" for x in normal)
        direct, indirect, _ = (difference[k].mean() for difference in comparison.differences)
        theirs = [light[k].mean() for light in comparison.theirs]
        print(f"    z {comparison.z[k]:5.1f}, {100 * share[k]:4.1f} % of the square: {state.owner(element)} {element} at {text}, "
              f"area {elements.area[element]:.1e}, near {near(scene, place, normal, state.info.spacing):.2f}, "
              f"alike {alike(state, element)}: theirs {theirs[0]:.4g} + {theirs[1]:.4g}, off {direct:+.4g} {indirect:+.4g}, "
              f"stated {comparison.error[k]:.4g}, Mitsuba's {comparison.variances[2][k] ** 0.5:.4g}")


def alike(state, element):
    """Other elements of its object that hold the same light."""
    same = state.elements.object == state.elements.object[element]
    for light in state.light:
        same = same & (light == light[element]).all(1)
    return int(same.sum()) - 1


def near(scene, place, normal, spacing, rays=256):
    """Share of the hemisphere, by the cosine, in which something is nearer than the spacing."""
    import mitsuba as mi
    import numpy as np
    rng = np.random.default_rng(1)
    local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(rng.random((2, rays)).astype(np.float32)))
    direction = mi.Frame3f(mi.Normal3f(*map(float, normal))).to_world(local)
    origin = mi.Point3f(*(float(x) for x in place + 2e-5 * normal))
    return float(np.mean(np.array(scene.ray_intersect_preliminary(mi.Ray3f(origin, direction)).t) < spacing))


def check(name, scene, room, args):
    """Compares the scene as it is, and tells where it is out of bounds."""
    state, theirs = read_state(scene), room.scene()
    found = compare(state, theirs, args)
    kinds = kinds_of(state, theirs, room, found.chosen, found.theirs[2].max(1) <= 0)
    print(name)
    comparison = found.keep(kinds == "open")
    broken = report(state, comparison)
    report_apart(found, kinds, state.info.estimated_rmse)
    if broken:
        name_worst(state, comparison, theirs, args.worst)
    if args.keep:
        keep(args.work / f"{name.replace(' ', '-').replace('/', '-')[:60]}.npz", state, found, kinds)
    return state, [f"{name}: {word}" for word in broken]


def keep(path, state, found, kinds):
    """All of a state, to look into."""
    import numpy as np
    elements = state.elements
    np.savez(path, position=elements.position, normal=elements.normal, area=elements.area, object=elements.object,
             direct=state.light[0], indirect=state.light[1], error=state.error, chosen=found.chosen, kinds=kinds,
             theirs=found.theirs, variances=found.variances, names=[one.name for one in state.info.objects])


def words(edit):
    """An edit in a few words."""
    import numpy as np
    fields = {key: value for key, value in vars(edit).items() if value is not None and key not in ("asset", "range")}
    if "transform" in fields:
        fields["transform"] = np.array(fields["transform"])[:3, 3]
    if "light" in fields and not isinstance(fields["light"], str):
        fields |= {"light": fields["light"].kind, "at": fields["light"].position, "strength": fields["light"].intensity}
    number = lambda x: f"{x:.4g}" if isinstance(x, float) else str(x)  # noqa: E731
    text = lambda x: number(x) if isinstance(x, (str, float)) else ",".join(number(float(y)) for y in x)  # noqa: E731
    return " ".join([type(edit).__name__, *map(text, fields.values())])


def inside(args):
    import mitsuba as mi
    import numpy as np
    mi.set_variant("llvm_ad_rgb")
    file = args.work / f"{args.scene.stem}.glb"
    without_blending(args.scene, file)
    room, rng = read_room(file), np.random.default_rng(args.seed)
    settings = {"elements": args.elements} if args.elements else {}
    with served(args.binary) as client:
        if args.asset:
            room.assets[client.add_asset(args.asset).asset] = args.asset
        scene = client.upload(file, bake=False, **settings)
        scene.bake(samples=args.samples)
        state, broken = check(f"{args.scene.stem}: bake", scene, room, args)
        for k, kind in enumerate([kind for kind in args.row.split(",") if kind], 1):
            edit = choose(kind, room, state, rng)
            if edit is None:
                print(f"{k} {kind}: nothing here that it could be done to")
                continue
            scene.edit(edit, samples=args.edit_samples).wait()
            room.apply(edit)
            state, more = check(f"{args.scene.stem}: {k} {words(edit)}", scene, room, args)
            broken += more
    print("\n".join(["all states within bounds"] if not broken else ["out of bounds:", *broken]))
    return 1 if broken else 0


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    args = parse()
    sys.exit(inside(args) if args.inside else outside(args))
