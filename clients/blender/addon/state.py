"""What of a scene matters to its light, as plain data, and what has to be told of how it changed. Knows nothing of
Blender: everything is in the service's terms (metres, +y up, linear RGB, candela and lux)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from .core.edits import (
    DirectionalLight,
    Edit,
    Hide,
    Insert,
    InsertLight,
    Light,
    LightChange,
    Material,
    Move,
    MoveLight,
    PointLight,
    Remove,
    RemoveLight,
    Show,
    Sky,
    SpotLight,
)

Rows = tuple[tuple[float, ...], ...]
Color = tuple[float, float, float]

#: Changes below this, of matrices and colours, are rounding.
TOLERANCE = 1e-5


@dataclass(frozen=True)
class ObjectState:
    """An object with a surface."""

    name: str
    #: World from object, rows.
    matrix: Rows
    #: Changes where its surface does, or what cannot be told by an edit.
    shape: str
    #: Names of its materials.
    materials: tuple[str, ...] = ()
    is_hidden: bool = False


@dataclass(frozen=True)
class LightState:
    """A lamp."""

    kind: str
    position: Color
    direction: Color
    color: Color
    intensity: float
    #: Inner and outer cone angle of a spot; angle of a sun's disc.
    angles: tuple[float, ...] = ()


@dataclass(frozen=True)
class SceneState:
    """A scene: objects and lamps by stable id, base colours of materials by name, radiance from outside."""

    objects: Mapping[str, ObjectState] = field(default_factory=dict)
    lights: Mapping[str, LightState] = field(default_factory=dict)
    albedos: Mapping[str, Color] = field(default_factory=dict)
    world: Color = (0.0, 0.0, 0.0)


@dataclass
class Known:
    """What the service calls things: names of objects and lights by id."""

    objects: dict[str, str] = field(default_factory=dict)
    lights: dict[str, str] = field(default_factory=dict)


@dataclass
class Changes:
    """Edits in the order in which they have to be made. Of an insertion the asset is still missing: its `asset` is the
    id of the object that has to be sent first."""

    edits: list[Edit] = field(default_factory=list)
    inserts: list[str] = field(default_factory=list)


def same(one: object, other: object) -> bool:
    """Equal, but for rounding."""
    a, b = np.asarray(one, float), np.asarray(other, float)
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=TOLERANCE, atol=TOLERANCE))


def light_of(state: LightState) -> Light:
    """A lamp as the API has it."""
    if state.kind == "spot":
        inner, outer = state.angles
        return SpotLight(state.position, state.direction, state.color, state.intensity, inner, outer)
    if state.kind == "directional":
        return DirectionalLight(state.direction, state.color, state.intensity, state.angles[0])
    return PointLight(state.position, state.color, state.intensity)


def changes(before: SceneState, after: SceneState, known: Known) -> Changes:
    """What to tell the service. `known` is brought up to date as if it was told."""
    found = Changes()
    _objects(before, after, known, found)
    _materials(before, after, found)
    _lights(before, after, known, found)
    if not same(before.world, after.world):
        lit = max(after.world) > 0
        if lit or max(before.world) > 0:
            found.edits.append(Sky(radiance=after.world) if lit else RemoveLight("environment"))
    return found


def _objects(before: SceneState, after: SceneState, known: Known, found: Changes) -> None:
    gone = [id for id in known.objects if id not in after.objects or _is_anew(before, after, id)]
    if gone:
        found.edits.append(Remove([known.objects.pop(id) for id in gone]))
    for id, state in after.objects.items():
        old = before.objects.get(id)
        if old is None or id not in known.objects:
            if not state.is_hidden:
                name = free_name(state.name, known)
                known.objects[id] = name
                found.edits.append(Insert(id, name, state.matrix))
                found.inserts.append(id)
            continue
        name = known.objects[id]
        if old.is_hidden != state.is_hidden:
            found.edits.append(Hide(name) if state.is_hidden else Show(name))
        if not same(old.matrix, state.matrix):
            found.edits.append(Move(name, state.matrix))


def _is_anew(before: SceneState, after: SceneState, id: str) -> bool:
    one, other = before.objects[id], after.objects[id]
    return (one.shape, one.materials) != (other.shape, other.materials) and not other.is_hidden


def free_name(name: str, known: Known) -> str:
    """The name, or one like it, that no object of the service has."""
    taken = set(known.objects.values())
    names = (name if at == 0 else f"{name} ({at})" for at in range(len(taken) + 1))
    return next(name for name in names if name not in taken)


def _materials(before: SceneState, after: SceneState, found: Changes) -> None:
    for name, albedo in after.albedos.items():
        old = before.albedos.get(name)
        if old is not None and not same(old, albedo):
            found.edits.append(Material(tuple(min(max(one, 0.0), 1.0) for one in albedo), material=name))


def _lights(before: SceneState, after: SceneState, known: Known, found: Changes) -> None:
    for id in before.lights:
        if id in known.lights and (id not in after.lights or _needs_another(before.lights[id], after.lights[id])):
            found.edits.append(RemoveLight(known.lights.pop(id)))
    for id, state in after.lights.items():
        if id not in known.lights:
            known.lights[id] = f"light {id}"
            found.edits.append(InsertLight(known.lights[id], light_of(state)))
            continue
        old, name = before.lights[id], known.lights[id]
        change = LightChange(
            name,
            None if same(old.color, state.color) else state.color,
            None if same(old.intensity, state.intensity) else state.intensity,
        )
        if change != LightChange(name):
            found.edits.append(change)
        move = MoveLight(
            name,
            None if same(old.position, state.position) else state.position,
            None if same(old.direction, state.direction) else state.direction,
        )
        if state.kind == "point":
            move = replace(move, direction=None)
        if state.kind == "directional":
            move = replace(move, position=None)
        if move != MoveLight(name):
            found.edits.append(move)


def _needs_another(old: LightState, new: LightState) -> bool:
    return old.kind != new.kind or not same(old.angles, new.angles)
