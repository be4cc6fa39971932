"""Log -> Signals: motor torque, angle and its derivatives through one zero-phase filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray, Joint, Lag, Log, Signals
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.numerics.filters import (
    apply_lags,
    differentiate,
    low_pass,
    noise_std,
    signal_band,
)
from strainwave.signals.channels import (
    channel_of,
    directions,
    saturation,
    torque_channel,
    unmeasured,
)


@dataclass(frozen=True, slots=True)
class SignalOptions:
    """Options of the motor-side signals."""

    bandwidth_hz: float | None = None  # of the filter; None: determined from the encoder noise


def prepare_motor_signals(log: Log, arm: Arm, options: SignalOptions | None = None) -> Signals:
    """Compute motor torque, angle, velocity and acceleration of one record.

    The default bandwidth is the smallest signal band of all joints, above which encoder noise
    dominates. It exceeds the range of a rigid model, and `rigid.fit` reduces it.

    Raises InvalidInput if a motor angle or torque is missing, or if the record is too short for the
    filter.
    """
    chosen = options or SignalOptions()
    T = log.sample_time
    numbers = range(1, arm.n_joints + 1)
    angle = np.column_stack([channel_of(log, f"theta_m{i}") for i in numbers])
    sources = tuple(torque_channel(log, i) for i in numbers)
    torque = np.column_stack(
        [_torque(log, joint, c) for joint, c in zip(arm.joints, sources, strict=True)]
    )
    bandwidth = chosen.bandwidth_hz or min(signal_band(angle[:, i - 1], T) for i in numbers)
    edge = int(np.ceil(1.0 / (bandwidth * T)))
    if len(log) < 4 * edge + 16:
        raise InvalidInput(
            f"{len(log)} samples are too few for a filter of {bandwidth:.3g} Hz",
            where=log.name,
            remedy="record a longer motion",
        )
    smooth_angle = low_pass(angle, bandwidth, T)
    velocity = differentiate(smooth_angle, T)
    noise = np.array([noise_std(angle[:, i - 1]) for i in numbers])
    saturated, warnings = saturation(log, arm, sources)
    angle_invalid = unmeasured(log, (f"theta_m{i}" for i in numbers))
    torque_invalid = np.column_stack([unmeasured(log, (source,)) for source in sources])
    valid = ~(saturated | torque_invalid | angle_invalid[:, None])
    valid[:edge] = valid[-edge:] = False
    return Signals(
        experiment=log.experiment,
        time=log.time,
        sample_time=T,
        motor_torque=low_pass(torque, bandwidth, T),
        motor_angle=smooth_angle,
        motor_velocity=velocity,
        motor_acceleration=differentiate(velocity, T),
        direction=directions(angle, noise, arm, T),
        bandwidth_hz=bandwidth,
        angle_noise=noise,
        valid=valid,
        unfiltered_torque=torque,
        torque_channel=sources,
        warnings=warnings,
    )


def drive_torque(voltage: FloatArray, joint: Joint, sample_time: float) -> FloatArray:
    """Motor torque [N m] at the time stamps, (n_samples,), from the voltage commands [V].

    The drive holds each voltage until the next time stamp. The mean over one sampling period
    centred on a time stamp is the mean of the voltages before and after it, which is a delay of
    half a sample. The current loop is a first-order lag,

        tau_c dx/dt = e u - x,    tau_c = 1 / (2 pi current_loop_hz),

    solved exactly for an input that is linear between time stamps. e is `torque_per_volt` [N m/V];
    without `current_loop_hz` the lag is omitted. Raises InvalidInput if the joint has no
    `torque_per_volt`.
    """
    if joint.torque_per_volt is None:
        raise InvalidInput(
            "a voltage is logged but torque_per_volt is not given",
            remedy="add torque_per_volt to the joint, or log the torque",
        )
    commanded = joint.torque_per_volt * 0.5 * (voltage + np.r_[voltage[:1], voltage[:-1]])
    if joint.current_loop_hz is None:
        return np.asarray(commanded)
    return apply_lags(commanded, [Lag(1, joint.current_loop_hz)], sample_time)


def _torque(log: Log, joint: Joint, channel: str) -> FloatArray:
    """Motor torque from a torque channel, or from a voltage channel through the drive."""
    if channel.startswith("torque"):
        return log.channels[channel]
    return drive_torque(log.channels[channel], joint, log.sample_time)
