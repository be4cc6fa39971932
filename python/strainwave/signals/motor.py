"""Log -> Signals: motor torque, angle and its derivatives through one zero-phase filter.

Activity of each joint (RMS torque, velocity and acceleration) in the fitted records.

A second period of a repeated motion adds no new motion: model error and the effects of encoder
resolution and reversals repeat. A jackknife is therefore valid only if a block is left out in all
periods, and the bandwidth must be compared with one period, not with the whole record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import Activity, BoolArray, FloatArray, Log, Signals
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import MAX_STICTION_SHARE
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.signals.channels import MotorInput, check_length, unmeasured
from strainwave.signals.drive_law import DriveLaw
from strainwave.signals.prepared_record import add_link_angles, prepare_record

# Share of a motor's largest travel in any record below which it stands: the travel is a deflection
# of gear and bearings before they slide, even if the encoder resolves it.
_MIN_TRAVEL_SHARE = 0.01
# largest mean torsion [rad, m] of a gear; a larger one is a difference of the encoders' zeros
_MAX_TORSION = 0.01
# Share of the velocity power, and ratio of the bandwidth to the frequency below which that share
# lies, for slow and for fast records.
_SLOW_BAND = (0.8, 2.0)
_FAST_BAND = (0.5, 0.25)
# Minimum power of a spectral line of a motion over that of noise, which one line in 22,000 of white
# noise exceeds.
_MIN_LINE_OVER_NOISE = 10.0


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


# [s] of each velocity difference; reduces the effect of encoder quantization
_DIFFERENCE_TIME = 0.01


def activity_of(logs: Sequence[Log], arm: Arm) -> tuple[Activity, ...]:
    """Compute the RMS torque, velocity and acceleration of each joint over all fitted records.

    Velocities are differences over 0.01 s, which reduces the effect of encoder quantization.
    Validation records and records without the signals of the joint are excluded. Returns one entry
    per joint with signals in at least one record.
    """
    activities = []
    for number in range(1, arm.n_joints + 1):
        fitted = [_mean_squares(log, arm, number) for log in logs if log.experiment.use != "check"]
        mean_squares = [each for each in fitted if each is not None]
        if mean_squares:
            torque, velocity, acceleration = np.sqrt(np.mean(mean_squares, axis=0)).tolist()
            activities.append(Activity(number, torque, velocity, acceleration))
    return tuple(activities)


def _mean_squares(log: Log, arm: Arm, number: int) -> FloatArray | None:
    """Mean squares of torque, velocity and acceleration of one joint; None without its signals."""
    angle = log.channels.get(f"theta_m{number}")
    motor = MotorInput.of(log, number, ("torque", "u"))
    step = max(1, round(_DIFFERENCE_TIME / log.sample_time))
    if motor is None or angle is None or len(angle) < 4 * step:
        return None
    span = step * log.sample_time
    velocity = (angle[step:] - angle[:-step]) / span
    acceleration = (velocity[step:] - velocity[:-step]) / span
    law = DriveLaw.of(arm.joints[number - 1])
    torque = law.command(motor.values) if motor.is_voltage else motor.values
    return np.array([np.mean(series**2) for series in (torque, velocity, acceleration)])


# maximum number of samples in the search; a longer period needs no repetition
_MAX_SEARCH_SAMPLES = 1 << 17
_MIN_CORRELATION = 0.95  # minimum correlation of repeated motion; servoed motion has 0.999
_MULTIPLE_TOLERANCE = 2.0  # [samples] tolerance of a multiple of the period, which is rounded
# the correlation must fall below this first; otherwise the motion is only slow
_MAX_CORRELATION_BETWEEN_PERIODS = 0.5


def period_of(signals: Signals) -> float:
    """Period of the motion of all joints in samples, at most two thirds of the record.

    Returns the number of samples if the motion does not repeat.
    """
    n = len(signals.time)
    velocity = signals.motor_velocity[:_MAX_SEARCH_SAMPLES]
    correlation = _correlation(velocity - velocity.mean(axis=0))
    low_correlation = np.flatnonzero(correlation < _MAX_CORRELATION_BETWEEN_PERIODS)
    if not low_correlation.size:
        return float(n)
    peaks = 1 + np.flatnonzero(
        (correlation[1:-1] >= correlation[:-2]) & (correlation[1:-1] > correlation[2:])
    )
    peaks = peaks[(peaks > low_correlation[0]) & (correlation[peaks] > _MIN_CORRELATION)]
    if not peaks.size or not _repeats(signals.motor_velocity, int(peaks[0])):
        return float(n)
    # a multiple has the same absolute error, so the period becomes more accurate
    period = float(peaks[0])
    for k in range(2, len(correlation)):
        candidates = np.flatnonzero(np.abs(peaks - k * period) <= _MULTIPLE_TOLERANCE)
        if not candidates.size:
            break
        period = float(peaks[candidates[np.argmax(correlation[peaks[candidates]])]]) / k
    return period


def _correlation(motion: FloatArray) -> FloatArray:
    """Normalised autocorrelation (2 n_samples // 3,) of a motion (n_samples, n_joints).

    2 x(t) x(t + l) / (x(t)^2 + x(t + l)^2), summed over the overlap and the joints, each with unit
    variance.
    """
    n, scale = len(motion), motion.std(axis=0)
    x = motion / np.where(scale > 0.0, scale, 1.0)
    spectrum = np.sum(np.abs(np.fft.rfft(x, 2 * n, axis=0)) ** 2, axis=1)
    lag = np.arange(2 * n // 3)
    product = np.fft.irfft(spectrum, 2 * n)[lag]
    energy = np.r_[0.0, np.cumsum(np.sum(x**2, axis=1))]
    overlap_energy = energy[n - lag] + energy[-1] - energy[lag]
    return np.asarray(2.0 * product / np.maximum(overlap_energy, 1e-300))


def _repeats(motion: FloatArray, period: int) -> bool:
    """Whether the whole motion repeats, beyond the samples of the search."""
    step = max(1, len(motion) // _MAX_SEARCH_SAMPLES)
    motion_before, motion_after = motion[:-period:step], motion[period::step]
    squared_difference = np.sum((motion_after - motion_before) ** 2, axis=0)
    energy = np.sum(
        (motion_before - motion_before.mean(axis=0)) ** 2
        + (motion_after - motion_after.mean(axis=0)) ** 2,
        axis=0,
    )
    return bool(np.all(squared_difference <= (1.0 - _MIN_CORRELATION) * energy))


def motion_bands(angle: FloatArray, sample_time: float, *, slow: bool) -> list[float]:
    """Bandwidth of the commanded motion of each motor that moves, below the gear resonances [Hz].

    Slow records: 2 times the frequency below which 80 % of the velocity power lies. Fast records
    excite the gear resonances: 0.25 times the frequency below which 50 % of the power lies.
    Spectral lines of slow records that white angle noise can have do not count; the upper half band
    gives its power. `angle` has shape (n_samples, n_joints).
    """
    velocity = np.diff(angle[: 2**16], axis=0)
    power = np.abs(np.fft.rfft(velocity - velocity.mean(axis=0), axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(velocity), sample_time)
    share, ratio = _SLOW_BAND if slow else _FAST_BAND
    if slow:
        n, upper = len(power), slice(len(power) // 2, None)
        shape = np.sin(0.5 * np.pi * np.arange(n) / max(1, n - 1))[:, None] ** 2  # of differences
        noise = shape * power[upper].mean(axis=0) / shape[upper].mean()
        power[power < _MIN_LINE_OVER_NOISE * noise] = 0.0
    power = np.cumsum(power, axis=0)
    moving = power.T[power[-1] > 0.0]
    return [ratio * float(frequency[np.searchsorted(p, share * p[-1])]) for p in moving]
