"""Delay, scale and drift of link sensors in the whole-arm fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from strainwave.domain import ArmModel, Log, Study, WholeArmOptions
from strainwave.domain.arm.parameter_table import of_record
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import shift_samples
from strainwave.identification.whole_arm import fit_whole_arm
from strainwave.identification.whole_arm.problem.parameter_space import is_held
from strainwave.identification.whole_arm.records.preparation import dataset_of
from strainwave.identification.whole_arm.search import Fit
from strainwave.identification.whole_arm.selection.sensor_constants import (
    constants_of,
    significant_drifts,
)
from strainwave.identification.whole_arm.start import prepare_start
from tuning_runs import joint_models, rigid_model, shaken

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))
CUTOFF = 80.0


def read_so(log: Log, late: tuple[float, float], scale: tuple[float, float]) -> Log:
    """Log with delays [s] and scale factors of the accelerometers."""
    channels = dict(log.channels)
    for i in (1, 2):
        ahead = -late[i - 1] / log.sample_time
        channels[f"a{i}"] = scale[i - 1] * shift_samples(channels[f"a{i}"], ahead)
    return replace(log, channels=channels)


@cache
def whole_arm(
    late: tuple[float, float] = (0.0, 0.0),
    scale: tuple[float, float] = (1.0, 1.0),
    *,
    reported: bool = False,
    effort: float = 1.0,
) -> tuple[Study, Values, ArmModel]:
    """The study, its true values and the fit; `effort` goes to fits with effects."""
    study, true_values, logs = shaken()
    records = [read_so(log, late, scale) for log in logs]
    joints = joint_models(study, true_values, 0.05, FACTORS)
    delays: dict[Key, float] = {("accelerometer_delay", i): late[i - 1] for i in (1, 2)}
    start = delays if reported else None
    model = fit_whole_arm(
        records,
        rigid_model(study, true_values, 0.01, 1.0),
        joints,
        Arm.of(study.arm),
        WholeArmOptions(rival_effort=effort),
        start=start,
    )
    return study, true_values, model


def constants(model: ArmModel) -> set[Key]:
    return {(p.name, p.joint) for p in model.parameters if p.name.startswith("accelerometer")}


def test_a_clean_rig_has_no_sensor_constants() -> None:
    """Ideal sensors cost neither accuracy nor time."""
    _, _, model = whole_arm()
    assert constants(model) == set()
    assert not {c.code for c in model.warnings} & {"sensor-delay", "sensor-scale"}


@pytest.mark.parametrize(
    ("late", "scale", "reported"),
    [
        ((1e-3, 1e-3), (1.0, 1.0), False),
        ((-0.4e-3, 3e-3), (1.0, 1.0), True),
        ((0.0, 0.0), (1.03, 0.95), False),
        ((0.7e-3, 0.0), (0.96, 1.02), False),
    ],
)
def test_sensor_delays_and_scale_errors_are_corrected(
    late: tuple[float, float], scale: tuple[float, float], reported: bool
) -> None:
    _, true_values, model = whole_arm(late, scale, reported=reported)
    assert model.status == "converged"
    estimates = {(p.name, p.joint): p for p in model.parameters}
    wrong = {("accelerometer_delay", i): d for i, d in enumerate(late, 1) if d}
    wrong |= {("accelerometer_scale", i): s for i, s in enumerate(scale, 1) if s != 1.0}
    assert wrong.keys() <= constants(model)
    for (name, joint), true in (*wrong.items(), *true_values.items()):
        p = estimates.get((name, joint))
        if p is None or p.value is None or p.std is None or p.ci95 is None:
            continue
        assert abs(p.value - true) < 4.0 * p.std, (name, joint)
    for key in wrong:
        assert estimates[key].unit == ("s" if key[0].endswith("delay") else "1")
    # 0.1 % of the error that a delay of 1 ms would cause
    for i in (1, 2):
        damping = estimates["gear_damping", i].value
        assert damping == pytest.approx(true_values["gear_damping", i], rel=0.03)
    warned = {(c.code, c.where) for c in model.warnings}
    for name, joint in wrong:
        assert (f"sensor-{name.rsplit('_', 1)[1]}", f"joint {joint}") in warned


@pytest.mark.parametrize("early", [0.0, 1e-4])
def test_a_logged_torque_may_be_early(early: float) -> None:
    """A torque sampled after its time stamp contains part of the next command."""
    study, true_values, logs = shaken()
    arm, T = Arm.of(study.arm), logs[0].sample_time
    lag = 1.0 / (2.0 * np.pi * 1e3)
    new, remaining = 1.0 - np.exp(-early / lag), np.exp(-T / lag)
    records = []
    for log in logs:
        channels = dict(log.channels)
        for i in (1, 2):
            command = study.arm.joints[i - 1].torque_per_command * channels.pop(f"u{i}")
            torque = lfilter([1.0 - remaining], [1.0, -remaining], np.r_[0.0, command[:-1]])
            channels[f"torque{i}"] = torque + new * (command - torque)
        records.append(replace(log, channels=channels))
    joints = joint_models(study, true_values, 0.05, FACTORS)
    model = fit_whole_arm(records, rigid_model(study, true_values, 0.01, 1.0), joints, arm)
    estimates = {(p.name, p.joint): p for p in model.parameters}
    # the advance of the commands that would give these torques without the shift
    advance = new * T / (1.0 - remaining)
    delayed = {key for key in estimates if key[0] == "motor_encoder_delay"}
    assert delayed == ({("motor_encoder_delay", 1), ("motor_encoder_delay", 2)} if early else set())
    for key in delayed:
        assert estimates[key].value == pytest.approx(advance, rel=0.1)
        assert ("sensor-delay", f"joint {key[1]}") in {(c.code, c.where) for c in model.warnings}
    for i in (1, 2):
        for name in ("gear_damping", "motor_inertia"):
            value = true_values[name, i]
            assert estimates[name, i].value == pytest.approx(value, rel=0.02)


def test_held_constants_are_not_estimated() -> None:
    study, true_values, logs = shaken()
    records = [read_so(log, (1e-3, 1e-3), (1.0, 1.0)) for log in logs]
    joints = joint_models(study, true_values, 0.05, FACTORS)
    options = WholeArmOptions(hold=("accelerometer_delay 1",))
    model = fit_whole_arm(
        records, rigid_model(study, true_values, 0.01, 1.0), joints, Arm.of(study.arm), options
    )
    estimated = constants(model)
    assert ("accelerometer_delay", 1) not in estimated
    assert ("accelerometer_delay", 2) in estimated


def test_an_end_of_the_range_is_a_bound() -> None:
    # the scale is wrong beyond its range: fits with effects would look for another cause
    _, _, model = whole_arm((0.0, 0.0), (1.25, 1.0), effort=0.0)
    assert model.status == "at-bounds"
    assert "accelerometer_scale of joint 1" in {
        c.where for c in model.warnings if c.code == "at-bounds"
    }


def test_derivatives_are_those_of_the_difference() -> None:
    """Derivatives of simulated minus measured channels, on a noise-free record."""
    study, true_values, logs = shaken(noisy=False, counts=False)
    values = dict(true_values)
    late, scale = 0.6e-3, 1.03
    record = dataset_of(read_so(logs[0], (late, late), (scale, 1.0)), Arm.of(study.arm), CUTOFF)
    values |= {("accelerometer_delay", 1): late, ("accelerometer_delay", 2): late}
    values["accelerometer_scale", 1] = scale
    keys: list[Key] = [
        ("accelerometer_delay", 1),
        ("gear_stiffness", 1),
        ("accelerometer_scale", 1),
        ("accelerometer_delay", 2),
    ]

    def difference(changed: Values) -> np.ndarray:
        return record.linearise(changed, np.zeros(0), [])[0] - record.advance_measured(changed)

    _, tangent = record.linearise(values, np.zeros(0), keys)
    for k, key in enumerate(keys):
        h = {"gear_stiffness": 5.0}.get(key[0], 2e-5)
        ends = [difference({**values, key: values[key] + sign * h}) for sign in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / (2.0 * h)
        # the measured derivative differs by the integration error
        size = np.max(np.abs(slope))
        assert np.max(np.abs(tangent[..., k] - slope)[10:-10]) < 0.02 * size, key


RATES = {"prbs-j1": 1.2, "prbs-j2": -0.8}
"""Drift [m/s^3] of the accelerometer of joint 1; a few tenths of m/s^2 within a record."""


def drifting(rates: Mapping[str, float]) -> list[Log]:
    """Records of the rig with drift of the accelerometer of joint 1."""
    logs = []
    for log in shaken()[2]:
        a1 = log.channels["a1"] + rates.get(log.name, 0.0) * log.time
        logs.append(replace(log, channels={**log.channels, "a1": a1}))
    return logs


@cache
def tuned_drifting(*held: str) -> ArmModel:
    study, true_values, _ = shaken()
    joints = joint_models(study, true_values, 0.05, FACTORS)
    rigid, options = rigid_model(study, true_values, 0.01, 1.0), WholeArmOptions(hold=held)
    return fit_whole_arm(drifting(RATES), rigid, joints, Arm.of(study.arm), options)


def test_sensor_drifts_are_corrected() -> None:
    true_values, model = shaken()[1], tuned_drifting()
    assert model.status == "converged"
    wrong = {(of_record("accelerometer_drift", name), 1): r for name, r in RATES.items()}
    assert constants(model) == set(wrong)
    estimates = {(p.name, p.joint): p for p in model.parameters}
    for key, rate in wrong.items():
        p = estimates[key]
        assert p.value is not None
        assert p.std is not None
        assert p.unit == "m/s^3"
        assert p.value == pytest.approx(rate, rel=0.1)
        assert abs(p.value - rate) < 4.0 * p.std
    for name in ("motor_inertia", "motor_coulomb_friction", "gear_stiffness", "gear_damping"):
        for joint in (1, 2):
            assert model.values[name, joint] == pytest.approx(true_values[name, joint], rel=0.005)
    drift_warnings = [c for c in model.warnings if c.code == "sensor-drift"]
    assert [c.message.split()[1] for c in drift_warnings] == list(RATES)
    assert "the accelerometer drifts by 1.2" in drift_warnings[0].message


def test_neither_rounding_nor_little_gain_makes_a_drift_significant() -> None:
    study, true_values, _ = shaken()
    joints = joint_models(study, true_values, 0.0, FACTORS)
    rigid, options = rigid_model(study, true_values, 0.01, 1.0), WholeArmOptions()
    start = prepare_start(drifting(RATES), rigid, (joints,), Arm.of(study.arm), options, None)
    objective, z = start.coarse.objective, start.coarse.space.coordinates(true_values)
    fit = Fit.at(objective.update_weights(z), z)
    assert set(significant_drifts(fit, options, 0.0)) == {
        (of_record("accelerometer_drift", name), 1) for name in RATES
    }
    assert not significant_drifts(fit, options, np.inf)
    coarse = [replace(one, counts=(1.0,) * len(one.channels)) for one in objective.records]
    rounded = Fit.at(fit.objective.replace_records(coarse), z)
    assert not significant_drifts(rounded, options, 0.0)


@pytest.mark.parametrize(
    "held", ["accelerometer_drift", "accelerometer_drift 1", "accelerometer_drift[prbs-j1]"]
)
def test_drifts_that_are_held_are_not_estimated(held: str) -> None:
    key: Key = ("accelerometer_drift[prbs-j1]", 1)
    assert is_held(key, WholeArmOptions(hold=(held,)))
    assert not is_held(("accelerometer_drift[prbs-j1]", 2), WholeArmOptions(hold=(f"{held} 1",)))
    assert not is_held(("accelerometer_scale", 1), WholeArmOptions(hold=(held,)))


def test_derivatives_by_drifts_are_those_of_the_record_alone() -> None:
    study, true_values, logs = shaken(noisy=False, counts=False)
    record = dataset_of(logs[0], Arm.of(study.arm), CUTOFF)
    keys: list[Key] = [(of_record("accelerometer_drift", name), 1) for name in RATES]
    keys.append(("accelerometer_scale", 1))
    assert keys[0] in constants_of(record)
    assert keys[1] not in constants_of(record)
    values = {**true_values, keys[0]: 0.7, keys[1]: 9.0, keys[2]: 1.02}
    rows, tangent = record.linearise(values, np.zeros(0), keys)
    assert not tangent[..., 1].any()
    for k in (0, 2):
        more = record.linearise({**values, keys[k]: values[keys[k]] + 1.0}, np.zeros(0), [])[0]
        np.testing.assert_allclose(more - rows, tangent[..., k], atol=1e-9)
    (channel,) = np.flatnonzero(tangent[..., 0].any(axis=0))
    assert record.channels[channel].channel == "a1"
    slope = np.polyfit(record.time, tangent[:, channel, 0], 1)[0]
    assert slope == pytest.approx(1.0)


def test_an_insignificant_scale_is_removed() -> None:
    study, true_values, _ = shaken()
    joints = joint_models(study, true_values, 0.05, FACTORS)
    rigid = rigid_model(study, true_values, 0.01, 1.0)
    start: dict[Key, float] = {("accelerometer_scale", 1): 1.0}
    model = fit_whole_arm(shaken()[2], rigid, joints, Arm.of(study.arm), start=start)
    assert constants(model) == set()
