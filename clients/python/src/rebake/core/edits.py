"""Edits, as the API has them. What is checked here is their shape; what they mean the service checks.

Places and directions are three numbers, in metres; colours linear RGB; angles radians. A transform is a 4 × 4 matrix
(rows of numbers, or a NumPy array, so that `matrix @ (x, y, z, 1)` is the place) or 16 numbers, column-major.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Union

import numpy as np
from numpy.typing import ArrayLike

from .models import Budget

Vector = Union[Sequence[float], "np.ndarray[Any, Any]"]


@dataclass(frozen=True)
class Node:
    """An object or a light by the node of the scene's file that it is, in place of its name: its index there, or the
    `extras.id` that the node has."""

    node: int | None = None
    id: str | None = None

    def __post_init__(self) -> None:
        if (self.node is None) == (self.id is None):
            raise ValueError("node: give the index of a node or its id, one of them")


#: An object or a light: its name, or its node.
Named = Union[str, Node]


@dataclass(frozen=True)
class PointLight:
    """Shines in all directions. Candela; `range`: where its light ends, metres."""

    position: Vector
    color: Vector = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    range: float | None = None
    kind: ClassVar[str] = "point"


@dataclass(frozen=True)
class SpotLight:
    """Shines in a cone around `direction`. Candela; full intensity up to the inner angle, none beyond the outer one."""

    position: Vector
    direction: Vector
    color: Vector = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    inner_cone_angle: float | None = None
    outer_cone_angle: float | None = None
    range: float | None = None
    kind: ClassVar[str] = "spot"


@dataclass(frozen=True)
class DirectionalLight:
    """Shines from afar along `direction`. Lux; `angle`: what its disc takes up, 0.0093 for the sun."""

    direction: Vector
    color: Vector = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    angle: float | None = None
    kind: ClassVar[str] = "directional"


@dataclass(frozen=True)
class EnvironmentLight:
    """The same radiance from everywhere outside."""

    color: Vector = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    kind: ClassVar[str] = "environment"


Light = Union[PointLight, SpotLight, DirectionalLight, EnvironmentLight]


@dataclass(frozen=True)
class Insert:
    """Puts an asset (the id that `Client.add_asset` answers) into the scene as one object of a name that is free."""

    asset: str
    name: str
    transform: ArrayLike
    op: ClassVar[str] = "insert"


@dataclass(frozen=True)
class Remove:
    """Takes objects out, with the lights on them. `*` matches any part of a name."""

    objects: Named | Sequence[Named]
    op: ClassVar[str] = "remove"


@dataclass(frozen=True)
class Move:
    """Gives an object a new place: `transform`, from object space to world space, replaces the present one. `drag`: make way
    for the next step as soon as something is to be seen."""

    object: Named
    transform: ArrayLike
    drag: bool | None = None
    op: ClassVar[str] = "move"


@dataclass(frozen=True)
class Material:
    """Repaints an object, a material (by name) wherever it is, or that material of that object: diffuse albedo.

    With `texture="multiply"` textures and vertex colours stay and are multiplied by it, else they are painted over.
    """

    albedo: Vector
    object: Named | None = None
    material: str | None = None
    texture: Literal["replace", "multiply"] | None = None
    op: ClassVar[str] = "material"


@dataclass(frozen=True)
class Hide:
    """Takes objects out of the light, with the lights on them, until :class:`Show`."""

    objects: Named | Sequence[Named]
    op: ClassVar[str] = "hide"


@dataclass(frozen=True)
class Show:
    """Brings hidden objects back."""

    objects: Named | Sequence[Named]
    op: ClassVar[str] = "show"


@dataclass(frozen=True)
class LightChange:
    """Changes colour or intensity of a light; what is not given stays. The API's `relight`, of one light."""

    light: Named
    color: Vector | None = None
    intensity: float | None = None
    op: ClassVar[str] = "relight"


@dataclass(frozen=True)
class InsertLight:
    """Adds a light of a name that is free."""

    name: str
    light: Light
    op: ClassVar[str] = "insert_light"


@dataclass(frozen=True)
class RemoveLight:
    """Takes a light away. An emissive surface stays as an object that emits nothing."""

    light: Named
    op: ClassVar[str] = "remove_light"


@dataclass(frozen=True)
class MoveLight:
    """Moves a point or spot light, turns a spot or directional light. `drag`: show an estimate at once."""

    light: Named
    position: Vector | None = None
    direction: Vector | None = None
    drag: bool | None = None
    op: ClassVar[str] = "move_light"


@dataclass(frozen=True)
class Sky:
    """Light from outside in place of what there is: a picture (an asset) or the same `radiance` from everywhere.
    `rotation` in degrees about +y."""

    asset: str | None = None
    radiance: Vector | None = None
    rotation: float | None = None
    strength: float | None = None
    op: ClassVar[str] = "sky"


@dataclass(frozen=True)
class GroupLights:
    """Lets lights share a layer of the light map, or, without a name, belong to no group any more."""

    lights: Sequence[Named]
    name: str | None = None
    op: ClassVar[str] = "group_lights"


@dataclass(frozen=True)
class Undo:
    """Takes the last request back that counts; with `drag` all steps of a drag. Stands alone in its request."""

    drag: bool | None = None
    op: ClassVar[str] = "undo"


@dataclass(frozen=True)
class Redo:
    """Makes the last request again that was taken back; with `drag` all steps of a drag. Stands alone in its request."""

    drag: bool | None = None
    op: ClassVar[str] = "redo"


Edit = Union[
    Insert, Remove, Move, Material, Hide, Show, LightChange, InsertLight, RemoveLight, MoveLight, Sky, GroupLights,
    Undo, Redo,
]  # fmt: skip

#: Length of every list of numbers.
_LENGTHS = {"position": 3, "direction": 3, "color": 3, "albedo": 3, "radiance": 3}


def edit_json(edit: Edit) -> dict[str, Any]:
    """The edit as JSON. Raises `ValueError` that names the field where its shape is wrong, and `TypeError` for what is
    no edit."""
    if not isinstance(edit, Edit.__args__):  # type: ignore[attr-defined]
        raise TypeError(f"not an edit: {edit!r}")
    found = {"op": edit.op, **_fields(edit)}
    if isinstance(edit, LightChange):
        return {"op": edit.op, "lights": [{name: value for name, value in found.items() if name != "op"}]}
    return found


def _fields(value: Any) -> dict[str, Any]:
    found = {}
    for field in dataclasses.fields(value):
        one = getattr(value, field.name)
        if one is not None:
            found[field.name] = _json(field.name, one)
    return found


def _json(name: str, value: Any) -> Any:
    if name == "transform":
        return column_major(value)
    if name in _LENGTHS:
        return _numbers(name, value, (_LENGTHS[name],)).tolist()
    if name == "objects" and isinstance(value, Named.__args__):  # type: ignore[attr-defined]
        value = [value]
    if isinstance(value, Node):
        return _fields(value)
    if dataclasses.is_dataclass(value):
        return {"kind": getattr(value, "kind"), **_fields(value)}  # noqa: B009
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    return [_json("", one) for one in value] if isinstance(value, (tuple, list)) else value


def column_major(transform: ArrayLike) -> list[float]:
    """16 numbers, column-major, of a 4 × 4 matrix or of such 16 numbers. Raises `ValueError`."""
    numbers = _numbers("transform", transform, (4, 4), (16,))
    flat: list[float] = numbers.T.ravel().tolist() if numbers.ndim == 2 else numbers.tolist()
    return flat


def _numbers(name: str, value: ArrayLike, *shapes: tuple[int, ...]) -> np.ndarray[Any, np.dtype[np.float64]]:
    wanted = " or ".join(" × ".join(map(str, shape)) for shape in shapes)
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: has to be {wanted} numbers, not {value!r}") from None
    if numbers.shape not in shapes or not np.isfinite(numbers).all():
        raise ValueError(f"{name}: has to be {wanted} finite numbers, not {value!r}")
    return numbers


def budget_json(
    samples: int | None = None, max_seconds: float | None = None, target_rmse: float | None = None
) -> dict[str, Any]:
    """A budget, or a scene's target, as JSON; empty where nothing is given."""
    return _fields(Budget(samples, max_seconds, target_rmse))
