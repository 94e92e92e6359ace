"""JSON to the dataclasses of :mod:`.models`, by their annotations."""

from __future__ import annotations

import dataclasses
import types
from functools import cache
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from .problems import RebakeError

T = TypeVar("T")


def decode(cls: type[T], value: object) -> T:
    """A value of type `cls`. Fields that this version does not know are left out; those that may be absent get their
    defaults. Raises :class:`RebakeError` that names the field where the shape is another one."""
    result: T = _decode(cls, value, cls.__name__)
    return result


@cache
def _fields(cls: type) -> tuple[tuple[str, Any, bool], ...]:
    hints = get_type_hints(cls)
    absent = dataclasses.MISSING
    return tuple(
        (field.name, hints[field.name], field.default is absent and field.default_factory is absent)
        for field in dataclasses.fields(cls)
    )


def _decode(kind: Any, value: Any, where: str) -> Any:
    origin = get_origin(kind)
    if kind is Any:
        return value
    if origin in (Union, types.UnionType):
        if value is None:
            return None
        (inner,) = (arm for arm in get_args(kind) if arm is not type(None))
        return _decode(inner, value, where)
    if origin is tuple and isinstance(value, list):
        return tuple(_decode(get_args(kind)[0], item, f"{where}[{at}]") for at, item in enumerate(value))
    if isinstance(value, dict) and isinstance(kind, type) and dataclasses.is_dataclass(kind):
        found = {}
        for name, hint, is_required in _fields(kind):
            if name in value:
                found[name] = _decode(hint, value[name], f"{where}.{name}")
            elif is_required:
                raise RebakeError(f"{where}.{name} is missing in what the service answered")
        return kind(**found)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(kind, type) and isinstance(value, kind):
        return value
    raise RebakeError(f"{where} is not what it should be in what the service answered: {value!r}")
