"""Which elements stand where their point tells little of their surface: inside solids, on the edge to another surface, cut off.

What these hold is right where light is read from them, beside them, and not at their own point; an element behind a surface takes
its neighbours' light.
"""
EDGE = 0.02         # spacings: another surface that is nearer is touched
LIFT = 0.05         # spacings: how high above the surface neighbours look for each other
NEIGHBOURS = 6


def kinds_of(state, scene, room, chosen, is_dark):
    """Per chosen element `inside`, `edge`, `cut off` or `open`; only what is dark can be inside."""
    import numpy as np
    places = state.elements.position[chosen].astype(float)
    normals = state.elements.normal[chosen].astype(float)
    kinds = np.full(len(chosen), "open", dtype="<U8")
    kinds[touching(scene, places, normals, state.info.spacing)] = "edge"
    kinds[cut_off(state, scene, chosen)] = "cut off"
    things = [thing for thing in room.things.values() if not thing.hidden]
    for k in np.flatnonzero(is_dark):
        if any(is_inside(places[k] + 1e-4 * normals[k], thing) for thing in things):
            kinds[k] = "inside"
    return kinds


def is_inside(point, thing):
    """Whether a point is inside an object: the solid angle of its triangles, seen from there, is most of the sphere."""
    import numpy as np
    total = 0.0
    for part in thing.placed():
        a, b, c = (part.positions.astype(float)[part.triangles[:, k]] - point for k in range(3))
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        triple = np.einsum("ij,ij->i", a, np.cross(b, c))
        dots = (np.einsum("ij,ij->i", p, q) * length for p, q, length in ((a, b, lc), (b, c, la), (c, a, lb)))
        total += np.arctan2(triple, la * lb * lc + sum(dots)).sum() / (2 * np.pi)
    return abs(total) > 0.5


def frames(normals):
    """Two directions along each surface."""
    import numpy as np
    other = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = np.cross(normals, other)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)


def is_blocked(scene, starts, ends):
    """Whether something stands between."""
    import mitsuba as mi
    import numpy as np
    way = ends - starts
    length = np.linalg.norm(way, axis=1)
    direction = way / np.maximum(length, 1e-12)[:, None]
    ray = mi.Ray3f(*(kind(one.T.astype(np.float32)) for kind, one in ((mi.Point3f, starts), (mi.Vector3f, direction))))
    ray.maxt = mi.Float(length.astype(np.float32))
    return np.array(scene.ray_test(ray))


def touching(scene, places, normals, spacing, ways=8):
    """Whether another surface meets theirs where they are."""
    import numpy as np
    first, second = frames(normals)
    above, reach = places + 0.1 * EDGE * spacing * normals, EDGE * spacing
    found = np.zeros(len(places), bool)
    for angle in np.arange(ways) * np.pi / ways:
        way = reach * (np.cos(angle) * first + np.sin(angle) * second)
        found |= is_blocked(scene, above - way, above + way)
    return found


def cut_off(state, scene, chosen):
    """Whether most of the elements beside them on their surface do not see them."""
    import numpy as np
    elements, starts, ends, owners = state.elements, [], [], []
    ranges = {one.index: one.elements.slice for one in state.info.objects if not one.hidden}
    for k, element in enumerate(chosen):
        own = ranges[int(elements.object[element])]
        off = np.linalg.norm(elements.position[own] - elements.position[element], axis=1)
        off[elements.normal[own] @ elements.normal[element] < 0.8] = np.inf
        off[element - own.start] = np.inf
        near = [j for j in np.argsort(off)[:NEIGHBOURS] if off[j] < 3 * state.info.spacing]
        starts += [element] * len(near)
        ends += [own.start + j for j in near]
        owners += [k] * len(near)
    lifted = elements.position + LIFT * state.info.spacing * elements.normal
    blocked = is_blocked(scene, lifted[starts].astype(float), lifted[ends].astype(float))
    asked, hidden = (np.bincount(owners, weight, len(chosen)) for weight in (None, blocked.astype(float)))
    return hidden > 0.5 * np.maximum(asked, 1)
