"""The notebook's cells, one after the other, on rooms of the tests' own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from conftest import Service
from rooms import box, crate, glb

NOTEBOOK = Path(__file__).parents[1] / "examples/live_light_map.ipynb"


def test_the_notebook_runs(
    service: Service, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    room = {
        "floor": (box((0, -0.1, 0), (2, 0, 2)), (0.6, 0.6, 0.6)),
        "sofa": (box((0.3, 0, 0.3), (0.9, 0.4, 0.6)), (0.5, 0.2, 0.1)),
    }
    (tmp_path / "room.glb").write_bytes(glb(room))
    (tmp_path / "chair.glb").write_bytes(crate())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("REBAKE_SERVER", service.server)
    monkeypatch.setenv("REBAKE_TOKEN", service.token)
    names: dict[str, Any] = {}
    for cell in json.loads(NOTEBOOK.read_text())["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    said = capsys.readouterr().out
    assert "2 objects" in said, said
    assert "as before: True" in said, said
    assert len(names["plt"].get_fignums()) == 4
    names["plt"].close("all")
