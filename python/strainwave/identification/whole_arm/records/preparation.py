"""Prepare logs as `Dataset` records for the comparison with simulated arms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from strainwave.domain import BoolArray, Imu, Log, channel_parts
from strainwave.domain.arm.link_sensors import SensorAxis, compared_axes
from strainwave.domain.arm.link_sensors.imu import ImuSensor
from strainwave.domain.arm.link_sensors.single_axis import MotorEncoder
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.identification.closed_loop import velocity_band
from strainwave.identification.whole_arm.records.dataset import (
    INITIAL_INTERVAL,
    Dataset,
    Kernels,
    low_pass_kernels,
    noise_behind,
)
from strainwave.signals.channels import unmeasured
from strainwave.signals.prepared_record import add_link_angles, prepare_record
from strainwave.signals.recorded_input import (
    driven_by_voltage,
    missing_motor_signal,
    missing_recorded_input,
    recorded_drive,
)

_STEP = 5e-4  # [s] integrator step; the step error is corrected
# encoder counts, or standard deviations of noise, within which a joint stands still
_STANDSTILL_TOLERANCE = 3.0
STEPS_PER_PERIOD = 8.0
"""Integrator steps per period of the cut-off if the step error is corrected or acceptable."""
_STEP_TOLERANCE_FACTOR = 1.0 + 1e-9  # tolerance of step comparisons, for rounding
_ACCELERATION_SPACING = 0.002  # [s] spacing of the second differences that estimate accelerations
# cut-off of the low-pass over the highest resonance; gear motion is negligible above it
_CUTOFF_TO_RESONANCE = 5.0
_MAX_CUTOFF_TO_SAMPLING_RATE = 0.1  # maximum cut-off of the low-pass over the sampling rate


def select_usable_records(logs: Sequence[Log], arm: Arm) -> list[Log]:
    """Select the records of the whole-arm fit: those that excite gears and can be simulated."""
    uses = ("frequency", "sweep", "tuning")
    return [
        log for log in logs if log.experiment.use in uses and not missing_motor_signal(arm, log)
    ]


def cutoff_of(logs: Sequence[Log], arm: Arm, highest_resonance_hz: float | None) -> float:
    """Cut-off [Hz] above the highest resonance, within the signal band of the motor velocities."""
    resonance_limit = _CUTOFF_TO_RESONANCE * (highest_resonance_hz or np.inf)
    sampling_limit = _MAX_CUTOFF_TO_SAMPLING_RATE / max(log.sample_time for log in logs)
    return min(resonance_limit, sampling_limit, *(velocity_band(log, arm) for log in logs))


def dataset_of(
    log: Log,
    arm: Arm,
    cutoff_hz: float,
    *,
    closed_loop: bool = False,
    resolutions: Mapping[str, float] | None = None,
) -> Dataset:
    """Prepare a log for the comparison with simulated arms.

    `cutoff_hz` is that of the low-pass. With `closed_loop`, the servo of the study drives servoed
    joints if the log has the required signals; otherwise the recorded voltages drive all joints.
    `resolutions` are those of channels whose sensor has none in the study, zero by default. Raises
    `InvalidInput` if the log lacks motor signals or is too short for the low-pass.
    """
    missing = missing_motor_signal(arm, log)
    if missing:
        raise InvalidInput(missing, where=log.name, remedy="log every motor's angle and voltage")
    log = add_link_angles(log, arm)
    T = log.sample_time
    kernels = low_pass_kernels(cutoff_hz, T)
    n_taps = len(kernels.smooth)
    if len(log) < 4 * n_taps:
        raise InvalidInput(
            f"lasts {len(log) * T:.3g} s, which a low-pass of {cutoff_hz:.3g} Hz leaves little of",
            where=log.name,
            remedy=f"record at least {4 * n_taps * T:.2g} s",
        )
    motors = (
        SensorAxis(MotorEncoder.of_joint(one), i) for i, one in enumerate(arm.joints, start=1)
    )
    links = (compared_axes(arm, i, log.channels) for i in range(1, arm.n_joints + 1))
    channels = (*motors, *chain.from_iterable(links))
    raw = [log.channels[channel.channel] for channel in channels]
    rows = [kernels.rows(x, slope=c.reads_angle) for x, c in zip(raw, channels, strict=True)]
    estimated = resolutions or {}
    counts = tuple(c.sensor.resolution or estimated.get(c.channel, 0.0) for c in channels)
    if closed_loop and missing_recorded_input(arm, log) is None:
        drive = recorded_drive(arm, log)
    else:
        drive = driven_by_voltage(arm, log)[1]
    half_length = 0.5 * (n_taps - 1) * T
    return Dataset(
        log=log,
        arm=_simulated_arm(log, arm),
        cutoff_hz=cutoff_hz,
        drive=drive,
        hold_change=prepare_record(log, arm).hold_change * np.logical_not(drive.servo),
        channels=channels,
        kernels=kernels,
        time=log.time[0] + half_length + kernels.step * T * np.arange(len(rows[0])),
        measured=np.column_stack(rows),
        noise=noise_behind(channels, raw, kernels, counts),
        counts=counts,
        begins_in_motion=_begins_in_motion(log, arm),
        max_time_step=_STEP,
        step_error_correction=np.zeros((len(rows[0]), len(channels))),
        is_counted=_unmasked_rows(log, channels, kernels),
    )


def coarsen_steps(record: Dataset, max_time_step: float) -> Dataset:
    """Lengthen the integrator step of a record for a coarse search.

    `max_time_step` [s] also limits the sampling rate: closer samples are decimated, and voltages
    are averaged. The row period stays approximately the same.
    """
    coarse = _decimate(record, max(1, int(max_time_step / record.log.sample_time)))
    return replace(coarse, max_time_step=max(max_time_step, _STEP))


def lengthen_steps(record: Dataset) -> Dataset:
    """Lengthen the integrator step as far as the band allows, with the same rows.

    Samples are decimated by a divisor of the samples per row. The low-pass of the simulated
    channels advances by the difference between the filter centres before and after decimation.
    """
    step, T = record.kernels.step, record.log.sample_time
    max_time_step = 1.0 / (STEPS_PER_PERIOD * record.cutoff_hz)
    divisors = (every for every in range(1, step + 1) if step % every == 0)
    every = max(
        each for each in divisors if each == 1 or each * T <= max_time_step * _STEP_TOLERANCE_FACTOR
    )
    if every == 1:
        return replace(record, max_time_step=max(max_time_step, record.max_time_step))
    coarse = _decimate(record, every)
    ahead = 0.5 * (1.0 - 1.0 / every)
    kernels = low_pass_kernels(record.cutoff_hz, every * T, ahead)
    return replace(coarse, kernels=kernels, max_time_step=max(max_time_step, record.max_time_step))


def _decimate(record: Dataset, every: int) -> Dataset:
    """Decimate a record by the factor `every`, with averaged voltages."""
    log = record.log
    n = len(log) // every
    channels = {
        name: x[: n * every].reshape(n, every).mean(axis=1)
        if channel_parts(name)[0] in ("u", "torque")
        else x[: n * every : every]
        for name, x in log.channels.items()
    }
    masked = {
        name: np.asarray(bad[: n * every].reshape(n, every).any(axis=1))
        for name, bad in log.masked.items()
    }
    thinned = replace(
        log,
        masked=masked,
        sample_time=every * log.sample_time,
        time=log.time[: n * every : every],
        channels=channels,
    )
    coarse = dataset_of(thinned, record.arm, record.cutoff_hz, closed_loop=any(record.drive.servo))
    voltage, change = (
        x[: n * every].reshape(n, every, -1).mean(axis=1)
        for x in (record.drive.voltage, record.hold_change)
    )
    return replace(
        coarse,
        drive=replace(coarse.drive, voltage=voltage),
        hold_change=change,
        noise=record.noise,
        counts=record.counts,
        begins_in_motion=record.begins_in_motion,
    )


def _unmasked_rows(log: Log, channels: Sequence[SensorAxis], kernels: Kernels) -> BoolArray | None:
    """Whether each row (n_rows, n_channels) is free of masked samples; None if all are."""
    masked = [unmeasured(log, (channel.channel,)) for channel in channels]
    if not any(bad.any() for bad in masked):
        return None
    n_taps, step = len(kernels.smooth), kernels.step
    masked_before = [np.r_[0, np.cumsum(bad)] for bad in masked]
    return np.column_stack([(b[n_taps:] - b[:-n_taps])[::step] == 0 for b in masked_before])


def _begins_in_motion(log: Log, arm: Arm) -> bool:
    """Whether any motor moves faster at first than it could from standstill.

    From standstill a motor moves at most a t^2 / 2, with a the largest acceleration of the record.
    """
    T = log.sample_time
    span = max(1, round(_ACCELERATION_SPACING / T))
    n_first = min(max(2, round(INITIAL_INTERVAL / T)), len(log) // 4)
    t = T * np.arange(n_first)
    noise = prepare_record(log, arm).angle_noise
    for i, joint in enumerate(arm.joints, start=1):
        angle = log.channels[f"theta_m{i}"]
        tolerance = _STANDSTILL_TOLERANCE * max(joint.encoder_resolution, noise[i - 1])
        second_difference = angle[2 * span :] - 2.0 * angle[span:-span] + angle[: -2 * span]
        max_acceleration = np.max(np.abs(second_difference)) / (span * T) ** 2
        if np.any(np.abs(angle[:n_first] - angle[0]) > tolerance + 0.5 * max_acceleration * t**2):
            return True
    return False


def _simulated_arm(log: Log, arm: Arm) -> Arm:
    """The arm for simulation: unquantised encoders, and the IMUs whose channels are logged."""
    joints = []
    for i, joint in enumerate(arm.joints, start=1):
        axes = compared_axes(arm, i, log.channels)
        has_imu = any(isinstance(axis.sensor, ImuSensor) for axis in axes)
        imu = (joint.imu or Imu()) if has_imu else None
        joints.append(replace(joint, encoder_counts=None, imu=imu))
    return arm.with_joints(joints)
