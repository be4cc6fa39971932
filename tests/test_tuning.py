"""Fine tuning of the whole arm on closed-loop steps."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from strainwave import decoupling, links, logs, physical, rigid, signals, validation
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.parameters import Values, read_parameters
from strainwave.records import Arm, ArmModel, Experiment, Joint, JointModel, Log, Servo, Study
from strainwave.study import read_study
from strainwave.tuning import TuningOptions, tune
from strainwave.virtual import derived, simulate_study
from tuning_runs import (
    JOINT_NAMES,
    joint_model,
    joint_models,
    rig_logs,
    rigid_model,
    truth,
)

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))  # every start 5 % off


def tuned(
    options: TuningOptions | None = None, joints: Sequence[JointModel] | None = None
) -> ArmModel:
    study, records = rig_logs()
    known = truth()[1]
    start = joints or joint_models(study, known, 0.05, FACTORS)
    return tune(records, rigid_model(study, known, 0.02, 1.0), start, study, options)


@cache
def standard() -> ArmModel:
    return tuned()


def relative_errors(model: ArmModel, known: Values) -> dict[tuple[str, int | None], float]:
    return {
        (p.name, p.joint): p.value / known[p.name, p.joint] - 1.0
        for p in model.parameters
        if p.value is not None and p.stage == "tuned"
    }


def test_wrong_starts_come_back() -> None:
    model = standard()
    assert model.status == "converged"
    errors = relative_errors(model, truth()[1])
    # steps of 1.5 s with 8192 counts; over seeds the errors' deviations are a third of these
    for (name, _), error in errors.items():
        limit = 0.004
        if "damping" in name or name.startswith("total"):
            limit = 0.04
        elif name.endswith("viscous_friction"):
            limit = 0.12
        assert abs(error) < limit, (name, error)
    deviations = [
        abs(p.value - truth()[1][p.name, p.joint]) / p.std
        for p in model.parameters
        if p.value is not None and p.std
    ]
    assert max(deviations) < 3.5
    assert len(model.covariance) == len(model.parameters)


def test_the_fit_rises_and_records_never_seen_are_predicted() -> None:
    model = standard()
    study, records = rig_logs()
    for name, joint in (("step-j1", 1), ("step-j2", 2)):
        channel = f"omega_m{joint}"
        assert model.fit_percent[name][channel] > model.initial_fit_percent[name][channel]
        assert model.fit_percent[name][channel] > 99.0
    assert [p.experiment for p in model.simulated] == ["step-j1", "step-j2"]
    assert [p.experiment for p in model.initial] == ["step-j1", "step-j2"]
    for log in records:
        if log.experiment.use == "check":
            prediction = validation.predict_elastic(model, log, study)
            assert min(prediction.fit_percent.values()) > 97.0


def test_what_is_derived_adds_up() -> None:
    model = standard()
    value = model.values
    by_name = {(p.name, p.joint): p for p in model.parameters}
    sum_1 = value["alpha", None] + value["beta", None] + 2.0 * value["gamma", None]
    assert by_name["link_inertia", 1].value == pytest.approx(sum_1)
    assert by_name["link_inertia", 2].value == pytest.approx(value["beta", None])
    for joint in (1, 2):
        total = value["motor_viscous_friction", joint]
        total += 1e-4 * value["link_viscous_friction", joint]
        assert by_name["total_viscous_friction", joint].value == pytest.approx(total)
        # better known than either of the two
        std = by_name["total_viscous_friction", joint].std
        split = np.sqrt(np.diag(model.covariance))[
            list(by_name).index(("motor_viscous_friction", joint))
        ]
        assert std is not None
        assert std < split
        coulomb = by_name["motor_coulomb_friction", joint]
        assert (coulomb.value, coulomb.stage) == (value["motor_coulomb_friction", joint], "rigid")


def test_a_vague_viscous_friction_is_not_printed() -> None:
    study, _ = rig_logs()
    joints = list(joint_models(study, truth()[1], 0.05, FACTORS))
    deviation = np.sqrt(np.diag(joints[0].covariance))
    names = list(joints[0].values)
    for name in ("motor_viscous_friction", "link_viscous_friction"):
        deviation[names.index(name)] = 3.0 * joints[0].values[name]
    joints[0] = replace(joints[0], covariance=np.diag(deviation**2))
    # encoders and one joint's small step alone
    model = tune(
        [log for log in rig_logs()[1] if log.name == "step-j2"],
        rigid_model(study, truth()[1], 0.02),
        joints,
        study,
        TuningOptions(accelerometers=False),
    )
    by_name = {(p.name, p.joint): p.value for p in model.parameters}
    assert by_name["link_viscous_friction", 1] is None
    assert by_name["total_viscous_friction", 1] is not None
    assert ("link_viscous_friction", 1) in model.values
    said = [c.where for c in model.warnings if c.code == "not-identifiable"]
    assert "link_viscous_friction of joint 1" in said


def test_a_negative_viscous_friction_starts_positive() -> None:
    study, _ = rig_logs()
    joints = list(joint_models(study, truth()[1], 0.05, FACTORS))
    values = {**joints[0].values, "link_viscous_friction": -0.1, "motor_viscous_friction": 2.6e-4}
    deviation = np.sqrt(np.diag(joints[0].covariance))
    deviation[1], deviation[3] = 1e-4, 1.0
    joints[0] = replace(joints[0], values=values, covariance=np.diag(deviation**2))
    model = tuned(TuningOptions(max_iterations=15), joints)
    assert model.values["link_viscous_friction", 1] > 0.0
    assert model.values["motor_viscous_friction", 1] > 0.0


def test_a_parameter_at_the_end_of_its_range_is_told() -> None:
    study, _ = rig_logs()
    # certain of what is 5 % wrong
    sure = [
        replace(joint, covariance=1e-6 * joint.covariance)
        for joint in joint_models(study, truth()[1], 0.05, FACTORS)
    ]
    model = tuned(TuningOptions(span=0.02), sure)
    assert model.status == "at-bounds"
    bounded = [c.where for c in model.warnings if c.code == "at-bounds"]
    assert any(where.startswith("gear_stiffness") for where in bounded)
    start = sure[0].values["gear_stiffness"]
    assert abs(model.values["gear_stiffness", 1] / start - 1.0) < 0.021
    wider = tuned(TuningOptions(span=0.2), sure)
    assert abs(wider.values["gear_stiffness", 1] / start - 1.0) > 0.03


def test_too_few_iterations_are_told() -> None:
    model = tuned(TuningOptions(max_iterations=2))
    assert model.status == "iteration-limit"
    assert model.iterations <= 2
    assert "iteration-limit" in [c.code for c in model.warnings]


def test_the_other_options_change_the_outcome() -> None:
    usual = standard()
    low = tuned(TuningOptions(cutoff_hz=30.0))
    assert low.values != usual.values
    encoders = tuned(TuningOptions(accelerometers=False))
    assert set(usual.fit_percent["step-j1"]) == {"omega_m1", "omega_m2", "a1", "a2"}
    assert encoders.values != usual.values
    doubtful = tuned(TuningOptions(least_deviation=0.5))
    split = [(p.name, p.joint) for p in usual.parameters].index(("link_viscous_friction", 1))
    assert doubtful.covariance[split, split] > 1.2 * usual.covariance[split, split]


def test_a_three_slope_gear_gets_one_stiffness() -> None:
    study, records = rig_logs("three-slope")
    known = truth("three-slope")[1]
    known |= {("gear_stiffness", 1): 21000.0, ("gear_stiffness", 2): 5400.0}
    joints = joint_models(study, known, 0.02, FACTORS)
    model = tune(records, rigid_model(study, known, 0.005), joints, study)
    for joint in (1, 2):
        stiffness = model.values["gear_stiffness", joint]
        assert known["gear_stiffness_k1", joint] < stiffness < known["gear_stiffness_k3", joint]
    said = [c.where for c in model.warnings if c.code == "equivalent-stiffness"]
    assert said == ["gear_stiffness of joint 1", "gear_stiffness of joint 2"]
    for log in records:
        if log.name.startswith("step-check"):
            fits = validation.predict_elastic(model, log, study).fit_percent
            assert fits[f"omega_m{log.experiment.joint}"] > 97.0


def single_joint(folder: Path) -> tuple[Study, Values, list[Log]]:
    """One elastic joint that swings a pendulum."""
    joint = Joint(
        spring="linear",
        gear_ratio=0.01,
        torque_per_volt=0.08,
        encoder_counts=8192,
        accelerometer_distance=0.3,
        accelerometer_hz=300.0,
    )
    study = Study(
        path=folder / "plan.toml",
        sha256="",
        arm=Arm("single-joint", gravity=9.81),
        joints=(joint,),
        servo=Servo("pi-velocity", period=1e-3, kp=(0.12,), ki=(1.5,), limit=10.0),
        experiments=(Experiment("step", "step.parquet", "tuning", ("servo",), joint=1),),
    )
    values: Values = {
        ("motor_inertia", 1): 1.5e-4,
        ("motor_viscous_friction", 1): 2e-4,
        ("motor_coulomb_friction", 1): 0.06,
        ("friction_offset", 1): 0.0,
        ("link_inertia", 1): 2.0,
        ("link_viscous_friction", 1): 0.5,
        ("gear_stiffness", 1): 25000.0,
        ("gear_damping", 1): 20.0,
        ("gravity_torque_1", None): 15.0,
    }
    simulate_study(study, values, folder, replay=False)
    written = read_study(folder / "study.toml")
    return written, values, [logs.read_log(written, e) for e in written.experiments]


def test_a_single_joint_under_gravity(tmp_path: Path) -> None:
    study, values, records = single_joint(tmp_path)
    true = np.array([values[name, 1] for name in JOINT_NAMES])
    wrong = true * (1.0 + 0.05 * np.append(FACTORS[0], 0.0))
    deviation = 0.05 * true
    deviation[-1] *= 1e-3
    start = joint_model(
        study, 1, dict(zip(JOINT_NAMES, wrong.tolist(), strict=True)), np.diag(deviation**2)
    )
    model = tune(records, rigid_model(study, values, 0.01, 1.0), [start], study)
    assert model.status == "converged"
    for name, limit in [
        ("motor_inertia", 0.005),
        ("link_inertia", 0.005),
        ("gear_stiffness", 0.005),
        ("gear_damping", 0.05),
    ]:
        assert model.values[name, 1] == pytest.approx(values[name, 1], rel=limit)
    assert model.values["gravity_torque_1", None] == pytest.approx(15.0, rel=0.01)
    names = [(p.name, p.joint) for p in model.parameters]
    assert names.count(("link_inertia", 1)) == 1


def test_refusals() -> None:
    study, records = rig_logs()
    known = truth()[1]
    joints = joint_models(study, known, 0.05, FACTORS)
    model = rigid_model(study, known, 0.02)
    checks = [log for log in records if log.experiment.use == "check"]
    with pytest.raises(NotIdentifiable, match='record with use = "tuning"'):
        tune(checks, model, joints, study)
    with pytest.raises(NotIdentifiable, match='joint 2 has none: record it with use = "frequency"'):
        tune(records, model, joints[:1], study)
    with pytest.raises(NotIdentifiable, match="gamma from the rigid model"):
        tune(records, None, joints, study)
    wrong = replace(joints[1], values={**joints[1].values, "gear_damping": -1.0})
    with pytest.raises(NotIdentifiable, match="gear_damping of joint 2 = -1"):
        tune(records, model, [joints[0], wrong], study)
    # no arm has a coupling that large
    heavy = replace(joints[1], values={**joints[1].values, "link_inertia": 0.2})
    with pytest.raises(NotIdentifiable, match="cannot simulate what the steps before found"):
        tune(records, model, [joints[0], heavy], study)
    log = records[[r.name for r in records].index("step-j1")]
    bare = {name: signal for name, signal in log.channels.items() if name != "ref1"}
    with pytest.raises(InvalidInput, match="reference ref1"):
        tune([replace(log, channels=bare)], model, joints, study)


def lab_model(folder: Path) -> tuple[Study, list[Log], ArmModel]:
    """Every stage up to tuning, on one frequency record a joint."""
    study = read_study(folder / "study.toml")
    records = [logs.read_log(study, e) for e in study.experiments if e.use != "sweep"]
    motion = [signals.motor_side(r, study) for r in records if r.experiment.use == "motion"]
    model = rigid.fit(motion, study)
    joints = []
    for joint in (1, 2):
        log = next(r for r in records if r.name == f"prbs-j{joint}")
        seen = links.link_side(log, study)
        alone = decoupling.decouple(seen, model, study)[joint - 1]
        joints.append(physical.identify_joint([(seen, alone)], model, study))
    return study, records, tune(records, model, joints, study)


def test_a_lab_arm(shared_data: Path) -> None:
    folder = shared_data / "lab" / "scara-linear-5kg"
    study, records, model = lab_model(folder)
    known = json.loads((folder / "truth.json").read_text())
    assert model.status == "converged"
    for joint, true in enumerate(known["joints"], start=1):
        for name, limit in [("motor_inertia", 0.01), ("gear_damping", 0.03)]:
            assert model.values[name, joint] == pytest.approx(true[name], rel=limit)
        stiffness = model.values["gear_stiffness", joint]
        assert stiffness == pytest.approx(true["gear_stiffness"][0], rel=0.01)
    for name in ("alpha", "beta", "gamma"):
        assert model.values[name, None] == pytest.approx(known[name], rel=0.01)
    for log in records:
        if log.experiment.use == "check":
            fits = validation.predict_elastic(model, log, study).fit_percent
            excited = [log.experiment.joint] if log.experiment.joint else [1, 2]
            assert min(fits[f"omega_m{joint}"] for joint in excited) > 97.0


def test_a_lab_arm_under_gravity_from_wrong_starts(shared_data: Path) -> None:
    folder = shared_data / "lab" / "vertical-linear-0kg"
    study = read_study(folder / "study.toml")
    steps = [e for e in study.experiments if e.name.startswith("step-")]
    records = [logs.read_log(study, e) for e in steps]
    values = read_parameters(folder / "truth.json")
    known = derived({**values, ("friction_offset", 1): 0.0, ("friction_offset", 2): 0.0}, study)
    joints = joint_models(study, known, 0.05, FACTORS)
    model = tune(records, rigid_model(study, known, 0.01, 1.0), joints, study)
    for (name, joint), error in relative_errors(model, known).items():
        if "friction" not in name:
            assert abs(error) < (0.03 if "damping" in name else 0.01), (name, joint, error)
    for log in records:
        fits = validation.predict_elastic(model, log, study).fit_percent
        assert fits[f"omega_m{log.experiment.joint}"] > 99.0
