"""Log -> Drive: the recorded input of an experiment, for its simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, Log, Prbs
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, common_step
from strainwave.errors import InvalidInput


def recorded_drive(arm: Arm, log: Log) -> Drive:
    """Drive from logged references and open-loop voltages, and the PRBS of a servoed joint.

    The simulation starts at rest at the first sample, under the voltages of that sample. References
    that are not logged are zero. The tick is one sampling period.
    """
    experiment = log.experiment
    voltage = np.zeros((len(log), arm.n_joints))
    reference = np.zeros_like(voltage)
    recorded_voltage = driving_voltages(arm, log)
    for i in range(arm.n_joints):
        if experiment.control[i] == "open":
            voltage[:, i] = recorded_voltage[:, i]
        else:
            reference[:, i] = log.channels.get(f"ref{i + 1}", reference[:, i])
            if experiment.prbs and experiment.joint == i + 1:
                voltage[:, i] = _sample_prbs(experiment.prbs, log.sample_time, len(log))
    numbers = range(1, arm.n_joints + 1)
    servo_voltage = recorded_voltage[0] - voltage[0]
    return Drive(
        tick=log.sample_time,
        voltage=voltage,
        reference=reference,
        servo=tuple(control == "servo" for control in experiment.control),
        motor_angle=tuple(float(log.channels[f"theta_m{i}"][0]) for i in numbers),
        initial_voltage=tuple(float(v) for v in servo_voltage),
    )


def driven_by_voltage(arm: Arm, log: Log) -> tuple[Arm, Drive]:
    """Arm without encoder quantization and servo, driven by the recorded voltages.

    The voltages are held between samples.
    """
    joints = tuple(replace(joint, encoder_counts=None) for joint in arm.joints)
    voltage, recorded = driving_voltages(arm, log), recorded_drive(arm, log)
    initial_voltage = list(recorded.initial_voltage)
    for i, joint in enumerate(arm.joints):
        if input_channel(log, i + 1) == f"torque{i + 1}":  # the initial current-loop state
            torque = float(log.channels[f"torque{i + 1}"][0])
            initial_voltage[i] = torque / (joint.torque_per_volt or 1.0)
    open_loop = (False,) * arm.n_joints
    drive = replace(
        recorded, voltage=voltage, servo=open_loop, initial_voltage=tuple(initial_voltage)
    )
    return arm.with_joints(joints), drive


def missing_recorded_input(arm: Arm, log: Log) -> str | None:
    """Describe what a log lacks for a simulation with its servo; None if complete."""
    experiment = log.experiment
    if arm.servo is None and "servo" in experiment.control:
        return "the study has no [servo] table"
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
        if input_channel(log, i) is None:
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


def input_channel(log: Log, joint: int) -> str | None:
    """Name of the input channel of a joint (from 1): its voltage, otherwise its torque.

    Returns None if the log has neither.
    """
    return next((name for name in (f"u{joint}", f"torque{joint}") if name in log.channels), None)


def driving_voltages(arm: Arm, log: Log) -> FloatArray:
    """Voltages that drove the joints, (n_samples, n_joints) [V].

    A logged torque is the motor torque at the time stamps and is converted to the voltage command
    that produces it. With a current loop of bandwidth f, and a = exp(-2 pi f T), u_k = (tau_(k+1) -
    a tau_k) / (1 - a) in torque units. Without one, the held value is the mean of both torques. The
    unit is N m if the joint has no torque per volt. The log must have an input of every joint.
    """
    columns = []
    for i, joint in enumerate(arm.joints, start=1):
        name = input_channel(log, i) or f"u{i}"
        torque_per_volt = joint.torque_per_volt or 1.0
        values = log.channels[name]
        if name != f"u{i}":
            values = (
                _command_from_torque(values, joint.current_loop_hz, log.sample_time)
                / torque_per_volt
            )
        columns.append(values)
    return np.column_stack(columns)


def _command_from_torque(
    torque: FloatArray, loop_hz: float | None, sample_time: float
) -> FloatArray:
    """Held command between samples that produces the motor torque at the samples."""
    following = np.append(torque[1:], torque[-1])
    if loop_hz is None:
        return np.asarray(0.5 * (torque + following))
    decay = np.exp(-2.0 * np.pi * loop_hz * sample_time)
    return np.asarray((following - decay * torque) / (1.0 - decay))


def _sample_prbs(prbs: Prbs, sample_time: float, samples: int) -> FloatArray:
    """PRBS voltage at each sample, held over its clock."""
    sequence = excitation.prbs(prbs)
    clock_index = np.floor(np.arange(samples) * sample_time / prbs.clock + 1e-9).astype(int)
    held: FloatArray = sequence[clock_index % len(sequence)]
    return held
