"""Log -> Drive: what an experiment applied, so that a model can go through it again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, Log, Prbs
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, common_step
from strainwave.errors import InvalidInput


def recorded_drive(arm: Arm, log: Log) -> Drive:
    """The log's own references and open-loop voltages; a servoed joint's PRBS from its numbers.

    The arm starts at standstill where the log does, under the voltages of its first sample. A
    reference that was not logged is zero.

    Parameters
    ----------
    arm : Arm
    log : Log

    Returns
    -------
    Drive
        One tick a sample.
    """
    experiment = log.experiment
    voltage = np.zeros((len(log), arm.n_joints))
    reference = np.zeros_like(voltage)
    applied = driving_voltages(arm, log)
    for i in range(arm.n_joints):
        if experiment.control[i] == "open":
            voltage[:, i] = applied[:, i]
        else:
            reference[:, i] = log.channels.get(f"ref{i + 1}", reference[:, i])
            if experiment.prbs and experiment.joint == i + 1:
                voltage[:, i] = _held(experiment.prbs, log.sample_time, len(log))
    numbers = range(1, arm.n_joints + 1)
    before = applied[0] - voltage[0]
    return Drive(
        tick=log.sample_time,
        voltage=voltage,
        reference=reference,
        servo=tuple(control == "servo" for control in experiment.control),
        motor_angle=tuple(float(log.channels[f"theta_m{i}"][0]) for i in numbers),
        initial_voltage=tuple(float(v) for v in before),
    )


def driven_by_voltage(arm: Arm, log: Log) -> tuple[Arm, Drive]:
    """An arm under the recorded voltages, held from sample to sample, in place of any servo.

    Parameters
    ----------
    arm : Arm
    log : Log

    Returns
    -------
    arm : Arm
        Its encoders without counts.
    drive : Drive
    """
    joints = tuple(replace(joint, encoder_counts=None) for joint in arm.joints)
    voltage, recorded = driving_voltages(arm, log), recorded_drive(arm, log)
    before = list(recorded.initial_voltage)
    for i, joint in enumerate(arm.joints):
        if input_channel(log, i + 1) == f"torque{i + 1}":  # which the current loop begins with
            torque = float(log.channels[f"torque{i + 1}"][0])
            before[i] = torque / (joint.torque_per_volt or 1.0)
    free = (False,) * arm.n_joints
    drive = replace(recorded, voltage=voltage, servo=free, initial_voltage=tuple(before))
    return arm.with_joints(joints), drive


def missing_recorded_input(arm: Arm, log: Log) -> str | None:
    """What a log lacks to be gone through again, if anything.

    Parameters
    ----------
    arm : Arm
    log : Log

    Returns
    -------
    str or None
        A clause that says what is missing.
    """
    experiment = log.experiment
    if arm.servo is None and "servo" in experiment.control:
        return "the study describes no servo"
    silent = missing_motor_signal(arm, log)
    if silent:
        return silent
    for i, control in enumerate(experiment.control, start=1):
        moved = experiment.joint in (None, i) and experiment.prbs is None
        if control == "servo" and moved and f"ref{i}" not in log.channels:
            return f"the servo's reference ref{i} is not there"
    return None


def missing_motor_signal(arm: Arm, log: Log) -> str | None:
    """Which motor's angle or input a log lacks, if any.

    Parameters
    ----------
    arm : Arm
    log : Log

    Returns
    -------
    str or None
        A clause that says what is missing.
    """
    for i in range(1, arm.n_joints + 1):
        if input_channel(log, i) is None:
            return f"neither torque{i} nor u{i} is there"
        if f"theta_m{i}" not in log.channels:
            return f"theta_m{i} is not there"
    return None


def check_recorded_input(arm: Arm, log: Log) -> None:
    """Refuse a log that cannot be gone through again.

    Parameters
    ----------
    arm : Arm
    log : Log

    Raises
    ------
    InvalidInput
        A channel or the servo is missing.
    """
    missing = missing_recorded_input(arm, log)
    if missing:
        raise InvalidInput(
            missing,
            where=log.name,
            remedy="give the study a [servo] table, and the log the references of servoed joints",
        )


def check_servo_clock(arm: Arm, log: Log) -> None:
    """Refuse a log that its servo cannot be simulated for: its stamps share no step with the servo.

    Parameters
    ----------
    arm : Arm
    log : Log

    Raises
    ------
    InvalidInput
        The stamps are off, or the servo's period.
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
            f"its samples lie {T:g} s apart, which has no step in common with the servo's period "
            f"of {period:g} s, so that its servo cannot be simulated",
            where=log.name,
            remedy="mend the stamps, or period in [servo], whichever is off",
        ) from error


def input_channel(log: Log, joint: int) -> str | None:
    """The channel that drives a joint: its voltage, or its torque where no voltage was logged.

    Parameters
    ----------
    log : Log
    joint : int
        From 1.

    Returns
    -------
    str or None
    """
    return next((name for name in (f"u{joint}", f"torque{joint}") if name in log.channels), None)


def driving_voltages(arm: Arm, log: Log) -> FloatArray:
    """The voltages that drove the joints; of a logged torque the one that commands it.

    A logged torque is what the motor has at the stamps. Where the current loop is known, with a =
    exp(-2 pi f T), u_k = (tau_(k+1) - a tau_k) / (1 - a) makes it that again; without, what is held
    from stamp to stamp is the mean of both.

    Parameters
    ----------
    arm : Arm
    log : Log
        With an input of every joint.

    Returns
    -------
    (n_samples, n_joints) [V], or [N m] where the study has no torque per volt
    """
    columns = []
    for i, joint in enumerate(arm.joints, start=1):
        name = input_channel(log, i) or f"u{i}"
        torque_per_volt = joint.torque_per_volt or 1.0
        values = log.channels[name]
        if name != f"u{i}":
            values = _commanded(values, joint.current_loop_hz, log.sample_time) / torque_per_volt
        columns.append(values)
    return np.column_stack(columns)


def _commanded(torque: FloatArray, loop_hz: float | None, sample_time: float) -> FloatArray:
    """What, held from sample to sample, makes a torque that the motor has at the samples."""
    following = np.append(torque[1:], torque[-1])
    if loop_hz is None:
        return np.asarray(0.5 * (torque + following))
    left = np.exp(-2.0 * np.pi * loop_hz * sample_time)
    return np.asarray((following - left * torque) / (1.0 - left))


def _held(prbs: Prbs, sample_time: float, samples: int) -> FloatArray:
    sequence = excitation.prbs(prbs)
    at = np.floor(np.arange(samples) * sample_time / prbs.clock + 1e-9).astype(int)
    held: FloatArray = sequence[at % len(sequence)]
    return held
