"""Page "Compare": differences, linear models, figures of reports."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import strainwave as sw
from strainwave.virtual import scara

pytest.importorskip("starlette")

from strainwave.workbench.pages.estimate import snapshot
from strainwave.workbench.runs import Runs

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


@pytest.fixture
def runs_of_one_study(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two runs as the page Estimate starts them, each with a copy of the study in its folder."""
    study = folder / "arm" / "study.toml"
    runs = Runs(study)
    for name in ("a", "b"):
        run = runs.prepare(name)
        (run / "study.toml").write_text(snapshot(study))
    monkeypatch.chdir(run)
    result = sw.identify("study.toml", stages=("rigid",))
    for name in ("a", "b"):
        result.save(runs.path(name) / "result.json")
    return folder


def test_runs_of_the_same_logs_are_not_tested(client: TestClient, runs_of_one_study: Path) -> None:
    paths = {"paths": [A, B]}
    shown = client.post("/api/compare/arm/study.toml", json=paths).json()
    assert shown["test"] is None
    assert "(motion-check" in shown["note"]
    other = Path(B).with_name("study.toml")
    text = (runs_of_one_study / other).read_text()
    (runs_of_one_study / other).write_text(text.replace('file = "../../', 'file = "../../new-'))
    assert client.post("/api/compare/arm/study.toml", json=paths).json()["test"] is not None


def test_a_merged_log_is_a_log_of_the_result(client: TestClient, runs_of_one_study: Path) -> None:
    file = runs_of_one_study / Path(B).with_name("study.toml")
    steps = 'steps = [{ kind = "merge", file = "../../motion.parquet" }]'
    text = f'[arm]\n[[experiment]]\nname = "new"\nfile = "../../new.parquet"\n{steps}\n'
    file.write_text(text)
    shown = client.post("/api/compare/arm/study.toml", json={"paths": [A, B]}).json()
    assert shown["test"] is None
    assert "(motion.parquet)" in shown["note"]


def test_equal_results_agree(client: TestClient, two_runs: Path) -> None:
    shutil.copy(two_runs / A, two_runs / B)
    shown = client.post("/api/compare/arm/study.toml", json={"paths": [A, B]}).json()
    assert not shown["test"]["differs"]
    assert all(not cells["cells"][1]["change"] for cells in shown["rows"])


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


def test_residuals_of_true_and_wrong_values_are_compared_and_tested(
    client: TestClient, folder: Path
) -> None:
    true = scara.STIFF.parameters()
    wrong = {key: 1.2 * v if "stiffness" in key[0] else v for key, v in true.items()}
    for path, values in ((A, true), (B, wrong)):
        parameters = [
            {"name": name, "joint": joint, "value": v, "std": None, "unit": "", "stage": "tuned"}
            for (name, joint), v in values.items()
        ]
        (folder / path).parent.mkdir(parents=True)
        document: dict[str, Any] = {"schema": "strainwave/result/1", "stages": {}, "verdict": {}}
        document |= {"status": "determined", "checks": [], "warnings": []}
        document |= {"study": {"path": "study.toml", "sha256": ""}, "parameters": parameters}
        (folder / path).write_text(json.dumps(document))
    body = {"paths": [A, B], "record": "step-check-j1", "channel": "a1"}
    answer = client.post("/api/compare-record/arm/study.toml", json=body).json()
    assert (answer["channel"], answer["notes"]) == ("a1", [])
    lines = {one["name"]: one["y"] for one in answer["difference"]["data"]}
    rms = {name: np.std([y for y in line if y is not None]) for name, line in lines.items()}
    assert rms["b"] > 10.0 * rms["a"]
    rows = {(row["channel"], row["name"]): row for row in answer["tests"]}
    assert len(rows) == 2 * len(answer["channels"])
    for channel in answer["channels"]:
        good, bad = rows[channel, "a"], rows[channel, "b"]
        assert good["is_independent"]
        assert float(good["noise"]) < 1.3
        assert float(bad["noise"]) > 10.0
        assert not bad["is_white"]
    assert rows["a1", "a"]["is_white"]
    assert not rows["omega_m1", "b"]["is_independent"]


def test_the_changes_are_in_percent_or_standard_deviations(
    client: TestClient, two_runs: Path
) -> None:
    shown = client.post("/api/compare/arm/study.toml", json={"paths": [A, B]}).json()
    for scale in ("percent", "std"):
        first, second = shown["intervals"][scale]["data"]
        assert not any(first["x"])
        rows = zip(*first["y"], second["x"], strict=True)
        changed = {(joint, name): x for joint, name, x in rows if x}
        assert changed
        assert all("stiffness" in name for _, name in changed)
        if scale == "percent":
            assert list(changed.values()) == pytest.approx([20.0] * len(changed))


def test_other_results_are_ghosts_and_have_a_difference(client: TestClient, two_runs: Path) -> None:
    body = {"paths": [A, B], "joint": 1}
    figures = client.post("/api/compare-joint/arm/study.toml", json=body).json()
    for name in ("bode", "step"):
        lines = [trace for trace in figures[name]["data"] if "fill" not in trace]
        assert {t["line"]["dash"] == "solid" for t in lines if t["name"] == "a"} == {True}
        assert {t.get("opacity", 1.0) < 1.0 for t in lines if t["name"] == "b"} == {True}
        assert {t["line"]["dash"] == "solid" for t in lines if t["name"] == "b"} == {False}
    difference = {t["name"]: t["y"] for t in figures["difference"]["data"] if t["yaxis"] == "y"}
    assert not any(difference["a"])
    low = np.array(difference["b"], dtype=float)[:3]
    assert np.abs(low).max() < 0.5  # [dB] below the resonance only the inertia counts


def test_a_record_that_does_not_exist_gives_a_sentence(client: TestClient, two_runs: Path) -> None:
    body = {"paths": [A, B], "record": "none"}
    answer = client.post("/api/compare-record/arm/study.toml", json=body)
    assert answer.status_code == 400
    assert "no experiment" in answer.json()["error"]


def test_results_without_a_common_parameter_are_shown_with_a_note(
    client: TestClient, two_runs: Path
) -> None:
    document = json.loads((two_runs / B).read_bytes())
    document["parameters"] = [document["parameters"][0] | {"name": "gear_stiffness_cubic"}]
    document.pop("covariance", None)
    document["study"]["path"] = "elsewhere.toml"
    (two_runs / B).write_text(json.dumps(document))
    answer = client.post("/api/compare/arm/study.toml", json={"paths": [A, B]})
    assert answer.status_code == 200, answer.json()
    assert answer.json()["test"] is None
    assert answer.json()["note"]
