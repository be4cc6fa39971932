"""Page "Design": command lines from forms, plans and files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from strainwave.errors import InvalidInput
from strainwave.io.parameters import parameter_file
from strainwave.virtual import scara

pytest.importorskip("starlette")

from strainwave.workbench.pages.design import option_flags
from strainwave.workbench.runs import Runs

if TYPE_CHECKING:
    from starlette.testclient import TestClient

STUDY = "arm/study.toml"


def test_values_become_arguments() -> None:
    values = {"limit-angle": "1.2", "limit-velocity": "180, 150", "limit-torque": ""}
    assert option_flags("excite", values) == ["--limit-angle=1.2", "--limit-velocity=180,150"]
    values = {"posture": "0, 1.2; -0.5, 1", "payload": "2,0.1,0,0"}
    assert option_flags("tune", values) == [
        "--posture=0,1.2",
        "--posture=-0.5,1",
        "--payload=2,0.1,0,0",
    ]


def test_a_value_cannot_become_another_option() -> None:
    assert option_flags("excite", {"seed": "--out /tmp"}) == ["--seed=--out/tmp"]
    for values in ({"out": "/tmp"}, {"seed": 3}):
        with pytest.raises(InvalidInput):
            option_flags("excite", values)


def test_a_plan_is_made_shown_and_downloaded(client: TestClient, folder: Path) -> None:
    truth = parameter_file(scara.STIFF.parameters())
    (folder / "arm" / "truth.json").write_bytes(truth)
    options = {"limit-angle": "0.8", "limit-velocity": "120"}
    body = {"kind": "excite", "parameters": "arm/truth.json", "options": options}
    run = client.post(f"/api/design/{STUDY}", json=body).json()
    assert "--parameters=../../truth.json --limit-angle=0.8" in run["lines"][0]
    client.get(f"/api/run-events/{STUDY}", params={"name": run["name"]})  # ends with the run
    (design,) = client.get(f"/api/designs/{STUDY}").json()
    assert design["state"] == "done", design["messages"]
    assert "apply-prbs-j1.csv" in design["files"]
    query = {"run": run["name"], "file": "apply-motion.csv"}
    figure = client.get(f"/api/plan/{STUDY}", params=query).json()
    angles = [d["y"] for d in figure["data"] if d["name"].startswith("theta_m1")]
    assert 0.0 < max(map(abs, angles[0])) * 0.01 <= 0.8  # within the limit at the link
    precision = client.get(f"/api/precision/{STUDY}", params={"run": run["name"]}).json()
    assert any(row["name"] == "gear_damping" for row in precision)
    archive = client.get(f"/zip/{STUDY}", params={"run": run["name"]})
    assert archive.content[:2] == b"PK"


def test_errors_of_the_command_line_are_shown(client: TestClient, folder: Path) -> None:
    truth = parameter_file(scara.STIFF.parameters())
    (folder / "arm" / "truth.json").write_bytes(truth)
    options = {"limit-angle": "x", "limit-velocity": "120"}
    body = {"kind": "excite", "parameters": "arm/truth.json", "options": options}
    run = client.post(f"/api/design/{STUDY}", json=body).json()
    client.get(f"/api/run-events/{STUDY}", params={"name": run["name"]})
    (design,) = client.get(f"/api/designs/{STUDY}").json()
    assert design["state"] == "failed"
    assert any("Largest link angle" in line for line in design["messages"])


@pytest.mark.parametrize(
    "body", [{"kind": "rm"}, {"kind": "tune"}, {"kind": "tune", "parameters": "../../etc/passwd"}]
)
def test_wrong_requests_start_nothing(
    client: TestClient, folder: Path, body: dict[str, str]
) -> None:
    assert client.post(f"/api/design/{STUDY}", json=body).status_code == 400
    assert not Runs(folder / "arm" / "study.toml").all()
