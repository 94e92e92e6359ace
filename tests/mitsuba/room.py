"""A room as edits leave it, for checks against Mitsuba: what a file holds, with the service's edits applied to it here.

Knows nothing of the service but the edits of its Python client, so that what it says of a state is independent of it.
"""
from dataclasses import dataclass, field, replace

from common import mitsuba_scene, nodes, read_document, read_objects


@dataclass(frozen=True)
class Thing:
    """An object: its parts in its own space, and where it stands."""
    matrix: object
    parts: tuple
    hidden: bool = False

    def placed(self):
        return [part.placed(self.matrix) for part in self.parts]


@dataclass
class Room:
    """Objects and point, spot and directional lights by name; `assets` are files by what the service calls them."""
    things: dict
    lamps: dict
    assets: dict = field(default_factory=dict)

    def parts(self, but=None):
        """Parts of all objects that are to be seen, in world space."""
        return [part for name, thing in self.things.items() if not thing.hidden and name != but for part in thing.placed()]

    def scene(self, but=None):
        """The room in Mitsuba."""
        lamps = {f"lamp{k}": mitsuba_lamp(lamp) for k, lamp in enumerate(self.lamps.values())}
        return mitsuba_scene(self.parts(but), **lamps)

    def shining(self):
        """Names of the objects that emit from one part, and are to be seen."""
        return [name for name, thing in self.things.items()
                if not thing.hidden and sum(max(part.emission) > 0 for part in thing.parts) == 1]

    def apply(self, edit):
        """Changes the room as the edit says."""
        import numpy as np
        kind = type(edit).__name__
        if kind == "Insert":
            self.things[edit.name] = inserted(self.assets[edit.asset], np.asarray(edit.transform))
        elif kind == "Remove":
            del self.things[edit.objects]
        elif kind in ("Hide", "Show"):
            self.change(edit.objects, hidden=kind == "Hide")
        elif kind == "Move":
            self.change(edit.object, matrix=np.asarray(edit.transform))
        elif kind == "Material":
            parts = self.things[edit.object].parts
            self.change(edit.object, parts=tuple(replace(part, albedo=edit.albedo) for part in parts))
        elif kind == "InsertLight":
            self.lamps[edit.name] = edit.light
        elif kind == "MoveLight":
            self.lamps[edit.light] = replace(self.lamps[edit.light], position=edit.position)
        elif kind in ("LightChange", "RemoveLight"):
            self.relight(edit)
        else:
            raise ValueError(f"no edit that a room knows: {edit}")

    def change(self, name, **fields):
        self.things[name] = replace(self.things[name], **fields)

    def relight(self, edit):
        """A light of the name of an object is its emission; what does not shine stays as a dark object."""
        import numpy as np
        is_gone = type(edit).__name__ == "RemoveLight"
        if edit.light in self.lamps:
            if is_gone:
                del self.lamps[edit.light]
            else:
                self.lamps[edit.light] = replace(self.lamps[edit.light], color=edit.color, intensity=edit.intensity)
            return
        emission = np.zeros(3) if is_gone else np.array(edit.color) * edit.intensity
        relit = (replace(p, emission=emission) if max(p.emission) > 0 else p for p in self.things[edit.light].parts)
        self.change(edit.light, parts=tuple(relit))


def inserted(path, matrix):
    """An asset as one object, its own nodes' places kept."""
    parts = (part.placed(own) for _, own, parts in read_objects(path) for part in parts)
    return Thing(matrix, tuple(parts))


def read_room(path):
    things = {name: Thing(matrix, tuple(parts)) for name, matrix, parts in read_objects(path)}
    return Room(things, dict(lamps_of(path)))


def lamps_of(path):
    """Names and lights of a file."""
    from rebake import DirectionalLight, PointLight, SpotLight
    document, _ = read_document(path)
    lights = document.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    for node, world in nodes(document):
        index = node.get("extensions", {}).get("KHR_lights_punctual", {}).get("light")
        if index is None:
            continue
        light, place, way = lights[index], world[:3, 3], -world[:3, 2]
        strength = {"color": light.get("color", (1, 1, 1)), "intensity": light.get("intensity", 1)}
        if light["type"] == "point":
            yield node["name"], PointLight(place, **strength)
        elif light["type"] == "directional":
            yield node["name"], DirectionalLight(way, **strength)
        else:
            cone = light.get("spot", {})
            angles = {"inner_cone_angle": cone.get("innerConeAngle", 0), "outer_cone_angle": cone.get("outerConeAngle", 0.7854)}
            yield node["name"], SpotLight(place, way, **strength, **angles)


def mitsuba_lamp(lamp):
    """A lamp as Mitsuba has it. Spot lights fall off in another way there: alike where the cones' angles are."""
    import mitsuba as mi
    import numpy as np
    strength = {"type": "rgb", "value": [float(x) * float(lamp.intensity) for x in lamp.color]}
    if lamp.kind == "directional":
        return {"type": "directional", "direction": [float(x) for x in lamp.direction], "irradiance": strength}
    place = np.array(lamp.position, float)
    if lamp.kind == "point":
        return {"type": "point", "position": place.tolist(), "intensity": strength}
    target, up = place + np.array(lamp.direction, float), [0, 1, 0] if abs(lamp.direction[1]) < 0.9 else [1, 0, 0]
    turn = mi.ScalarTransform4f().look_at(place.tolist(), target.tolist(), up)
    angles = {"beam_width": np.degrees(lamp.inner_cone_angle), "cutoff_angle": np.degrees(lamp.outer_cone_angle)}
    return {"type": "spot", "to_world": turn, "intensity": strength, **{k: float(v) for k, v in angles.items()}}
