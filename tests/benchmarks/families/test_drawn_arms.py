"""A campaign on a family of virtual arms: numbered cases, true values and classes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks.families.__main__ import cases_of

import strainwave as sw
from strainwave.errors import InvalidInput
from strainwave.fleet.campaign import worker
from strainwave.fleet.campaign.records import Task
from strainwave.fleet.campaign.runner import CampaignPlan
from strainwave.fleet.campaign.store import Store
from strainwave.fleet.campaign.study_files import Case


def cases(folder: Path, text: str) -> list[Case]:
    path = folder / "family.toml"
    path.write_text(text)
    return list(cases_of(path).cases)


def task_of(case: Case, store: Path) -> Task:
    task = CampaignPlan(Store(store), "test", ("rigid",), {}).next(case)
    assert isinstance(task, Task)
    return Task.from_json(task.to_json())


def test_a_family_has_one_case_per_arm(tmp_path: Path) -> None:
    found = cases(tmp_path, "[family]\narms = 12\n")
    assert [case.name for case in found] == [f"{tmp_path}/family.toml#{n}" for n in range(12)]
    assert len({case.hashes()[1] for case in found}) == 12


def test_more_arms_do_not_repeat_recorded_ones(tmp_path: Path) -> None:
    few, many = (cases(tmp_path, f"[family]\narms = {count}\n") for count in (2, 12))
    other = cases(tmp_path, "[family]\narms = 2\nseed = 1\n")
    assert few[1].hashes() == many[1].hashes() != other[1].hashes()


def test_true_values_and_the_fault_are_in_the_store(tmp_path: Path) -> None:
    text = '[family]\narms = 2\nfaults = ["angle-sign", "late-sensors"]\n'
    for case in cases(tmp_path, text):
        worker.answer(task_of(case, tmp_path / "store"))
    rows = sw.read_runs(tmp_path / "store").to_pylist()
    assert len(rows) == 2
    classes = [json.loads(row["classes"]) for row in rows]
    assert {own["fault"] for own in classes} <= {"angle-sign", "late-sensors"}
    values = sw.read_parameters(tmp_path / "store").to_pylist()
    assert all(row["true_value"] for row in values if row["name"] == "motor_inertia")


def test_a_refused_run_has_the_fault_as_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise InvalidInput("no", where="here", remedy="none")

    monkeypatch.setattr("strainwave.pipeline.identify", refuse)
    (case,) = cases(tmp_path, '[family]\narms = 1\nfaults = ["spikes"]\n')
    assert worker.answer(task_of(case, tmp_path / "store")).status == "failed"
    (row,) = sw.read_runs(tmp_path / "store").to_pylist()
    assert json.loads(row["classes"])["fault"] == "spikes"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[family]\narms = 1\nseeds = 3\n", "the key 'seeds' is unknown"),
        ('[family]\narms = 1\n[studies]\npaths = ["a"]\n', "unknown key 'studies'"),
        ("family = 3\n", "has no table [family]"),
    ],
)
def test_a_wrong_family_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=r"family\.toml") as refused:
        cases(tmp_path, text)
    assert message in str(refused.value)
