"""Feedback from measured angles: what it holds, and what it leaves alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from benchmarks.studies.drawn_chains import draw_chain, simulate_chain

from strainwave.domain import FloatArray, JointModel
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.preparation import coarsen_steps, dataset_of
from strainwave.identification.whole_arm.records.tracking import tracked_inertias
from strainwave.io.logs import read_log
from strainwave.io.study import read_study
from strainwave.virtual.experiments import derived
from tuning_runs import joint_models, truth

CUTOFF = 60.0


@cache
def hanging() -> tuple[tuple[Dataset, ...], Values]:
    """The records of a chain of two joints under gravity, with its true values."""
    chain = draw_chain(0, (2,), ("motor",))
    with TemporaryDirectory() as folder:
        simulate_chain(chain, Path(folder), 0)
        study = read_study(Path(folder) / "study.toml")
        arm = Arm.of(study.arm)
        logs = [read_log(study, one) for one in study.experiments if one.use == "frequency"]
    records = tuple(dataset_of(log, arm, CUTOFF) for log in logs)
    return records, derived(chain.values, study.arm)


def models(values: Values, arm: Arm) -> list[JointModel]:
    """Models of single joints with the inertias of an outstretched arm."""
    base = np.array([values[key] for key in arm.base_names])
    links = np.diagonal(arm.inertia_matrix(base, np.zeros(arm.n_joints)))
    templates = joint_models(*truth("linear"), 0.0, np.ones((2, 6)))
    return [
        replace(
            template,
            joint=i,
            values={"motor_inertia": values["motor_inertia", i], "link_inertia": float(link)},
        )
        for i, (template, link) in enumerate(zip(templates, links, strict=True), start=1)
    ]


def errors(record: Dataset, values: Values) -> FloatArray:
    """Differences (n_samples, n_joints) [rad] of simulated and measured motor angles."""
    run = record.run(values, record.start(), ["motor_angle"])
    measured = [record.log.channels[f"theta_m{i}"] for i in (1, 2)]
    return np.asarray(run["motor_angle"] - np.column_stack(measured))


def tracked(record: Dataset, values: Values) -> Dataset:
    inertia = tracked_inertias(models(values, record.arm), record.arm)
    assert inertia is not None
    return replace(record, tracked_inertia=inertia)


def test_the_true_arm_moves_as_without_feedback() -> None:
    """The feedback adds the rounding of the encoder only."""
    records, values = hanging()
    for record in records:
        alone = errors(record, values)
        held = errors(tracked(record, values), values)
        count = record.counts[0]
        assert np.max(np.abs(held)) < max(10.0 * count, np.max(np.abs(alone)))


def test_errors_of_the_model_do_not_grow() -> None:
    records, values = hanging()
    wrong = values | {key: 1.3 * x for key, x in values.items() if "first_moment" in key[0]}
    for record in records:
        alone, held = errors(record, wrong), errors(tracked(record, wrong), wrong)
        assert np.max(np.abs(held)) < 0.5 * np.max(np.abs(alone))


def test_derivatives_under_feedback_are_those_of_the_channels() -> None:
    records, values = hanging()
    record = tracked(coarsen_steps(records[0], 1e-3), values)
    key = ("motor_inertia", 1)
    step = 1e-5 * values[key]
    _, columns = record.linearise(values, record.start(), [key])
    high, low = (
        record.linearise(values | {key: values[key] + s}, record.start(), [])[0]
        for s in (step, -step)
    )
    difference = (high - low) / (2.0 * step)
    size = np.max(np.abs(difference))
    assert columns[..., 0] == pytest.approx(difference, abs=1e-3 * size)


def test_an_arm_without_gravity_is_not_held() -> None:
    study, values = truth("linear")
    joints = joint_models(study, values, 0.0, np.ones((2, 6)))
    assert tracked_inertias(joints, Arm.of(study.arm)) is None


def test_joints_without_inertia_are_not_held() -> None:
    records, values = hanging()
    first, second = models(values, records[0].arm)
    assert tracked_inertias([first], records[0].arm) is None
    impossible = replace(second, values={"motor_inertia": -1.0, "link_inertia": 0.0})
    assert tracked_inertias([first, impossible], records[0].arm) is None
    best = tracked_inertias([first, second, impossible], records[0].arm)
    assert best is not None
    assert np.all(best > 0.0)
