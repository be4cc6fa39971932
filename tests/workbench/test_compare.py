"""Page "Compare": differences, linear models, figures of reports."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import strainwave as sw

pytest.importorskip("starlette")

from strainwave.workbench.pages import compare

if TYPE_CHECKING:
    from starlette.testclient import TestClient

A, B = "arm/runs/a/result.json", "arm/runs/b/result.json"


@pytest.fixture(scope="module")
def identified(arm_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Result and report of the joint models."""
    folder = tmp_path_factory.mktemp("identified")
    result = sw.identify(arm_folder / "study.toml", stages=("rigid", "decoupled"))
    result.save(folder / "result.json")
    result.report(folder / "report.html")
    return folder


@pytest.fixture
def two_runs(folder: Path, identified: Path) -> Path:
    """Two runs, of which the second has another stiffness of joint 1."""
    for name in ("a", "b"):
        shutil.copytree(identified, folder / "arm" / "runs" / name)
    path = folder / B
    document = json.loads(path.read_bytes())
    for entry in document["parameters"]:
        if (entry["name"], entry["joint"]) == ("gear_stiffness", 1) or "_k" in entry["name"]:
            entry["value"] *= 1.2
    path.write_text(json.dumps(document))
    return folder


def test_a_changed_parameter_is_listed(client: TestClient, two_runs: Path) -> None:
    listed = client.get("/api/results/arm/study.toml").json()
    assert {one["name"] for one in listed} == {"a", "b"}
    shown = client.post("/api/compare/arm/study.toml", json={"paths": [A, B]}).json()
    assert shown["names"] == ["a", "b"]
    rows = {row["label"]: row["cells"] for row in shown["rows"]}
    changed = [label for label, cells in rows.items() if abs(cells[1]["change"] or 0.0) > 3.0]
    assert changed
    assert all("stiffness" in label for label in changed)
    assert shown["test"]["differs"]
    assert shown["joints"] == [1, 2]


def test_results_of_the_same_logs_are_not_tested(client: TestClient, folder: Path) -> None:
    result = sw.identify(folder / "arm" / "study.toml", stages=("rigid",))
    for path in (A, B):
        (folder / path).parent.mkdir(parents=True)
        result.save(folder / path)
    shown = client.post("/api/compare/arm/study.toml", json={"paths": [A, B]}).json()
    assert shown["test"] is None
    assert "the same logs" in shown["note"]
    assert all(cell["change"] is None for row in shown["rows"] for cell in row["cells"])


def test_equal_results_agree(client: TestClient, two_runs: Path) -> None:
    shutil.copy(two_runs / A, two_runs / B)
    shown = client.post("/api/compare/arm/study.toml", json={"paths": [A, B]}).json()
    assert not shown["test"]["differs"]
    assert all(not cells["cells"][1]["change"] for cells in shown["rows"])


def test_linear_models_of_a_joint_are_those_of_the_parameters(two_runs: Path) -> None:
    results = compare.read_results({"a": two_runs / A, "b": two_runs / B})
    figure = compare.pole_figure(results, 1)
    poles, zeros = figure.panels[0].marks[0], figure.panels[0].marks[1]
    model = results[0].result
    k = next(
        p.value for p in model if p.joint == 1 and p.name in ("gear_stiffness", "gear_stiffness_k2")
    )
    inertia = model["link_inertia", 1].value
    modulus = np.abs(np.asarray(zeros.x) + 1j * np.asarray(zeros.y))  # type: ignore[union-attr]
    assert len(poles.x) == 3  # type: ignore[union-attr]
    assert k is not None
    assert inertia is not None
    assert np.sqrt(k / inertia) == pytest.approx(modulus, rel=1e-3)
    step: Any = compare.step_figure(results, 1).panels[0].marks[0]
    assert step.y[0] == pytest.approx(0.0, abs=1e-9)
    assert step.y[-1] > 0.0


def test_figures_of_reports_are_side_by_side(client: TestClient, two_runs: Path) -> None:
    shown = client.post("/api/compare/arm/study.toml", json={"paths": [A, B]}).json()
    key = next(one["key"] for one in shown["figures"] if one["key"].startswith("bode"))
    body = {"paths": [A, B], "key": key}
    figures = client.post("/api/compare-figure/arm/study.toml", json=body).json()
    assert [one["name"] for one in figures] == ["a", "b"]
    assert all(one["figure"]["data"] for one in figures)


@pytest.mark.parametrize("paths", [[], [A], [A, "../../etc/passwd"], "x", [A, 3]])
def test_wrong_choices_give_a_sentence(client: TestClient, two_runs: Path, paths: object) -> None:
    answer = client.post("/api/compare/arm/study.toml", json={"paths": paths})
    assert answer.status_code == 400
    assert answer.json()["error"]


def test_the_command_line_writes_the_comparison(client: TestClient, two_runs: Path) -> None:
    run = client.post("/api/save-comparison/arm/study.toml", json={"paths": [A, B]}).json()
    client.get("/api/run-events/arm/study.toml", params={"name": run["name"]})  # ends with the run
    document = json.loads((two_runs / "arm/runs/compare-1/comparison.json").read_bytes())
    assert document["differs"]
    query = {"run": "compare-1", "file": "comparison.html"}
    assert client.get("/download/arm/study.toml", params=query).status_code == 200
