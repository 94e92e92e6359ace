"""What the service is told of how a scene has changed, without Blender."""

from __future__ import annotations

import importlib
import sys
import types
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

CLIENTS = Path(__file__).parents[2]


def part(name: str) -> Any:
    """A module of the add-on by itself: the package as a whole needs Blender."""
    for package, folder in [
        ("rebake_addon", CLIENTS / "blender" / "addon"),
        ("rebake_addon.core", CLIENTS / "python" / "src" / "rebake" / "core"),
    ]:
        if package not in sys.modules:
            sys.modules[package] = types.ModuleType(package)
            sys.modules[package].__path__ = [str(folder)]
    return importlib.import_module(f"rebake_addon.{name}")


state, edits = part("state"), part("core.edits")

AT_HOME = tuple(tuple(row) for row in np.eye(4).tolist())
ASIDE = tuple(tuple(row) for row in (np.eye(4) + np.eye(4, k=3)).tolist())


def sofa(**values: Any) -> Any:
    return replace(state.ObjectState("sofa", AT_HOME, "shape", ("wood",)), **values)


def lamp(**values: Any) -> Any:
    start = state.LightState("point", (0, 2, 0), (0, -1, 0), (1, 1, 1), 5)
    return replace(start, **values)


def told(before: Any, after: Any, **known: Any) -> list[Any]:
    its = {"objects": {"a": "sofa"}, "lights": {"l": "lamp"}, **known}
    return state.changes(before, after, state.Known(**its)).edits


BEFORE = state.SceneState({"a": sofa()}, {"l": lamp()}, {"wood": (0.5, 0.4, 0.3)})


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, []),
        ({"objects": {}}, [edits.Remove(["sofa"])]),
        ({"objects": {"a": sofa(is_hidden=True)}}, [edits.Hide("sofa")]),
        ({"objects": {"a": sofa(name="couch")}}, []),
        ({"albedos": {"wood": (0.1, 0.2, 1.5)}}, [edits.Material((0.1, 0.2, 1.0), material="wood")]),
        ({"lights": {}}, [edits.RemoveLight("lamp")]),
        ({"lights": {"l": lamp(intensity=7)}}, [edits.LightChange("lamp", intensity=7)]),
        ({"lights": {"l": lamp(position=(1, 2, 0), direction=(1, 0, 0))}}, [edits.MoveLight("lamp", (1, 2, 0))]),
        (
            {"lights": {"l": lamp(kind="directional", angles=(0.0,))}},
            [
                edits.RemoveLight("lamp"),
                edits.InsertLight("light l", edits.DirectionalLight((0, -1, 0), (1, 1, 1), 5, 0.0)),
            ],
        ),
        ({"world": (0.1, 0.1, 0.2)}, [edits.Sky(radiance=(0.1, 0.1, 0.2))]),
    ],
)
def test_each_change_is_one_edit(change: dict[str, Any], expected: list[Any]) -> None:
    assert told(BEFORE, replace(BEFORE, **change)) == expected


def test_moves_tell_the_whole_place() -> None:
    (move,) = told(BEFORE, replace(BEFORE, objects={"a": sofa(matrix=ASIDE)}))
    assert (move.object, np.array(move.transform).tolist()) == ("sofa", [list(row) for row in ASIDE])


def test_what_comes_or_has_another_shape_is_inserted_under_a_free_name() -> None:
    after = replace(BEFORE, objects={"a": sofa(shape="another"), "b": sofa(matrix=ASIDE), "c": sofa(is_hidden=True)})
    known = state.Known({"a": "sofa"}, {"l": "lamp"})
    found = state.changes(BEFORE, after, known)
    assert [type(edit).__name__ for edit in found.edits] == ["Remove", "Insert", "Insert"]
    assert [edit.transform for edit in found.edits[1:]] == [AT_HOME, ASIDE]
    assert found.inserts == ["a", "b"] and known.objects == {"a": "sofa", "b": "sofa (1)"}
    shown = state.changes(after, replace(after, objects={**after.objects, "c": sofa()}), known)
    assert shown.inserts == ["c"] and known.objects["c"] == "sofa (2)"
