"""Edits of a room, chosen by chance: where objects and lamps have room, which of them change."""
TRIES = 400         # elements that are looked at for a place
AROUND = 32         # directions in which inserted objects and lamps need room


def choose(kind, room, state, rng):
    """An edit of that kind, or none where nothing can be done so."""
    return CHOICES[kind](room, state, rng)


def size_of(state):
    """Diagonal of the middle 98 % of all elements."""
    import numpy as np
    low, high = np.quantile(state.elements.position[state.elements.area > 0], (0.01, 0.99), axis=0)
    return float(np.linalg.norm(high - low))


def distances(scene, origins, directions):
    """How far the next surface is, infinite where there is none."""
    import mitsuba as mi
    import numpy as np
    ray = mi.Ray3f(mi.Point3f(origins.T.astype(np.float32)), mi.Vector3f(directions.T.astype(np.float32)))
    return np.array(scene.ray_intersect_preliminary(ray).t)


def lit_places(state, rng, upward=False):
    """Positions a little above elements that get some light, and their normals."""
    import numpy as np
    elements, light = state.elements, sum(state.light).mean(1)
    is_lit = (light > 0.1 * state.mean) & (elements.normal[:, 1] > 0.95 if upward else True)
    weight = np.where(is_lit, elements.area, 0.0).astype(float)
    if weight.sum() <= 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    chosen = rng.choice(len(weight), TRIES, p=weight / weight.sum())
    normals = elements.normal[chosen].astype(float)
    return elements.position[chosen] + 1e-3 * normals, normals


def free_place(room, state, rng):
    """A place in the air between lit surfaces, near none: beside a wall, a lamp's light comes from a spot that Mitsuba's paths
    seldom find."""
    import numpy as np
    size, scene, (places, normals) = size_of(state), room.scene(), lit_places(state, rng)
    reach = distances(scene, places, normals)
    middles = places + normals * (np.minimum(reach, size) * rng.uniform(0.3, 0.7, len(places)))[:, None]
    ways = rng.normal(size=(AROUND, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    room_around = distances(scene, np.repeat(middles, AROUND, 0), np.tile(ways, (len(middles), 1))).reshape(-1, AROUND).min(1)
    good = np.flatnonzero(np.isfinite(reach) & (room_around > 0.08 * size))
    return middles[good[0]] if len(good) else None


def insert(room, state, rng):
    """The asset, on something level, where it touches nothing."""
    import numpy as np
    from rebake import Insert
    places, normals = lit_places(state, rng, upward=True)
    if not room.assets or not len(places):
        return None
    asset, scene = next(iter(room.assets)), room.scene()
    height = np.minimum(0.4 * distances(scene, places, normals), 0.12 * size_of(state))
    angle = np.arange(AROUND) * 2 * np.pi / AROUND
    ways = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], 1)
    low, half = (places + [0, 1, 0] * height[:, None] * part for part in (0.1, 0.5))
    reach = [distances(scene, np.repeat(at, AROUND, 0), np.tile(ways, (TRIES, 1))).reshape(TRIES, AROUND).min(1)
             for at in (low, half)]
    good = np.flatnonzero((np.minimum(*reach) > 1.2 * height) & (height > 0.02 * size_of(state)))
    if not len(good):
        return None
    k = good[0]
    turn = rng.uniform(0, 2 * np.pi)
    matrix = np.eye(4)
    matrix[:3, :3] = height[k] * np.array(
        [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    matrix[:3, 3] = places[k]
    name = next(name for name in (f"inserted-{n}" for n in range(99)) if name not in room.things)
    return Insert(asset, name, matrix.round(6).tolist())


def movable(room, state, rng):
    """Names of objects that are neither small nor a part of the room itself, in any order."""
    import numpy as np
    size, names = size_of(state), []
    for name, thing in room.things.items():
        places = np.concatenate([part.positions for part in thing.placed()])
        extent = np.linalg.norm(places.max(0) - places.min(0))
        is_dark = all(max(part.emission) <= 0 for part in thing.parts)
        if is_dark and not thing.hidden and 0.06 * size < extent < 0.5 * size:
            names.append(name)
    return [str(name) for name in rng.permutation(names)]


def move(room, state, rng):
    """An object to where nothing stands in its way, sidewards."""
    import numpy as np
    from rebake import Move
    for name in movable(room, state, rng):
        scene, thing = room.scene(but=name), room.things[name]
        places = np.concatenate([part.positions for part in thing.placed()]).astype(float)
        middle, extent = (places.max(0) + places.min(0)) / 2, np.linalg.norm(places.max(0) - places.min(0))
        corners = places[rng.choice(len(places), min(len(places), 300), replace=False)]
        for angle in rng.uniform(0, 2 * np.pi, 8):
            way, far = np.array([np.cos(angle), 0, np.sin(angle)]), extent * rng.uniform(0.15, 0.5)
            starts = np.concatenate([corners + 0.02 * (middle - corners), [middle]])
            if distances(scene, starts, np.tile(way, (len(starts), 1))).min() > far * 1.05:
                matrix = np.array(thing.matrix, float)
                matrix[:3, 3] += (way * far).round(4)
                return Move(name, matrix.tolist())
    return None


def of_movable(make):
    def chosen(room, state, rng):
        names = movable(room, state, rng)
        return make(names[0]) if names else None
    return chosen


def remove(room, state, rng):
    from rebake import Remove
    return of_movable(Remove)(room, state, rng)


def hide(room, state, rng):
    from rebake import Hide
    return of_movable(Hide)(room, state, rng)


def show(room, state, rng):
    from rebake import Show
    names = [name for name, thing in room.things.items() if thing.hidden]
    return Show(names[-1]) if names else None


def material(room, state, rng):
    """One of the five largest objects by the area of its elements."""
    import numpy as np
    from rebake import Material
    areas = np.bincount(state.elements.object[state.elements.area > 0], state.elements.area[state.elements.area > 0])
    of = {one.name: areas[one.index] for one in state.info.objects if one.index < len(areas)}
    dark = [name for name in of if name in room.things and all(max(p.emission) <= 0 for p in room.things[name].parts)]
    largest = sorted(dark, key=lambda name: -of[name])[:5]
    return Material(tuple(rng.uniform(0.1, 0.85, 3).round(3).tolist()), str(rng.choice(largest)))


def insert_light(room, state, rng):
    """A lamp, by turns without and with a cone, that is about as bright as the light that is there."""
    import numpy as np
    from rebake import InsertLight, PointLight, SpotLight
    place = free_place(room, state, rng)
    if place is None:
        return None
    name = next(name for name in (f"lamp-{n}" for n in range(99)) if name not in room.lamps)
    strength = {"color": tuple(rng.uniform(0.5, 1, 3).round(3).tolist()),
                "intensity": float(np.pi * state.mean * (size_of(state) / 5) ** 2)}
    place = tuple(place.round(4).tolist())
    if name.endswith(("1", "3", "5")):
        return InsertLight(name, SpotLight(place, (0.2, -1, 0.1), **strength, inner_cone_angle=0.699, outer_cone_angle=0.7))
    return InsertLight(name, PointLight(place, **strength))


def move_light(room, state, rng):
    from rebake import MoveLight
    names = [name for name, lamp in room.lamps.items() if lamp.kind != "directional"]
    place = free_place(room, state, rng)
    return MoveLight(str(rng.choice(names)), tuple(place.round(4).tolist())) if names and place is not None else None


def relight(room, state, rng):
    """Any lamp, to between a quarter of its strength and twice that."""
    from rebake import LightChange
    names = [*room.lamps, *room.shining()]
    if not names:
        return None
    name = str(rng.choice(names))
    intensity = state.info.light(name).intensity * float(2 ** rng.uniform(-2, 1))
    return LightChange(name, tuple(rng.uniform(0.4, 1, 3).round(3).tolist()), intensity)


def remove_light(room, state, rng):
    """Any lamp, as long as one is left."""
    from rebake import RemoveLight
    names = [*room.lamps, *room.shining()]
    return RemoveLight(str(rng.choice(names))) if len(names) > 1 else None


CHOICES = {one.__name__: one for one in (
    insert, remove, move, material, relight, insert_light, move_light, remove_light, hide, show)}
