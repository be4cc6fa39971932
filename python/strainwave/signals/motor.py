"""Log -> Signals: motor torque, angle and its derivatives through one zero-phase filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, Log, Signals
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import MAX_STICTION_SHARE
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.signals.channels import check_length, unmeasured
from strainwave.signals.prepared_record import add_link_angles, prepare_record

# Share of a motor's largest travel in any record below which it stands: the travel is a deflection
# of gear and bearings before they slide, even if the encoder resolves it.
_MIN_TRAVEL_SHARE = 0.01
# largest mean torsion [rad, m] of a gear; a larger one is a difference of the encoders' zeros
_MAX_TORSION = 0.01


@dataclass(frozen=True, slots=True)
class SignalOptions:
    """Options of the motor-side signals."""

    bandwidth_hz: float | None = None  # of the filter; None: determined from the encoder noise
    with_torsion: bool = False  # of the gears, if sensors on both sides of each elastic one show it


def prepare_motor_signals(log: Log, arm: Arm, options: SignalOptions | None = None) -> Signals:
    """Compute motor torque, angle, velocity and acceleration of one record.

    The default bandwidth is the smallest signal band of the joints that move, above which encoder
    noise dominates. It exceeds the range of a rigid model, and `rigid.fit_rigid` reduces it.
    Samples that were interpolated over less than an eighth of its period are valid.

    Raises InvalidInput if a motor angle or torque is missing, or if the record is too short for the
    filter.
    """
    chosen, record = options or SignalOptions(), prepare_record(log, arm)
    T, angle = log.sample_time, record.motor_angle
    moves = (record.sliding == 0.0).mean(axis=0) <= MAX_STICTION_SHARE
    bands = np.array(record.bands_hz)
    bandwidth = chosen.bandwidth_hz or float(bands[moves if moves.any() else slice(None)].min())
    edge = int(np.ceil(1.0 / (bandwidth * T)))
    check_length(log, edge, bandwidth)
    smooth_angle = low_pass(angle, bandwidth, T)
    velocity = differentiate(smooth_angle, T)
    gap = round(1.0 / (8.0 * bandwidth * T))
    angle_invalid = unmeasured(log, (f"theta_m{i + 1}" for i in range(arm.n_joints)), gap)
    torque_invalid = np.column_stack([unmeasured(log, (name,), gap) for name in record.channels])
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
        torsion=_torsion(log, arm, bandwidth) if chosen.with_torsion else None,
    )


def _torsion(log: Log, arm: Arm, bandwidth_hz: float) -> FloatArray | None:
    """Low-passed torsion of all gears; None if one is unknown."""
    torsion, is_measured = measured_torsion(log, arm)
    elastic = [i for i, joint in enumerate(arm.joints) if joint.elastic]
    if not elastic or not is_measured[:, elastic].any(axis=0).all():
        return None
    return low_pass(torsion, bandwidth_hz, log.sample_time)


def measured_torsion(log: Log, arm: Arm) -> tuple[FloatArray, BoolArray]:
    """Torsion [rad, m], (n_samples, n_joints), and where it is measured; zero without a reading.

    A mean beyond any torsion is a difference of the encoders' zeros and is removed.
    """
    with_angles = add_link_angles(log, arm)
    links = arm.links_of(prepare_record(log, arm).motor_angle)
    torsion, is_measured = np.zeros(links.shape), np.zeros(links.shape, dtype=bool)
    for i in range(arm.n_joints):
        second = f"theta_l{i + 1}"
        if second in with_angles.channels:
            torsion[:, i] = links[:, i] - with_angles.channels[second]
            is_measured[:, i] = ~unmeasured(with_angles, (second,))
    mean = torsion.mean(axis=0)
    return torsion - np.where(np.abs(mean) > _MAX_TORSION, mean, 0.0), is_measured


def mark_standstill(records: Sequence[Signals]) -> tuple[Signals, ...]:
    """Set the sliding direction of motors to uncertain in records in which they only deflect.

    `records` are all records of an arm: a motor stands if it travels far less than in others.
    """
    stands = detect_standing_motors([record.motor_angle for record in records])
    return tuple(
        replace(record, direction=np.where(at, 0.0, record.direction)) if at.any() else record
        for record, at in zip(records, stands, strict=True)
    )


def detect_standing_motors(angles: Sequence[FloatArray]) -> BoolArray:
    """Whether each motor only deflects in each record, (n_records, n_joints).

    `angles`, each (n_samples, n_joints), are those of all records of an arm.
    """
    travel = np.array([np.ptp(angle, axis=0) for angle in angles])
    return np.asarray(travel < _MIN_TRAVEL_SHARE * np.max(travel, axis=0, initial=0.0))
