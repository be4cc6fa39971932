"""Whole-arm fit of all parameters, on records of virtual arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strainwave.domain import (
    ArmModel,
    Experiment,
    Joint,
    Log,
    SearchEnd,
    Servo,
    Study,
)
from strainwave.domain.arm.gear_laws import KNEES, SLOPES
from strainwave.domain.arm.kinds import single_joint
from strainwave.domain.arm.parameter_table import SETTLING
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification import validation
from strainwave.identification.whole_arm import WholeArmOptions, fit_whole_arm, search
from strainwave.identification.whole_arm.problem import starting_values
from strainwave.numerics import search as numerical_search
from strainwave.numerics.search import Minimum
from strainwave.virtual.experiments import derived
from tuning_runs import (
    JOINT_NAMES,
    joint_model,
    joint_models,
    later,
    rig_logs,
    rigid_model,
    shaken,
    simulated_logs,
    truth,
)
from virtual_arms import ELASTIC_JOINT

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))


def errors_of(model: ArmModel, known: Values) -> dict[tuple[str, int | None], tuple[float, float]]:
    """Relative error and normalised error of each reported parameter."""
    errors = {}
    for p in model.parameters:
        true = known.get((p.name, p.joint), 0.0)
        if p.value is not None and p.std is not None and true != 0.0:
            errors[p.name, p.joint] = (p.value / true - 1.0, (p.value - true) / p.std)
    return errors


def warnings(model: ArmModel, code: str) -> list[str]:
    return [warning.where for warning in model.warnings if warning.code == code]


def from_wrong_starts(
    records: Sequence[Log],
    study: Study,
    known: Values,
    options: WholeArmOptions | None = None,
    share: float = 0.05,
    start: Values | None = None,
) -> ArmModel:
    """Fit from joint models with relative errors `share`; inertias of the rigid model have 1 %."""
    joints = joint_models(study, known, share, FACTORS)
    model = rigid_model(study, known, 0.01, 1.0)
    return fit_whole_arm(records, model, joints, Arm.of(study.arm), options, start=start)


def rig_records() -> tuple[Study, Values, list[Log]]:
    """Open-loop records of 0.5 s, one for each joint, and a servoed step of joint 2."""
    study, true_values, shakes = shaken()
    step = next(log for log in rig_logs()[1] if log.name == "step-j2")
    first = {name: channel[:3200] for name, channel in step.channels.items()}
    return study, true_values, [*shakes, replace(step, time=step.time[:3200], channels=first)]


def whole_arm(options: WholeArmOptions | None = None, share: float = 0.2) -> ArmModel:
    study, true_values, records = rig_records()
    return from_wrong_starts(records, study, true_values, options, share)


@cache
def standard() -> ArmModel:
    return whole_arm()


def test_wrong_starts_come_back() -> None:
    """Joint models with errors of 20 %."""
    model = standard()
    true_values = truth()[1]
    assert model.status == "converged"
    errors = errors_of(model, true_values)
    for (name, joint), (relative, normalised) in errors.items():
        limit = 0.003
        if "damping" in name or name.startswith("total"):
            limit = 0.02
        elif name.endswith("viscous_friction"):
            limit = 0.3  # only the sum is well identified
        assert abs(relative) < limit, (name, joint, relative)
        assert abs(normalised) < 4.0, (name, joint, normalised)
    reported = {name for name, _ in errors}
    assert {name for name in JOINT_NAMES if "viscous" not in name} <= reported
    assert {"alpha", "beta", "gamma", "total_viscous_friction"} <= reported
    assert model.covariance.shape == (len(model.parameters),) * 2
    for parameter, variance in zip(model.parameters, np.diag(model.covariance), strict=True):
        if parameter.value is not None and parameter.std is not None:
            assert parameter.std == pytest.approx(np.sqrt(variance))
            half_width = 1.96 * parameter.std
            assert parameter.ci95 == (parameter.value - half_width, parameter.value + half_width)


def test_the_fit_improves_and_predicts_validation_records() -> None:
    model = standard()
    study, records = rig_logs()
    assert list(model.fit_percent) == ["prbs-j1", "prbs-j2", "step-j2"]
    for name, fits in model.fit_percent.items():
        assert list(fits) == ["omega_m1", "omega_m2", "a1", "a2"]
        before = model.initial_fit_percent[name]
        assert all(fits[channel] > before[channel] for channel in fits)
        # the noise is 5 % of the accelerometer with the smallest signal
        assert min(fits.values()) > 90.0
    assert [p.experiment for p in model.simulated] == ["step-j2"]
    assert [p.experiment for p in model.initial] == ["step-j2"]
    for log in records:
        if log.experiment.use == "check":
            prediction = validation.predict_elastic(model, log, Arm.of(study.arm))
            assert min(prediction.fit_percent.values()) > 97.0
            assert prediction.unexplained == {}


def test_a_wrong_servo_is_distinguished_from_a_wrong_arm() -> None:
    """The recorded voltages explain doubled servo gains, but not softer gears."""
    model = standard()
    study, records = rig_logs()
    log = next(candidate for candidate in records if candidate.name == "step-check-j1")
    assert study.arm.servo is not None
    gains = tuple(2.0 * kp for kp in study.arm.servo.kp)
    servo = replace(study.arm.servo, kp=gains)
    wrong = validation.predict_elastic(model, log, Arm.of(replace(study.arm, servo=servo)))
    assert {"omega_m1", "a1"} <= set(wrong.unexplained)
    assert min(wrong.unexplained.values()) > validation.MAX_UNEXPLAINED_STDS
    assert wrong.is_servo_at_fault
    soft = {
        key: 0.6 * value if key[0] == "gear_stiffness" else value
        for key, value in model.values.items()
    }
    arm = validation.predict_elastic(replace(model, values=soft), log, Arm.of(study.arm))
    assert arm.unexplained
    assert not arm.is_servo_at_fault
    # wide confidence intervals explain the same error
    std = [0.4 * (p.value or 0.0) if p.name == "gear_stiffness" else 0.0 for p in model.parameters]
    vague = replace(model, values=soft, covariance=np.diag(np.square(std)))
    assert not validation.predict_elastic(vague, log, Arm.of(study.arm)).unexplained


def test_derived_parameters_are_the_sums_of_their_parts() -> None:
    model = standard()
    value = model.values
    by_name = {(p.name, p.joint): p for p in model.parameters}
    assert len(by_name) == len(model.parameters)
    sum_1 = value["alpha", None] + value["beta", None] + 2.0 * value["gamma", None]
    assert by_name["link_inertia", 1].value == pytest.approx(sum_1)
    assert by_name["link_inertia", 2].value == pytest.approx(value["beta", None])
    stds = dict(zip(by_name, np.sqrt(np.diag(model.covariance)), strict=True))
    for joint in (1, 2):
        total = value["motor_viscous_friction", joint]
        total += 1e-4 * value["link_viscous_friction", joint]
        assert by_name["total_viscous_friction", joint].value == pytest.approx(total)
        # more accurate than each of the two
        split = stds["motor_viscous_friction", joint]
        assert stds["total_viscous_friction", joint] < split
    assert {p.stage for p in model.parameters} == {"tuned"}
    units = {p.name: p.unit for p in model.parameters}
    assert units["gear_stiffness"] == "N m/rad"
    assert units["total_viscous_friction"] == "N m s/rad"


@cache
def started_close() -> ArmModel:
    return whole_arm(share=0.05)


@cache
def curved(amplitude: float) -> ArmModel:
    study, true_values, records = shaken("three-slope", amplitude)
    return from_wrong_starts(records, study, true_values)


def test_slopes_and_knees_of_gears_that_are_under_large_torque() -> None:
    model = curved(10.0)
    assert model.status == "converged"
    errors = errors_of(model, truth("three-slope")[1])
    for joint in (1, 2):
        for name in SLOPES:
            assert abs(errors[name, joint][0]) < 0.005, (name, joint)
        for name in KNEES:
            assert abs(errors[name, joint][0]) < 0.02, (name, joint)
        assert abs(errors["gear_damping", joint][0]) < 0.01
    assert max(abs(normalised) for _, normalised in errors.values()) < 4.0
    assert warnings(model, "not-reached") == []
    assert not any(p.name == "gear_stiffness" for p in model.parameters)
    # the curve also predicts steps of other amplitudes
    study, records = rig_logs("three-slope")
    for log in records:
        if log.name.startswith("step-check"):
            fits = validation.predict_elastic(model, log, Arm.of(study.arm)).fit_percent
            assert fits[f"omega_m{log.experiment.joint}"] > 99.0


def test_stiffnesses_beyond_a_small_amplitude_are_reported() -> None:
    model = curved(1.5)
    missing = {(p.name, p.joint) for p in model.parameters if p.value is None}
    curve = {key for key in missing if key[0] in (*SLOPES, *KNEES)}
    assert curve
    not_reached = warnings(model, "not-reached")
    assert set(not_reached) == {f"{name} of joint {joint}" for name, joint in curve}
    # the model has all values that a simulation requires
    assert curve <= set(model.values)
    true_values = truth("three-slope")[1]
    reported = {(p.name, p.joint): p.value for p in model.parameters}
    for joint in (1, 2):
        name = "gear_stiffness_k1"
        assert reported[name, joint] == pytest.approx(true_values[name, joint], rel=0.03)


def test_no_slope_is_reported_that_was_not_reached() -> None:
    model = curved(1.5)
    errors = errors_of(model, truth("three-slope")[1])
    for name in (*SLOPES, *KNEES):
        for joint in (1, 2):
            assert abs(errors.get((name, joint), (0.0, 0.0))[1]) < 5.0, (name, joint)


def test_a_friction_settling_time_is_recovered() -> None:
    times = (3e-4, 2e-4)
    study, true_values, records = shaken("linear", 8.0, times)
    model = from_wrong_starts(records, study, true_values)
    assert model.status == "converged"
    errors = errors_of(model, true_values)
    for joint, time in enumerate(times, start=1):
        assert model.values[SETTLING, joint] == pytest.approx(time, rel=0.1)
        assert abs(errors[SETTLING, joint][1]) < 4.0
        assert abs(errors["motor_inertia", joint][0]) < 0.003
    where = [f"friction_settling_time of joint {joint}" for joint in (1, 2)]
    assert warnings(model, "friction-settles") == where
    # without the settling time, other parameters compensate for it
    at_once = from_wrong_starts(records, study, true_values, WholeArmOptions(settling=False))
    assert at_once.values[SETTLING, 1] == 0.0
    assert errors_of(at_once, true_values)["motor_inertia", 1][0] > 0.004
    for name, fits in model.fit_percent.items():
        assert all(fits[c] > at_once.fit_percent[name][c] for c in fits)


def test_friction_that_acts_at_once_needs_no_time() -> None:
    model = standard()
    assert warnings(model, "friction-settles") == []
    assert not any(p.name == SETTLING for p in model.parameters)
    assert model.values[SETTLING, 1] == model.values[SETTLING, 2] == 0.0
    with_settling = whole_arm(WholeArmOptions(settling=True), share=0.05)
    assert 0.0 < with_settling.values[SETTLING, 1] < 3e-5


@cache
def in_motion(first: int) -> tuple[ArmModel, Values]:
    """Fit to the records from sample `first` on, and the true values."""
    study, true_values, records = shaken("linear", 8.0)
    records_in_motion = [later(log, first) for log in records]
    return from_wrong_starts(records_in_motion, study, true_values), true_values


def test_records_that_begin_in_motion() -> None:
    model, true_values = in_motion(600)
    assert model.status == "converged"
    errors = errors_of(model, true_values)
    for (name, joint), (relative, normalised) in errors.items():
        limit = 0.02 if "damping" in name or name.startswith("total") else 0.003
        if not name.endswith("viscous_friction") or name.startswith("total"):
            assert abs(relative) < limit, (name, joint, relative)
        assert abs(normalised) < 4.0, (name, joint)


def test_records_that_begin_in_motion_are_repeated() -> None:
    model, _ = in_motion(600)
    assert all(min(fits.values()) > 95.0 for fits in model.fit_percent.values())


def test_records_that_begin_in_motion_elsewhere() -> None:
    model, _ = in_motion(900)
    assert model.status == "converged"


def pendulum() -> tuple[Study, Values, tuple[Log, ...]]:
    """Elastic joint with a pendulum, initially held up by a servo."""
    joint = Joint(
        spring="linear",
        gear_ratio=0.01,
        torque_per_volt=0.08,
        encoder_counts=8192,
        accelerometer_distance=0.3,
        accelerometer_hz=300.0,
    )
    study = Study(
        path=Path("nowhere"),
        sha256="",
        arm=single_joint(
            joint,
            gravity=9.81,
            servo=Servo("pi-velocity", period=1e-3, kp=(0.12,), ki=(1.5,), limit=10.0),
        ),
        experiments=(Experiment("step", "step.parquet", "tuning", ("servo",), joint=1),),
    )
    values: Values = ELASTIC_JOINT | {("gravity_torque_1", None): 15.0}
    written, records = simulated_logs(study, values)
    return written, values, records


def test_a_single_joint_under_gravity() -> None:
    study, values, records = pendulum()
    true = np.array([values[name, 1] for name in JOINT_NAMES])
    wrong = true * (1.0 + 0.05 * np.append(FACTORS[0], 0.0))
    named = dict(zip(JOINT_NAMES, wrong.tolist(), strict=True))
    start = joint_model(study, 1, named, np.diag((0.05 * true) ** 2))
    model = fit_whole_arm(
        records, rigid_model(study, values, 0.01, 1.0), [start], Arm.of(study.arm)
    )
    # one step hardly determines the individual viscous frictions, so they may converge slowly
    for name, limit in [
        ("motor_inertia", 0.005),
        ("link_inertia", 0.005),
        ("gear_stiffness", 0.005),
        ("gear_damping", 0.03),
        ("motor_coulomb_friction", 0.005),
    ]:
        assert model.values[name, 1] == pytest.approx(values[name, 1], rel=limit)
    assert model.values["gravity_torque_1", None] == pytest.approx(15.0, rel=0.005)
    names = [(p.name, p.joint) for p in model.parameters]
    assert names.count(("link_inertia", 1)) == 1
    with pytest.raises(NotIdentifiable, match="gravity_torque_1"):
        fit_whole_arm(records, None, [start], Arm.of(study.arm))


def test_a_negative_viscous_friction_starts_positive() -> None:
    study, true_values, records = rig_records()
    joints = list(joint_models(study, true_values, 0.05, FACTORS))
    values = {**joints[0].values, "link_viscous_friction": -0.1, "motor_viscous_friction": 2.6e-4}
    joints[0] = replace(joints[0], values=values)
    model = fit_whole_arm(
        records[:2], rigid_model(study, true_values, 0.01), joints, Arm.of(study.arm)
    )
    assert model.values["link_viscous_friction", 1] > 0.0
    assert model.values["motor_viscous_friction", 1] > 0.0
    total = next(p for p in model.parameters if p.name == "total_viscous_friction")
    assert total.value == pytest.approx(2.5e-4, rel=0.02)


def test_a_vague_viscous_friction_is_not_printed() -> None:
    """Encoders alone, with 3 V, hardly separate motor-side from link-side friction."""
    study, true_values, records = shaken("linear", 3.0)
    motor_records = [
        replace(log, channels={k: x for k, x in log.channels.items() if k[0] in "ut"})
        for log in records
    ]
    model = from_wrong_starts(motor_records, study, true_values)
    assert set(model.fit_percent["prbs-j1"]) == {"omega_m1", "omega_m2"}
    missing = [(p.name, p.joint) for p in model.parameters if p.value is None]
    assert ("link_viscous_friction", 1) in missing
    assert set(warnings(model, "not-identifiable")) == {f"{n} of joint {j}" for n, j in missing}
    assert set(missing) <= set(model.values)
    errors = errors_of(model, true_values)
    assert all(abs(errors["total_viscous_friction", joint][0]) < 0.05 for joint in (1, 2))


def test_a_stiffness_beyond_its_first_range_is_found() -> None:
    """The range is a factor of three, and the stiffness starts at 0.3 of the true value."""
    study, true_values, records = rig_records()
    joints = list(joint_models(study, true_values, 0.0, FACTORS))
    start = 0.3 * true_values["gear_stiffness", 2]
    joints[1] = replace(joints[1], values={**joints[1].values, "gear_stiffness": start})
    model = fit_whole_arm(
        records[1:2],
        rigid_model(study, true_values, 0.01),
        joints,
        Arm.of(study.arm),
        WholeArmOptions(settling=False),
    )
    assert model.status == "converged"
    true = true_values["gear_stiffness", 2]
    assert model.values["gear_stiffness", 2] == pytest.approx(true, rel=0.01)


def test_a_parameter_at_the_end_of_its_range_is_reported() -> None:
    study, true_values, records = rig_records()
    joints = joint_models(study, true_values, 0.0, FACTORS)
    model = fit_whole_arm(
        records[1:2],
        rigid_model(study, true_values, 0.01),
        joints,
        Arm.of(study.arm),
        WholeArmOptions(settling=False, ranges={"gear_stiffness": (0.5, 0.9)}),
    )
    assert model.status == "at-bounds"
    assert "gear_stiffness of joint 2" in warnings(model, "at-bounds")
    assert ("gear_stiffness", 2) in model.at_bounds


def test_inertias_that_rest_on_one_at_its_bound_are_at_it_as_well() -> None:
    """beta is limited to 0.9 of the true value; the link inertias depend on it."""
    study, true_values, records = rig_records()
    model = fit_whole_arm(
        records[1:2],
        rigid_model(study, true_values, 0.01),
        joint_models(study, true_values, 0.0, FACTORS),
        Arm.of(study.arm),
        WholeArmOptions(settling=False, ranges={"beta": (0.5, 0.9)}),
    )
    assert model.at_bounds == (("beta", None), ("link_inertia", 1), ("link_inertia", 2))


def test_too_few_iterations_are_reported() -> None:
    model = whole_arm(WholeArmOptions(max_iterations=2))
    assert model.status == "iteration-limit"
    assert "iteration-limit" in [warning.code for warning in model.warnings]
    assert model.iterations <= 2 < standard().iterations


@pytest.mark.parametrize(
    ("end", "status", "warned"),
    [
        (SearchEnd.STALLED, "converged", set()),
        (SearchEnd.NO_DESCENT, "no-descent", {"no-descent"}),
    ],
)
def test_the_result_states_why_its_last_search_ended(
    monkeypatch: pytest.MonkeyPatch, end: SearchEnd, status: str, warned: set[str]
) -> None:
    def ended(*args: Any, **options: Any) -> Minimum | None:
        minimum = numerical_search.minimise(*args, **options)
        return minimum and replace(minimum, end=end)

    monkeypatch.setattr(search, "minimise", ended)
    model = whole_arm()
    assert (model.end, model.status) == (end, status)
    codes = {warning.code for warning in model.warnings}
    assert codes & {"no-descent", "iteration-limit"} == warned


def test_the_other_options_change_the_outcome() -> None:
    reference = started_close()
    low = whole_arm(WholeArmOptions(cutoff_hz=30.0), share=0.05)
    assert low.values != reference.values
    assert low.values["gear_stiffness", 1] == pytest.approx(25000.0, rel=0.01)
    # the option sets the weight of the correct friction of the rigid model
    weak_prior = whole_arm(WholeArmOptions(least_deviation=0.5), share=0.05)
    study, known_values, _ = rig_records()
    friction = ("total_viscous_friction", 1)
    errors = [
        p.value - derived(known_values, study.arm)[friction]
        for arm in (reference, weak_prior)
        for p in arm.parameters
        if (p.name, p.joint) == friction and p.value is not None
    ]
    assert abs(errors[1]) > 2.0 * abs(errors[0])


def test_refusals() -> None:
    study, true_values, records = rig_records()
    joints = joint_models(study, true_values, 0.05, FACTORS)
    model = rigid_model(study, true_values, 0.01)
    checks = [log for log in rig_logs()[1] if log.experiment.use == "check"]
    with pytest.raises(NotIdentifiable, match='use = "frequency", "sweep" or "tuning"'):
        fit_whole_arm(checks, model, joints, Arm.of(study.arm))
    with pytest.raises(NotIdentifiable, match='joint 2 has none: record it with use = "frequency"'):
        fit_whole_arm(records, model, joints[:1], Arm.of(study.arm))
    with pytest.raises(NotIdentifiable, match="needs gamma, which"):
        fit_whole_arm(records, None, joints, Arm.of(study.arm))
    brief = {name: channel[:60] for name, channel in records[0].channels.items()}
    short = replace(records[0], time=records[0].time[:60], channels=brief)
    with pytest.raises(InvalidInput, match="record at least"):
        fit_whole_arm([short], model, joints, Arm.of(study.arm))
    # a record that cannot be simulated is not used
    without_encoder = [
        replace(log, channels={k: x for k, x in log.channels.items() if k != "theta_m1"})
        for log in records
    ]
    with pytest.raises(NotIdentifiable, match="angle and the voltage of every motor"):
        fit_whole_arm(without_encoder, model, joints, Arm.of(study.arm))


def test_a_motor_that_has_not_moved_yet_is_no_obstacle() -> None:
    """In the first 37 ms of a record of joint 1, the friction of motor 2 has no effect."""
    study, true_values, records = rig_records()
    brief = {name: channel[:150] for name, channel in records[0].channels.items()}
    model = from_wrong_starts(
        [replace(records[0], time=records[0].time[:150], channels=brief)], study, true_values
    )
    for parameter in model.parameters:
        assert parameter.std is None or np.isfinite(parameter.std)


@pytest.mark.parametrize(
    ("joint", "name", "value", "where"),
    [
        (2, "gear_damping", -2.1, "gear_damping of joint 2"),
        (1, "motor_inertia", -1e-4, "motor_inertia of joint 1"),
        (2, "gear_stiffness", -12146.0, "gear_stiffness of joint 2"),
        (1, "link_inertia", 0.2, "alpha"),  # impossible inertia matrix
    ],
)
def test_an_impossible_start_is_replaced(joint: int, name: str, value: float, where: str) -> None:
    """The fit converges to the same parameters, and a warning lists the rejected start."""
    study, true_values, records = rig_records()
    joints = list(joint_models(study, true_values, 0.05, FACTORS))
    wrong = joints[joint - 1]
    joints[joint - 1] = replace(wrong, values={**wrong.values, name: value})
    model = fit_whole_arm(records, rigid_model(study, true_values, 0.01), joints, Arm.of(study.arm))
    assert model.status == "converged"
    assert warnings(model, "start-rejected") == [where]
    for key, (relative, normalised) in errors_of(model, true_values).items():
        assert abs(normalised) < 4.0, key
        if key[0] in ("gear_stiffness", "motor_inertia", "link_inertia"):
            assert abs(relative) < 0.003, key


def test_a_rejected_stiffness_may_be_far_from_the_typical_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Light wrists are a hundred times as stiff as a typical joint with their inertia."""
    monkeypatch.setattr(starting_values, "TYPICAL_ANTI_RESONANCE_HZ", 1.5)
    study, true_values, records = rig_records()
    joints = list(joint_models(study, true_values, 0.05, FACTORS))
    joints[1] = replace(joints[1], values={**joints[1].values, "gear_stiffness": -1.0})
    model = fit_whole_arm(records, rigid_model(study, true_values, 0.01), joints, Arm.of(study.arm))
    assert model.status == "converged"
    assert abs(errors_of(model, true_values)["gear_stiffness", 2][0]) < 0.003


def test_undetermined_starting_values_are_refused() -> None:
    study, true_values, records = rig_records()
    joints = joint_models(study, true_values, 0.05, FACTORS)
    negative_inertia = replace(joints[1], values={**joints[1].values, "link_inertia": -0.2})
    model = rigid_model(study, true_values, 0.01)
    wrong = tuple(replace(p, value=-0.6) if p.name == "beta" else p for p in model.parameters)
    negative_beta = replace(model, parameters=wrong, solution=np.array([p.value for p in wrong]))
    with pytest.raises(NotIdentifiable, match="signs, units and assignment"):
        fit_whole_arm(records, negative_beta, [joints[0], negative_inertia], Arm.of(study.arm))


def test_a_curve_with_a_start_knee_beyond_the_load_is_recovered() -> None:
    """A knee at twice the largest torque does not affect the records: its derivative is zero."""
    study, true_values, records = shaken("three-slope", 10.0)
    start: Values = {(KNEES[1], joint): 8.0 * true_values[KNEES[1], joint] for joint in (1, 2)}
    model = from_wrong_starts(records, study, true_values, start=start)
    errors = errors_of(model, true_values)
    for joint in (1, 2):
        for name in (*SLOPES[:2], KNEES[0]):
            assert abs(errors[name, joint][0]) < 0.02, (name, joint)


@cache
def from_true_start(spring: str) -> ArmModel:
    """Fit that starts at the true values."""
    study, true_values, records = shaken(spring) if spring == "three-slope" else rig_records()
    return from_wrong_starts(records, study, true_values, share=0.2, start=true_values)


def test_a_start_may_be_given() -> None:
    """A fit that starts at the true values needs fewer iterations."""
    _, true_values, _ = rig_records()
    model = from_true_start("linear")
    assert model.status == "converged"
    assert model.iterations < 0.7 * standard().iterations
    for (name, joint), (_, normalised) in errors_of(model, true_values).items():
        assert abs(normalised) < 4.0, (name, joint, normalised)


@pytest.mark.parametrize("spring", ["linear", "three-slope"])
@pytest.mark.parametrize("seed", [0, 1])
def test_starts_from_far_end_at_the_same_place(spring: str, seed: int) -> None:
    """Random start: 30 % error in every parameter, a factor of 3 in gear damping."""
    study, true_values, records = shaken(spring, 10.0) if spring == "three-slope" else rig_records()
    rng = np.random.default_rng(seed)
    start: Values = {}
    while (
        not start or start["alpha", None] * start["beta", None] < 1.02 * start["gamma", None] ** 2
    ):
        for key, value in true_values.items():
            up = 3.0 if key[0] == "gear_damping" else 1.3
            down = 1.0 / 3.0 if key[0] == "gear_damping" else 0.7
            start[key] = value * float(rng.choice([up, down]))
    reference = from_true_start(spring)
    model = from_wrong_starts(records, study, true_values, share=0.2, start=start)
    assert model.status == "converged"
    ends = {(p.name, p.joint): p for p in model.parameters}
    for p in reference.parameters:
        end = ends[p.name, p.joint]
        if p.value is not None and p.std is not None and end.value is not None:
            assert abs(end.value - p.value) < 0.5 * p.std, (p.name, p.joint)
