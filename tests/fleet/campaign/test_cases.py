"""A kind of case without study file: a numbered drive in memory with known parameters."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import strainwave as sw
from campaign_rigs import inertia_of, log, rig
from strainwave.domain.arm.kinds import single_joint
from strainwave.fleet.campaign import worker
from strainwave.fleet.campaign.records import Task
from strainwave.fleet.campaign.runner import CampaignPlan
from strainwave.fleet.campaign.store import Store
from strainwave.fleet.campaign.study_files import Opened

Truth = dict[tuple[str, int | None], float]


@dataclass(frozen=True)
class DrawnCase:
    """A numbered rig without files."""

    number: int
    bandwidth_hz: float | None = None

    @property
    def name(self) -> str:
        return f"drawn/{self.number}"

    @property
    def options(self) -> Mapping[str, Mapping[str, Any]]:
        return {} if self.bandwidth_hz is None else {"rigid": {"bandwidth_hz": self.bandwidth_hz}}

    def hashes(self) -> tuple[str, str]:
        return f"family, {self.number}", ""

    @contextmanager
    def opened(self) -> Iterator[Opened]:
        joint = sw.Joint(spring="rigid", gear_ratio=1.0)
        study = sw.Study(
            arm=single_joint(joint),
            experiments=(sw.Experiment("motion", "", "motion", ("servo",)),),
        )
        names, *rows = log(inertia_of(self.number)).decode().split()
        columns = np.array([row.split(",") for row in rows], dtype=float).T
        data = {"motion": dict(zip(names.split(","), columns, strict=True))}
        truth: Truth = {("inertia", 1): inertia_of(self.number), ("friction_offset", 1): 0.0}
        yield Opened(study, data, truth, {"fault": None, "size": "small"})


def task_of(case: DrawnCase, store: Path, **options: Any) -> Task:
    task = CampaignPlan(Store(store), "test", ("rigid",), options).next(case)
    assert isinstance(task, Task)
    return Task.from_json(task.to_json())


def test_true_values_and_classes_are_in_the_tables(tmp_path: Path) -> None:
    outcome = worker.answer(task_of(DrawnCase(3), tmp_path))
    assert outcome.status == "determined"
    (row,) = sw.read_runs(tmp_path).to_pylist()
    assert row["study"] == "drawn/3"
    assert json.loads(row["classes"]) == {"fault": None, "size": "small"}
    parameters = {p["name"]: p for p in sw.read_parameters(tmp_path).to_pylist()}
    inertia = parameters["inertia"]
    assert inertia["true_value"] == inertia_of(3)
    error = 100.0 * (inertia["value"] / inertia_of(3) - 1.0)
    assert inertia["error_percent"] == pytest.approx(error, abs=1e-9)
    assert parameters["friction_offset"]["true_value"] == 0.0
    assert parameters["friction_offset"]["error_percent"] is None  # of nothing
    assert parameters["motor_viscous_friction"]["true_value"] is None


def test_options_of_a_case_override_and_are_hashed(tmp_path: Path) -> None:
    plain = task_of(DrawnCase(3), tmp_path, rigid={"bandwidth_hz": 9.0})
    own = task_of(DrawnCase(3, 7.0), tmp_path, rigid={"bandwidth_hz": 9.0})
    assert plain.options_sha256 != own.options_sha256
    worker.answer(own)
    (row,) = sw.read_runs(tmp_path).to_pylist()
    document = sw.read_result(tmp_path / row["result"]).document
    assert document["options"]["rigid"]["bandwidth_hz"] == 7.0


def test_a_study_file_has_no_true_values(tmp_path: Path) -> None:
    from strainwave.fleet.campaign.study_files import find

    plan = CampaignPlan(Store(tmp_path / "store"), "test", ("rigid",), {})
    task = plan.next(find([str(rig(tmp_path / "rig"))]).cases[0])
    assert isinstance(task, Task)
    worker.answer(task)
    (row,) = sw.read_runs(tmp_path / "store").to_pylist()
    assert row["classes"] is None
    values = sw.read_parameters(tmp_path / "store").to_pylist()
    assert {p["true_value"] for p in values} == {None}
