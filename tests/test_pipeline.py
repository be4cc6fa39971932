"""The pipeline on logs of arms with known parameters from another engine, and on measured logs."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from results import arm_model
from strainwave import pipeline
from strainwave.domain import (
    STAGES,
    Identification,
    JointModel,
    Parameter,
    Prbs,
    Spring,
    Study,
)
from strainwave.domain.keys import Values
from strainwave.domain.study import ProgressEvent
from strainwave.dynamics.arm import Arm
from strainwave.errors import NumericalFailure
from strainwave.io.logs import read_logs
from strainwave.io.parameters import read_parameters
from strainwave.io.results import to_document
from strainwave.pipeline import elastic_arm
from strainwave.pipeline.elastic_arm import (
    JointStage,
    fit_elastic_joints,
    predict_checks,
    typical_joints,
)
from strainwave.pipeline.inputs import Inputs, Reporter
from strainwave.virtual import experiments as virtual
from strainwave.virtual import scara
from strainwave.virtual.experiments import derived


@pytest.fixture(scope="session")
def lab(shared_data: Path) -> Callable[[str], tuple[Identification, dict[str, Any]]]:
    """Identification and true values of a laboratory arm, computed once per arm."""
    cache: dict[str, tuple[Identification, dict[str, Any]]] = {}

    def of(arm: str) -> tuple[Identification, dict[str, Any]]:
        if arm not in cache:
            folder = shared_data / "lab" / arm
            identification = pipeline.identify(folder / "study.toml")
            cache[arm] = identification, json.loads((folder / "truth.json").read_text())
        return cache[arm]

    return of


def test_progress_reports_the_current_part_and_the_number_of_parts(tmp_path: Path) -> None:
    """Parts are reported in order, and evaluations count up to their limit."""
    study = scara.STIFF.study(tmp_path, "linear")
    short = [replace(e, prbs=Prbs(8, 1e-3, 2, 10.0)) if e.prbs else e for e in study.experiments]
    used = [e for e in short if e.use in ("motion", "frequency")]
    study = replace(study, experiments=tuple(used))
    virtual.simulate_study(study, scara.STIFF.parameters(5, "linear"), tmp_path, as_recorded=False)
    events: list[ProgressEvent] = []
    identification = pipeline.identify(tmp_path / "study.toml", progress=events.append)
    pipeline.write(identification, tmp_path / "out", progress=events.append)
    texts = [str(event) for event in events]
    fractions = [event.fraction for event in events]
    assert fractions[0] == 0.0
    assert fractions == sorted(fractions)
    assert fractions[-1] < 1.0
    parts = [int(text.split(" of ")[0]) for text in texts]
    assert parts == sorted(parts)
    assert texts[0] == "1 of 8: reading the logs"
    assert texts[-1] == "8 of 8: writing the report"
    counts = [re.search(r"evaluation (\d+) of at most (\d+)", text) for text in texts]
    assert identification.whole_arm is not None
    evaluations = [int(match[1]) for match in counts if match]
    assert evaluations[:3] == [1, 2, 3]
    limits = [int(match[2]) for match in counts if match]
    assert limits[0] == 100
    assert all(n <= limit for n, limit in zip(evaluations, limits, strict=True))
    assert max(evaluations) >= identification.whole_arm.iterations  # later ones are of rivals


def value(model: JointModel, name: str) -> float:
    return model.values[name]


@pytest.mark.parametrize(
    ("arm", "tolerance"), [("scara-linear-5kg", 0.03), ("vertical-linear-0kg", 0.04)]
)
def test_every_frequency_record_of_a_linear_arm(
    arm: str, tolerance: float, lab: Callable[[str], tuple[Identification, dict[str, Any]]]
) -> None:
    """Inertias and stiffness within 3 % (vertical arm 4 %), gear damping within 20 %."""
    identification, truth = lab(arm)
    assert identification.reason is None
    assert identification.records
    for record in identification.records:
        assert record.physical is not None
        true_values = truth["joints"][record.physical.joint - 1]
        for name in ("motor_inertia", "link_inertia"):
            assert value(record.physical, name) == pytest.approx(true_values[name], rel=tolerance)
        stiffness = true_values["gear_stiffness"][0]
        assert value(record.physical, "gear_stiffness") == pytest.approx(stiffness, rel=tolerance)
        assert value(record.physical, "gear_damping") == pytest.approx(
            true_values["gear_damping"], rel=0.2
        )


def test_a_three_slope_arm_hardens_and_stays_within_its_slopes(
    shared_data: Path,
) -> None:
    folder = shared_data / "lab" / "scara-strainwave-3kg"
    truth = json.loads((folder / "truth.json").read_text())
    identification = pipeline.identify(folder / "study.toml", stages=("rigid", "decoupled"))
    assert [sweep.verdict for sweep in identification.sweeps] == ["hardening", "hardening"]
    for sweep in identification.sweeps:
        k1, _, k3 = truth["joints"][sweep.joint - 1]["gear_stiffness"]
        assert len(sweep.points) == 6
        assert all(0.97 * k1 < p.gear_stiffness < 1.03 * k3 for p in sweep.points)
        squared_frequencies = [p.squared_anti_resonance for p in sweep.points]
        assert squared_frequencies == sorted(squared_frequencies)


@pytest.mark.parametrize(
    ("arm", "inertia", "damping"),
    [("scara-linear-5kg", 0.002, 0.006), ("vertical-linear-0kg", 0.005, 0.02)],
)
def test_a_tuned_linear_arm_is_accurate_and_predicts_the_checks(
    arm: str,
    inertia: float,
    damping: float,
    lab: Callable[[str], tuple[Identification, dict[str, Any]]],
    shared_data: Path,
) -> None:
    """Velocities of the moved joints in closed loop: fit of at least 97 %."""
    identification, _ = lab(arm)
    model = identification.whole_arm
    assert model is not None
    assert model.status == "converged"
    offsets: Values = {("friction_offset", joint): 0.0 for joint in (1, 2)}
    values = read_parameters(shared_data / "lab" / arm / "truth.json")
    truth = derived({**values, **offsets}, identification.study.arm)
    limits: dict[str, float] = {
        **dict.fromkeys(("alpha", "beta", "gamma"), inertia),
        **dict.fromkeys(("motor_inertia", "link_inertia", "gear_stiffness"), inertia),
        "gear_damping": damping,
        "motor_coulomb_friction": 0.003,
        "total_viscous_friction": 0.02,
        **dict.fromkeys(("gravity_torque_1", "gravity_torque_2"), inertia),
    }
    reported = {p.key: p.value for p in model.parameters if p.value is not None}
    for key, estimate in reported.items():
        if true := truth.get(key, 0.0):
            assert abs(estimate / true - 1.0) < limits.get(key[0], np.inf), key
    names = {name for name, _ in reported}
    assert {"alpha", "gear_stiffness", "gear_damping", "motor_coulomb_friction"} <= names
    checks = {c.experiment: c.fit_percent for c in identification.checks}
    assert checks.keys() == {"motion-check", "step-check-j1", "step-check-j2"}
    for experiment, fits in checks.items():
        moved = [int(experiment[-1])] if experiment.startswith("step") else [1, 2]
        assert min(fits[f"omega_m{joint}"] for joint in moved) > 97.0


def short_study(folder: Path, *springs: Spring) -> Study:
    """Short records of the rig with these springs: a motion, and a PRBS of each joint."""
    study = scara.STIFF.study(folder, "linear")
    short = [replace(e, prbs=Prbs(9, 2e-3, 3, 6.0)) if e.prbs else e for e in study.experiments]
    used = tuple(e for e in short if e.use in ("motion", "frequency"))
    pairs = zip(study.arm.joints, springs, strict=True)
    joints = tuple(replace(joint, spring=spring) for joint, spring in pairs)
    study = replace(study, arm=study.arm.with_joints(joints), experiments=used)
    values = scara.STIFF.parameters(5, "linear")
    virtual.simulate_study(study, values, folder, as_recorded=False)
    return study


def fail(*_: object, **__: object) -> None:
    raise NumericalFailure("the motion diverged at 0.108 s")


def test_a_fit_that_diverges_keeps_the_earlier_stages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short_study(tmp_path, "linear", "linear")
    monkeypatch.setattr("strainwave.identification.whole_arm.fit_whole_arm", fail)
    one = pipeline.identify(tmp_path / "study.toml")
    assert [joint.joint for joint in one.joints] == [1, 2]
    assert (one.whole_arm, one.verdict.exit_code) == (None, 3)
    (warning,) = [w for w in one.warnings if w.code == "not-tuned"]
    assert "the motion diverged at 0.108 s" in warning.message
    assert "gear_ratio and torque_per_volt" in warning.message
    monkeypatch.setattr("strainwave.identification.rigid.fit_rigid", fail)
    without = pipeline.identify(tmp_path / "study.toml", stages=("rigid",))
    assert without.verdict.exit_code == 3
    assert "diverged at 0.108 s" in without.verdict.reasons[0]
    assert to_document(without)["status"] == "not-determined"


def test_rigid_joints_stay_rigid_beside_elastic_ones(tmp_path: Path) -> None:
    study = short_study(tmp_path, "linear", "rigid")
    one = pipeline.identify(tmp_path / "study.toml")
    truth = scara.STIFF.parameters(5, "linear")
    (joint,) = one.joints
    assert (joint.joint, one.whole_arm) == (1, None)
    assert joint.values["gear_stiffness"] == pytest.approx(truth["gear_stiffness", 1], rel=0.03)
    (motor,) = [p for p in one.parameters if p.key == ("motor_inertia", 2)]
    assert motor.value == pytest.approx(truth["motor_inertia", 2], rel=0.03)
    (warning,) = [w for w in one.warnings if w.code == "rigid-joints"]
    assert warning.message.startswith("joint 2 is rigid: prbs-j2")
    assert not [w for w in one.warnings if w.code in ("no-link-sensor", "not-tuned")]
    assert study.arm.joints[1].spring == "rigid"


def test_a_model_of_an_impossible_precision_is_a_failed_fit(tmp_path: Path) -> None:
    short_study(tmp_path, "linear", "rigid")
    (joint,) = pipeline.identify(tmp_path / "study.toml", stages=STAGES[:2]).joints
    precise = tuple(replace(p, std=1e-11 * abs(p.value or 0.0)) for p in joint.parameters)
    failed = JointStage((joint, replace(joint, joint=2, parameters=precise)))
    stage = elastic_arm._without_failed_fits(failed)
    assert stage.joints == (joint,)
    (warning,) = stage.warnings
    assert "which no record determines" in warning.message


def test_check_records_that_cannot_be_simulated_have_a_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The log of one record lacks a reference; a simulation of the other may diverge."""
    study = scara.STIFF.study(tmp_path, "linear")
    names = ("step-check-j1", "step-check-j2")
    study = replace(study, experiments=tuple(e for e in study.experiments if e.name in names))
    values = scara.STIFF.parameters(spring="linear")
    virtual.simulate_study(study, values, tmp_path)
    first, second = read_logs(study)
    channels = {name: x for name, x in second.channels.items() if name != "ref2"}
    parameters = tuple(
        Parameter.estimated(key, value, 0.01 * abs(value), "", "tuned")
        for key, value in values.items()
    )
    model = arm_model(parameters, np.diag([p.std or 0.0 for p in parameters]) ** 2)
    logs = (first, replace(second, channels=channels))
    inputs = Inputs(study, Arm.of(study.arm), logs, STAGES)
    checks, reasons = predict_checks(inputs, model, Reporter(STAGES, lambda _: None))
    assert [check.experiment for check in checks] == ["step-check-j1"]
    assert reasons == {"step-check-j2": "the log has no servo reference ref2"}

    def diverge(*_: object) -> None:
        raise NumericalFailure("the motion diverges")

    monkeypatch.setattr("strainwave.identification.validation.predict_elastic", diverge)
    checks, reasons = predict_checks(inputs, model, Reporter(STAGES, lambda _: None))
    assert (checks, reasons["step-check-j1"]) == ((), "the motion diverges")


def test_coupled_joints_start_from_typical_values_without_records_of_their_gears() -> None:
    study = scara.STIFF.study(Path("nowhere"))
    arm = Arm.of(replace(study.arm, kind="serial", coupling=((1.0, 0.0), (-0.8, 1.0))))
    inputs = Inputs(study, arm, (), ("decoupled",))
    stage = fit_elastic_joints(inputs, None, Reporter(inputs.stages, lambda _: None))
    assert not stage.joints
    assert "typical values" in stage.warnings[0].message
    assert not typical_joints(inputs, None).warnings  # without step records
