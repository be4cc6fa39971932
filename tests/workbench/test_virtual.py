"""Page "Virtual arm": settings, files and the comparison with the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from strainwave.errors import InvalidInput
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study

pytest.importorskip("starlette")

from strainwave.virtual.settings import virtual_rig
from strainwave.workbench.runs import Runs

if TYPE_CHECKING:
    from starlette.testclient import TestClient

SETTING = {"spring": "linear", "accelerometers": True, "gyros": False, "noise": True}


@pytest.mark.parametrize("wrong", [{"disks": 9}, {"stiffness": "1"}, {"friction": -0.1}])
def test_wrong_settings_give_a_sentence_and_leave_nothing(
    client: TestClient, folder: Path, wrong: dict[str, Any]
) -> None:
    with pytest.raises(InvalidInput):
        virtual_rig(wrong, folder)
    assert client.post("/api/virtual", json=wrong).status_code == 400
    assert not list(folder.glob("virtual-*"))


def test_the_recorded_arm_is_a_study_and_is_identified(client: TestClient, folder: Path) -> None:
    run = client.post("/api/virtual", json=SETTING).json()
    assert run["study"] == "virtual-1/study.toml"
    client.get(f"/api/run-events/{run['study']}", params={"name": run["name"]})  # ends with it
    finished = Runs(folder / "virtual-1" / "study.toml").get(run["name"])
    assert finished.state == "done"
    study = read_study(folder / "virtual-1" / "study.toml")  # with its logs
    assert study.arm.joints[0].spring == "linear"
    shown = client.get("/api/virtual/virtual-1/study.toml").json()
    assert shown["status"] == "determined"
    by_label = {row["label"]: row for row in shown["rows"]}
    truth = read_parameters(folder / "virtual-1/runs/record-and-identify/truth.json")
    assert by_label["gear_stiffness 1"]["true"] == truth["gear_stiffness", 1]
    assert abs(by_label["gear_stiffness 1"]["percent"]) < 1.0
    assert by_label["link_inertia 1"]["true"] > 0.0  # a combination
    errors = [abs(row["stds"]) for row in shown["rows"] if row["stds"] is not None]
    assert max(errors) < 5.0
    assert json.loads((folder / "virtual-1/runs" / run["name"] / "run.json").read_bytes())
