"""Log -> Signals: motor torque, angle and its derivatives through one zero-phase filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import Log, Signals
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.signals.channels import check_length, unmeasured
from strainwave.signals.prepared_record import prepare_record


@dataclass(frozen=True, slots=True)
class SignalOptions:
    """Options of the motor-side signals."""

    bandwidth_hz: float | None = None  # of the filter; None: determined from the encoder noise


def prepare_motor_signals(log: Log, arm: Arm, options: SignalOptions | None = None) -> Signals:
    """Compute motor torque, angle, velocity and acceleration of one record.

    The default bandwidth is the smallest signal band of the joints that move, above which encoder
    noise dominates. It exceeds the range of a rigid model, and `rigid.fit_rigid` reduces it.

    Raises InvalidInput if a motor angle or torque is missing, or if the record is too short for the
    filter.
    """
    chosen, record = options or SignalOptions(), prepare_record(log, arm)
    T, angle = log.sample_time, record.motor_angle
    moves = record.sliding.any(axis=0)
    bands = np.array(record.bands_hz)
    bandwidth = chosen.bandwidth_hz or float(bands[moves if moves.any() else slice(None)].min())
    edge = int(np.ceil(1.0 / (bandwidth * T)))
    check_length(log, edge, bandwidth)
    smooth_angle = low_pass(angle, bandwidth, T)
    velocity = differentiate(smooth_angle, T)
    angle_invalid = unmeasured(log, (f"theta_m{i + 1}" for i in range(arm.n_joints)))
    torque_invalid = np.column_stack([unmeasured(log, (name,)) for name in record.channels])
    valid = ~(record.saturation.samples | torque_invalid | angle_invalid[:, None])
    valid[:edge] = valid[-edge:] = False
    return Signals(
        experiment=log.experiment,
        time=log.time,
        sample_time=T,
        motor_torque=low_pass(record.torque, bandwidth, T),
        motor_angle=smooth_angle,
        motor_velocity=velocity,
        motor_acceleration=differentiate(velocity, T),
        direction=record.sliding,
        bandwidth_hz=bandwidth,
        angle_noise=record.angle_noise,
        valid=valid,
        torque_channel=record.channels,
        warnings=record.saturation.warnings,
    )
