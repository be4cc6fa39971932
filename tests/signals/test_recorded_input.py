"""Drives from recorded inputs, and closed-loop predictions compared with the records."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import Control, Log, Prbs
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.identification.closed_loop import observe, predict_closed_loop, restrict_to_values
from strainwave.signals.recorded_input import (
    check_servo_clock,
    missing_recorded_input,
    recorded_drive,
)
from tuning_runs import rig_logs, truth


def log_named(name: str) -> Log:
    return next(log for log in rig_logs()[1] if log.name == name)


def test_a_servo_log_is_driven_by_its_references() -> None:
    study, _ = rig_logs()
    log = log_named("step-j1")
    drive = recorded_drive(Arm.of(study.arm), log)
    assert drive.servo == (True, True)
    assert drive.tick == log.sample_time
    np.testing.assert_array_equal(drive.reference[:, 0], log.channels["ref1"])
    np.testing.assert_array_equal(drive.voltage, 0.0)
    assert drive.motor_angle == (log.channels["theta_m1"][0], log.channels["theta_m2"][0])
    assert drive.initial_voltage == (log.channels["u1"][0], log.channels["u2"][0])


def test_drives_use_open_loop_voltages_and_the_prbs_of_servo_joints() -> None:
    study, _ = rig_logs()
    log = log_named("step-j1")
    open_servo: tuple[Control, Control] = ("open", "servo")
    opened = replace(log, experiment=replace(log.experiment, control=open_servo))
    drive = recorded_drive(Arm.of(study.arm), opened)
    np.testing.assert_array_equal(drive.voltage[:, 0], log.channels["u1"])
    # The voltage of the first sample starts with the record; the voltage before it is zero.
    assert drive.initial_voltage[0] == 0.0
    prbs = Prbs(order=4, clock=1e-3, periods=2, amplitude=5.0)
    excited = replace(log, experiment=replace(log.experiment, prbs=prbs))
    assert set(np.unique(recorded_drive(Arm.of(study.arm), excited).voltage[:, 0])) == {-5.0, 5.0}


def test_the_error_states_the_missing_recorded_input() -> None:
    """The error message names the missing servo or channel."""
    study, _ = rig_logs()
    log = log_named("step-j1")
    assert missing_recorded_input(Arm.of(study.arm), log) is None
    assert (
        missing_recorded_input(Arm.of(replace(study, arm=replace(study.arm, servo=None)).arm), log)
        == "the study has no [servo] table"
    )
    for channel, pattern in [
        ("ref1", "reference ref1"),
        ("u2", "torque2 nor u2"),
        ("theta_m1", "theta_m1"),
    ]:
        channels = {name: signal for name, signal in log.channels.items() if name != channel}
        with pytest.raises(InvalidInput, match=pattern):
            observe(replace(log, channels=channels), Arm.of(study.arm))
    # Joint 2 follows no reference in this record.
    channels = {name: signal for name, signal in log.channels.items() if name != "ref2"}
    assert missing_recorded_input(Arm.of(study.arm), replace(log, channels=channels)) is None


@pytest.mark.parametrize(
    ("factor", "refused"), [(1.0, False), (2.0, False), (1.006, True), (0.9873, True)]
)
def test_sampling_and_servo_periods_without_a_common_step_are_refused(
    factor: float, refused: bool
) -> None:
    study, _ = rig_logs()
    log = log_named("step-j1")
    late = replace(log, time=factor * log.time, sample_time=factor * log.sample_time)
    with pytest.raises(InvalidInput, match="period in") if refused else nullcontext():
        check_servo_clock(Arm.of(study.arm), late)


@pytest.mark.parametrize("name", ["step-check-j1", "step-check-j2", "motion-check"])
def test_the_true_arm_predicts_its_own_records(name: str) -> None:
    study, _ = rig_logs()
    prediction = predict_closed_loop(truth()[1], log_named(name), Arm.of(study.arm))
    assert prediction.channels == ("omega_m1", "omega_m2", "a1", "a2")
    # The residual consists of encoder quantization and accelerometer noise.
    assert min(prediction.fit_percent.values()) > 97.0
    assert prediction.measured.shape == prediction.predicted.shape
    assert len(prediction.time) == len(prediction.measured)
    bias = prediction.measured.mean(axis=0) - prediction.predicted.mean(axis=0)
    assert bias[2:] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_an_open_loop_record_is_predicted() -> None:
    study, _ = rig_logs()
    log = log_named("step-j1")
    control: tuple[Control, Control] = ("open", "servo")
    opened = replace(log, experiment=replace(log.experiment, control=control))
    assert predict_closed_loop(truth()[1], opened, Arm.of(study.arm)).fit_percent["omega_m1"] > 95.0


def test_a_motor_at_standstill_has_no_fit_percentage() -> None:
    """The fit percentage of a motor at standstill is NaN."""
    study, _ = rig_logs()
    log = log_named("step-j1")
    channels = {**log.channels, "theta_m2": np.zeros(len(log))}
    prediction = predict_closed_loop(truth()[1], replace(log, channels=channels), Arm.of(study.arm))
    assert np.isnan(prediction.fit_percent["omega_m2"])
    assert np.isfinite(prediction.fit_percent["omega_m1"])


def test_the_cutoff_follows_from_the_record_or_the_option() -> None:
    study, _ = rig_logs()
    log = log_named("step-j1")
    assert observe(log, Arm.of(study.arm), 40.0).cutoff_hz == 40.0
    # Above the gear resonance at 26 Hz, below the frequencies dominated by quantization.
    assert 40.0 < observe(log, Arm.of(study.arm)).cutoff_hz < 400.0


def test_one_stiffness_makes_a_three_slope_spring_linear() -> None:
    study, values = truth("three-slope")
    arm = Arm.of(study.arm)
    springs = [joint.spring for joint in restrict_to_values(arm, values).joints]
    assert springs == ["three-slope", "three-slope"]
    linear_values = {key: value for key, value in values.items() if not key[0].startswith("gear_")}
    assert [joint.spring for joint in restrict_to_values(arm, linear_values).joints] == [
        "linear",
        "linear",
    ]
