"""Prediction of records by the rigid model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import FloatArray, RigidModel, Signals, Study
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import fit_percent, standing
from strainwave.errors import NotIdentifiable
from strainwave.identification import rigid, validation
from virtual_arms import exact_motion, exact_signals, rigid_drive

INERTIA, VISCOUS, COULOMB, OFFSET = 0.02, 0.05, 0.3, -0.04


def torque_of(motion: tuple[FloatArray, ...], sign: FloatArray) -> FloatArray:
    _, _, velocity, acceleration = motion
    return INERTIA * acceleration + VISCOUS * velocity + COULOMB * sign + OFFSET


def fitted() -> tuple[Study, RigidModel, Signals]:
    study = rigid_drive()
    motion = exact_motion(1, 0)
    exact = exact_signals(motion, torque_of(motion, np.sign(motion[2])))
    return study, rigid.fit_rigid([exact], Arm.of(study.arm)), exact


def test_fit_percent_is_the_contracts() -> None:
    y = np.array([[1.0], [2.0], [3.0], [6.0]])
    assert fit_percent(y, y) == pytest.approx([100.0])
    assert fit_percent(y, np.full_like(y, 3.0)) == pytest.approx([0.0])
    assert fit_percent(y, y - 1.0) == pytest.approx([100.0 * (1.0 - 2.0 / np.sqrt(14.0))])
    assert np.isnan(fit_percent(np.ones((3, 1)), y[:3])).all()


def test_an_exact_model_predicts_another_record_exactly() -> None:
    study, model, _ = fitted()
    motion = exact_motion(1, 7)
    exact = exact_signals(motion, torque_of(motion, np.sign(motion[2])))
    prediction = validation.predict_rigid(model, exact, Arm.of(study.arm))
    assert prediction.channels == ("torque1",)
    assert prediction.fit_percent["torque1"] == pytest.approx(100.0, abs=1e-6)
    assert prediction.measured.shape == prediction.predicted.shape == (len(prediction.time), 1)


def test_the_fit_is_that_of_the_arrays_it_comes_with() -> None:
    study, model, exact = fitted()
    noise = np.random.default_rng(0).normal(0.0, 0.1, exact.motor_torque.shape)
    noisy = replace(exact, motor_torque=exact.motor_torque + noise)
    prediction = validation.predict_rigid(model, noisy, Arm.of(study.arm))
    expected = fit_percent(prediction.measured, prediction.predicted)
    assert prediction.fit_percent["torque1"] == pytest.approx(expected[0])


def test_a_record_of_another_load_is_not_predicted() -> None:
    """Inertia 50 % higher than in the fitted record, whose errors are the reference."""
    study, model, exact = fitted()
    arm = Arm.of(study.arm)
    reference = validation.predict_rigid(model, exact, arm)
    motion = exact_motion(1, 7)
    unloaded = torque_of(motion, np.sign(motion[2]))
    unchanged = validation.predict_rigid(model, exact_signals(motion, unloaded), arm, (reference,))
    assert unchanged.unexplained == {}
    heavier = unloaded + 0.5 * INERTIA * motion[3]
    changed = validation.predict_rigid(model, exact_signals(motion, heavier), arm, (reference,))
    assert changed.unexplained["torque1"] > validation.MAX_UNEXPLAINED_STDS
    # 5 % more friction is not a change of the arm
    warm = unloaded + 0.05 * COULOMB * np.sign(motion[2])
    assert not validation.predict_rigid(
        model, exact_signals(motion, warm), arm, (reference,)
    ).unexplained
    # errors as large in the fitted record are not reported
    noisy = replace(reference, predicted=0.5 * reference.predicted)
    unchanged = validation.predict_rigid(model, exact_signals(motion, heavier), arm, (noisy,))
    assert unchanged.unexplained == {}


def test_logged_voltages_are_predicted_in_volts() -> None:
    study, model, exact = fitted()
    drive = replace(
        study, arm=replace(study.arm, joints=(replace(study.arm.joints[0], torque_per_volt=0.1),))
    )
    volts = replace(exact, torque_channel=("u1",))
    in_volts = validation.predict_rigid(model, volts, Arm.of(drive.arm))
    in_torque = validation.predict_rigid(model, exact, Arm.of(study.arm))
    assert in_volts.channels == ("u1",)
    assert in_volts.predicted == pytest.approx(10.0 * in_torque.predicted)


def test_a_standing_motor_takes_any_torque_within_its_friction() -> None:
    study, model, _ = fitted()
    time, angle, velocity, acceleration = exact_motion(1, 5)
    standstill = slice(4000, 7000)
    for signal in (velocity, acceleration):
        signal[standstill] = 0.0
    direction = np.sign(velocity)
    torque = torque_of((time, angle, velocity, acceleration), direction)
    torque[standstill, 0] = OFFSET + COULOMB * np.sin(2.0 * time[standstill])
    record = exact_signals((time, angle, velocity, acceleration), torque, direction)
    assert validation.predict_rigid(model, record, Arm.of(study.arm)).fit_percent["torque1"] > 99.0
    torque[standstill, 0] = OFFSET + 6.0 * COULOMB  # more than friction can balance
    impossible = exact_signals((time, angle, velocity, acceleration), torque, direction)
    assert (
        validation.predict_rigid(model, impossible, Arm.of(study.arm)).fit_percent["torque1"] < 90.0
    )


def test_a_motor_that_mostly_stands_gets_no_fit() -> None:
    study, model, exact = fitted()
    still = replace(exact, direction=np.zeros_like(exact.direction))
    assert np.isnan(
        validation.predict_rigid(model, still, Arm.of(study.arm)).fit_percent["torque1"]
    )


def test_short_stretches_are_reversals_and_long_ones_standing() -> None:
    direction = np.array([1, 1, 0, -1, -1, 0, 0, 0, 1.0])[:, None]
    assert np.flatnonzero(standing(direction, 2)).tolist() == [5, 6, 7]


def test_an_unidentified_model_is_refused() -> None:
    study, model, exact = fitted()
    with pytest.raises(NotIdentifiable):
        validation.predict_rigid(
            replace(model, status="not-identifiable"), exact, Arm.of(study.arm)
        )


def test_a_record_shorter_than_the_low_pass_is_refused() -> None:
    study, model, exact = fitted()
    duration = len(exact.time) * exact.sample_time
    slow = replace(model, bandwidth_hz=2.0 / duration)
    with pytest.raises(NotIdentifiable, match="too short to be predicted"):
        validation.predict_rigid(slow, exact, Arm.of(study.arm))
    long_enough = validation.predict_rigid(
        replace(model, bandwidth_hz=3.0 / duration), exact, Arm.of(study.arm)
    )
    assert len(long_enough.time) > 0
