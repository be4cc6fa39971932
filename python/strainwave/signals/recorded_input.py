"""Log -> Drive: the recorded input of an experiment, for its simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, Log
from strainwave.domain.arm.link_sensors.interface import TORQUE_HOLD
from strainwave.domain.keys import Key
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, common_step
from strainwave.errors import InvalidInput
from strainwave.signals.channels import MotorInput
from strainwave.signals.prepared_record import prepare_record


def recorded_drive(arm: Arm, log: Log) -> Drive:
    """Drive from logged references and open-loop voltages, and the PRBS of a servoed joint.

    The simulation starts at rest at the first sample, under the voltages of that sample. References
    that are not logged are zero. The tick is one sampling period.
    """
    experiment = log.experiment
    voltage = np.zeros((len(log), arm.n_joints))
    reference = np.zeros_like(voltage)
    record = prepare_record(log, arm)
    for i in range(arm.n_joints):
        if experiment.control[i] == "open":
            voltage[:, i] = record.voltage[:, i]
        else:
            reference[:, i] = log.channels.get(f"ref{i + 1}", reference[:, i])
            if experiment.prbs and experiment.joint == i + 1 and not log.is_continuation:
                sequence = excitation.prbs(experiment.prbs)
                time = np.arange(len(log)) * log.sample_time
                clock_index = np.floor(time / experiment.prbs.clock + 1e-9).astype(int)
                voltage[:, i] = sequence[clock_index % len(sequence)]
    servo_voltage = record.voltage[0] - voltage[0]
    return Drive(
        tick=log.sample_time,
        voltage=voltage,
        reference=reference,
        servo=tuple(control == "servo" for control in experiment.control),
        motor_angle=tuple(record.motor_angle[0].tolist()),
        initial_voltage=tuple(servo_voltage.tolist()),
    )


def driven_by_voltage(arm: Arm, log: Log) -> tuple[Arm, Drive]:
    """Arm without encoder quantization and servo, driven by the recorded voltages.

    The voltages are held between samples.
    """
    joints = tuple(replace(joint, encoder_counts=None) for joint in arm.joints)
    record, recorded = prepare_record(log, arm), recorded_drive(arm, log)
    initial_voltage = list(recorded.initial_voltage)
    for i, motor in enumerate(record.driving_inputs):
        if not motor.is_voltage:  # the initial current-loop state
            initial_voltage[i] = float(motor.values[0] / arm.torque_per_volt[i])
    open_loop = (False,) * arm.n_joints
    drive = replace(
        recorded, voltage=record.voltage, servo=open_loop, initial_voltage=tuple(initial_voltage)
    )
    return arm.with_joints(joints), drive


def hold_torques(drive: Drive, change: FloatArray, values: Mapping[Key, float]) -> Drive:
    """Drive with the torque holds of `values`, (S32).

    `change` (n_ticks, n_joints) is that of the voltage for a hold of one.
    """
    holds = [values.get((TORQUE_HOLD, i), 0.0) for i in range(1, change.shape[1] + 1)]
    return replace(drive, voltage=drive.voltage + holds * change) if any(holds) else drive


def missing_recorded_input(arm: Arm, log: Log) -> str | None:
    """Describe what a log lacks for a simulation with its servo; None if complete."""
    experiment = log.experiment
    if arm.servo is None and "servo" in experiment.control:
        return "the study has no [servo] table"
    if log.is_continuation and "servo" in experiment.control:
        return "the segment begins after a pause, with an unknown state of the servo"
    missing_signal = missing_motor_signal(arm, log)
    if missing_signal:
        return missing_signal
    for i, control in enumerate(experiment.control, start=1):
        follows_reference = experiment.joint in (None, i) and experiment.prbs is None
        if control == "servo" and follows_reference and f"ref{i}" not in log.channels:
            return f"the log has no servo reference ref{i}"
    return None


def missing_motor_signal(arm: Arm, log: Log) -> str | None:
    """Describe the first motor angle or motor input that a log lacks; None if complete."""
    for i in range(1, arm.n_joints + 1):
        if MotorInput.of(log, i, ("u", "torque")) is None:
            return f"the log has neither torque{i} nor u{i}"
        if f"theta_m{i}" not in log.channels:
            return f"the log has no channel theta_m{i}"
    return None


def check_recorded_input(arm: Arm, log: Log) -> None:
    """Raise InvalidInput if a channel or the servo for a simulation of this log is missing."""
    missing = missing_recorded_input(arm, log)
    if missing:
        raise InvalidInput(
            missing,
            where=log.name,
            remedy="add a [servo] table to the study, and log the references of servoed joints",
        )


def check_servo_clock(arm: Arm, log: Log) -> None:
    """Check that the sampling period and the servo period have a common time step.

    Raises InvalidInput otherwise, because the servo cannot be simulated for this log.
    """
    if arm.servo is None or missing_recorded_input(arm, log):
        return
    if "servo" not in log.experiment.control:
        return
    T, period = log.sample_time, arm.servo.period
    try:
        common_step([T, period])
    except InvalidInput as error:
        raise InvalidInput(
            f"the sampling period of {T:g} s and the servo period of {period:g} s have no common "
            "time step, so the servo cannot be simulated",
            where=log.name,
            remedy="correct the time stamps of the log, or period in [servo]",
        ) from error
