"""Page "Estimate": options, snapshots, runs, order and horizon."""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from strainwave.domain.study import Options, study_options
from strainwave.errors import InvalidInput
from strainwave.io.study import read_study

pytest.importorskip("starlette")

from strainwave.init.changes import KeyChange, edit_study
from strainwave.workbench.pages.estimate import option_arguments, option_groups

if TYPE_CHECKING:
    from starlette.testclient import TestClient

API = "/api/estimate/arm/study.toml"


def finished(client: TestClient, name: str) -> dict[str, Any]:
    limit = time.monotonic() + 120.0
    while True:
        run: dict[str, Any] = next(
            run for run in client.get(API).json()["runs"] if run["name"] == name
        )
        if run["state"] not in ("waiting", "running"):
            return run
        assert time.monotonic() < limit
        time.sleep(0.1)


def test_every_option_has_a_text() -> None:
    stages = {stage: table for stage, table in asdict(Options()).items() if table != ()}
    names = [f"{stage}.{key}" for stage, table in stages.items() for key in table]
    assert sorted(option.name for option in study_options()) == sorted(names)
    assert all(option.meaning and option.default and option.reason for option in study_options())


def test_choices_are_those_of_the_types() -> None:
    choices = {option.name: option.choices for option in study_options()}
    assert choices["statespace.method"] == ("pem", "moesp", "n4sid", "subspace")
    assert choices["tuning.settling"] == ("true", "false")
    assert choices["links.order"] == ("1", "2")
    assert choices["links.time_constant"] == ()


def test_values_of_the_study_are_shown(folder: Path) -> None:
    path = folder / "arm" / "study.toml"
    edit_study(path, [KeyChange(("options", "tuning", "hold"), ["gear_damping 2"])])
    groups = option_groups(read_study(path).options)
    values = {row["option"].name: row["value"] for rows in groups.values() for row in rows}
    assert values["tuning.hold"] == '["gear_damping 2"]'
    assert values["links.order"] == ""


def test_options_become_arguments_and_wrong_ones_are_refused(folder: Path) -> None:
    path = folder / "arm" / "study.toml"
    assert option_arguments({"links.order": " 1 ", "statespace.order": ""}, path) == [
        "--set",
        "links.order=1",
    ]
    for values in ({"links.orders": "1"}, {"links.order": "7"}, {"links.order": 1}):
        with pytest.raises(InvalidInput):
            option_arguments(values, path)


def test_a_run_identifies_a_copy_of_the_study_that_can_be_repeated(
    client: TestClient, folder: Path
) -> None:
    client.post("/api/check/arm/study.toml", json={})
    body = {"name": "slow", "stages": "rigid", "options": {"rigid.bandwidth_hz": "4.0"}}
    started = client.post(API, json=body).json()
    assert started["state"] == "waiting"
    assert client.post(API, json=body).status_code == 400  # the name is taken
    run = finished(client, "slow")
    assert run["status"] == "determined"
    line = "strainwave identify study.toml --out . --stages rigid --set rigid.bandwidth_hz=4.0"
    assert run["lines"] == [line]
    folder_of_run = folder / "arm" / "runs" / "slow"
    result = json.loads((folder_of_run / "result.json").read_bytes())
    assert result["stages"]["rigid"]["bandwidth_hz"] == 4.0
    edit_study(folder / "arm" / "study.toml", [KeyChange(("joint", 0, "gear_ratio"), 0.02)])
    copy = read_study(folder_of_run / "study.toml")
    assert copy.arm.joints[0].gear_ratio == 0.01
    assert copy.log_path(copy.experiments[0]).resolve().parent == (folder / "arm").resolve()


def test_events_end_with_the_run_and_its_report_has_no_access_to_the_workbench(
    client: TestClient,
) -> None:
    client.post("/api/check/arm/study.toml", json={})
    client.post(API, json={"name": "one", "stages": "rigid", "options": {}})
    text = client.get("/api/run-events/arm/study.toml", params={"name": "one"}).text
    events = [json.loads(line[6:]) for line in text.splitlines() if line.startswith("data: ")]
    assert events[-1]["state"] == "done"
    fractions = [e["progress"]["fraction"] for e in events if e["progress"]]
    assert fractions == sorted(fractions)
    assert fractions[-1] > 0.5
    answer = client.get("/report/arm/study.toml", params={"run": "one"})
    policy = answer.headers["content-security-policy"]
    assert "sandbox allow-scripts" in policy
    assert "allow-same-origin" not in policy
    assert "'unsafe-inline'" not in policy.split("script-src")[1].split(";")[0]
    for file in ("../../study.toml", "run.json", "/etc/passwd"):
        query = {"run": "one", "file": file}
        assert client.get("/report/arm/study.toml", params=query).status_code == 400


def test_orders_show_the_singular_values_of_each_excited_record(client: TestClient) -> None:
    shown = client.get("/api/orders/arm/study.toml").json()
    assert [one["experiment"] for one in shown] == ["prbs-j1", "prbs-j2"]
    for one in shown:
        values = one["figure"]["data"][0]["y"]
        assert values == sorted(values, reverse=True)
        assert 2 <= one["order"] <= 10
