"""Edits as JSON, and what is refused before it is sent."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rebake import Hide, Insert, InsertLight, LightChange, Material, Move, MoveLight, Node, Remove, SpotLight, Undo
from rebake.core.edits import edit_json
from rebake.core.uploads import media_type, read_file, upload_query

PLACE = [[1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]
COLUMNS = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]


@pytest.mark.parametrize(
    ("edit", "json"),
    [
        (Move("sofa", PLACE), {"op": "move", "object": "sofa", "transform": COLUMNS}),
        (Move("sofa", np.array(PLACE)), {"op": "move", "object": "sofa", "transform": COLUMNS}),
        (Insert("a1", "x", COLUMNS), {"op": "insert", "asset": "a1", "name": "x", "transform": COLUMNS}),
        (Remove("sofa"), {"op": "remove", "objects": ["sofa"]}),
        (Remove(Node(3)), {"op": "remove", "objects": [{"node": 3}]}),
        (Hide(["sofa", Node(id="b7")]), {"op": "hide", "objects": ["sofa", {"id": "b7"}]}),
        (Move(Node(0), PLACE), {"op": "move", "object": {"node": 0}, "transform": COLUMNS}),
        (Hide(("a", "b*")), {"op": "hide", "objects": ["a", "b*"]}),
        (Material((0.1, 0.2, 0.3), "sofa"), {"op": "material", "object": "sofa", "albedo": [0.1, 0.2, 0.3]}),
        (
            Material((0.1, 0.2, 0.3), material="wood", texture="multiply"),
            {"op": "material", "material": "wood", "albedo": [0.1, 0.2, 0.3], "texture": "multiply"},
        ),
        (LightChange("lamp", intensity=2), {"op": "relight", "lights": [{"light": "lamp", "intensity": 2}]}),
        (MoveLight("lamp", np.array([1, 2, 3])), {"op": "move_light", "light": "lamp", "position": [1, 2, 3]}),
        (
            InsertLight("spot", SpotLight((0, 1, 0), (0, -1, 0), intensity=3, outer_cone_angle=0.5)),
            {
                "op": "insert_light",
                "name": "spot",
                "light": {
                    "kind": "spot",
                    "position": [0, 1, 0],
                    "direction": [0, -1, 0],
                    "color": [1, 1, 1],
                    "intensity": 3,
                    "outer_cone_angle": 0.5,
                },
            },
        ),
        (Undo(), {"op": "undo"}),
    ],
)
def test_edits_become_the_json_of_the_api(edit: Any, json: dict[str, Any]) -> None:
    assert edit_json(edit) == json


@pytest.mark.parametrize(
    ("edit", "field"),
    [
        (Move("sofa", [[1, 0], [0, 1]]), "transform"),
        (Move("sofa", [float("nan")] * 16), "transform"),
        (Material((1, 2), "sofa"), "albedo"),
        (MoveLight("lamp", position="here"), "position"),  # type: ignore[arg-type]
    ],
)
def test_shapes_are_checked_by_field(edit: Any, field: str) -> None:
    with pytest.raises(ValueError, match=field):
        edit_json(edit)


def test_what_is_no_edit_is_refused() -> None:
    with pytest.raises(TypeError):
        edit_json({"op": "move"})  # type: ignore[arg-type]


def test_settings_of_an_upload_become_a_query() -> None:
    query = upload_query(
        {"name": "a b", "spacing": 0.1, "samples": 8, "bake": False, "environment": (1, 0.5, 0), "layers": {"x": ["l"]}}
    )
    assert query["samples_per_element"] == "8" and query["bake"] == "false" and query["spacing"] == "0.1"
    assert query["environment"] == "1.0,0.5,0.0" and query["layers"] == '{"x": ["l"]}'


def test_a_document_goes_with_the_files_beside_it(tmp_path: Path) -> None:
    (tmp_path / "a" / "data").mkdir(parents=True)
    (tmp_path / "a" / "data" / "room 1.bin").write_bytes(b"1234")
    (tmp_path / "wood.png").write_bytes(b"png")
    file = tmp_path / "a" / "room.gltf"
    uris = {
        "buffers": [{"uri": "data/room%201.bin"}, {"uri": "data:;base64,AAAA"}],
        "images": [{"uri": "../wood.png"}, {"uri": "missing.png"}, {"bufferView": 0}],
    }
    file.write_text(json.dumps(uris))
    packed = read_file(file)
    assert media_type(packed) == "application/zip" and packed == read_file(str(file))
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        assert sorted(archive.namelist()) == ["above/data/room 1.bin", "above/room.gltf", "wood.png"]
        assert archive.read("wood.png") == b"png"
    for alone in ('{"buffers": [{"uri": "nowhere.bin"}]}', "no document", "[]"):
        file.write_text(alone)
        assert read_file(file) == alone.encode()
