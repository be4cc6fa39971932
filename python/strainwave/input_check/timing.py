"""Timing of the commands: PRBS and servo clocks, and delays relative to the encoders.

Clocks follow from the times at which the commands change, delays from the phase of the response.

Above the gear resonances, a motor responds to its torque like a free inertia. The reaction of the
links through the gear springs decreases with 1/s^2. In terms of the motor angles of all joints,

    u exp(s D) = m s^2 theta + d s theta + f sgn(s theta) + sum_j (k_j0 + k_j1/s + ... ) theta_j

where D is the delay of the logged command and the sum expands the spring reaction in powers of
1/s. All coefficients are free, so D does not depend on scales or gains. Only open-loop records
determine D: a servo output also contains the encoder noise, and the estimate would be the delay of
the servo.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import ComplexArray, Control, Delay, FloatArray, Log, Prbs, channel_parts
from strainwave.domain.keys import JointIndex, JointNumber
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import band_passes
from strainwave.numerics.linalg import singular_values
from strainwave.signals.drive_law import DriveLaw
from strainwave.signals.prepared_record import prepare_record

# Minimum number of switches for a clock estimate.
_MIN_SWITCHES = 24
# Minimum size of a switch, as a share of the command's range. Less than half, because a servo
# output can add to the test signal.
_MIN_JUMP_SHARE = 0.3
# The same of one sample of a jump that takes several.
_MIN_PART_SHARE = 0.1
# Share of the range of a command below which a change is due to rounding.
_ROUNDING = 1e-9
# Maximum distance of a switch from a clock tick, in clock periods.
_MAX_TICK_DISTANCE = 0.2
# Minimum share of samples or switches that must agree with the hypothesis.
_MIN_AGREEING_SHARE = 0.95
# Minimum clock period in samples. With shorter periods, the record can miss switches.
_MIN_CLOCK_SAMPLES = 1.5
# Minimum autocorrelation of a periodic sequence at a lag of one period.
_MIN_PERIOD_CORRELATION = 0.8


def input_levels(log: Log) -> dict[str, float]:
    """Half the range of each open-loop command of a record with a PRBS."""
    if log.experiment.prbs is None:
        return {}
    commands = _commands(log)
    return {n: 0.5 * float(np.ptp(x)) for _, n, x, control in commands if control == "open"}


def _commands(log: Log) -> Iterator[tuple[JointNumber, str, FloatArray, Control]]:
    """Yield the joint, the channel and the values of each command, and its control."""
    for i, control in enumerate(log.experiment.control, start=1):
        name = f"u{i}" if f"u{i}" in log.channels else f"torque{i}"
        if name in log.channels:
            yield i, name, log.channels[name], control


def estimate_clocks(log: Log, arm: Arm) -> tuple[float | None, float | None]:
    """Clock [s] of the PRBS of a log, and update period [s] of its servo, from the commands."""
    experiment, prbs, servo = log.experiment, None, None
    for i, _, values, control in _commands(log):
        if control == "open" and experiment.prbs is not None:
            middle = 0.5 * (values.max() + values.min())
            is_near_middle = np.abs(values - middle) < 0.2 * float(np.ptp(values))
            if np.mean(is_near_middle) < 1.0 - _MIN_AGREEING_SHARE:  # two levels
                prbs = prbs or _estimate_clock(_jumps(values), log)
                prbs = prbs or _estimate_clock_from_period(values, log, experiment.prbs)
        elif control == "servo":
            if arm.servo is not None:
                change = np.abs(np.diff(values))
                changes = np.flatnonzero(change > _ROUNDING * float(np.ptp(values)))
                servo = servo or _estimate_clock(changes.astype(np.float64), log)
            if experiment.prbs is not None and experiment.joint == i:
                prbs = prbs or _estimate_clock(_jumps(values), log)
    return prbs, servo


def find_excited_inputs(log: Log) -> frozenset[str]:
    """Commands with at least `_MIN_SWITCHES` jumps larger than `_MIN_JUMP_SHARE` of their range."""
    excited = set()
    for name, values in log.channels.items():
        if channel_parts(name)[0] in ("u", "torque"):
            jumps = np.abs(np.diff(values)) > _MIN_JUMP_SHARE * float(np.ptp(values))
            if jumps.sum() >= _MIN_SWITCHES:
                excited.add(name)
    return frozenset(excited)


def _jumps(values: FloatArray) -> FloatArray:
    """Samples, with fractions, of jumps by more than `_MIN_JUMP_SHARE` of the range.

    Lags and interpolation spread a jump over some samples; its time is their centroid.
    """
    change, size = np.diff(values), float(np.ptp(values))
    parts = np.flatnonzero(np.abs(change) > _MIN_PART_SHARE * size)
    if not len(parts):
        return np.zeros(0)
    change, is_apart = change[parts], np.diff(parts) > 1
    starts = np.flatnonzero(np.r_[True, is_apart | (np.diff(np.sign(change)) != 0.0)])
    total = np.add.reduceat(change, starts)
    times = np.add.reduceat(parts * change, starts) / total
    return np.asarray(times[np.abs(total) > _MIN_JUMP_SHARE * size])


def _estimate_clock(changes: FloatArray, log: Log) -> float | None:
    """Clock period [s] of changes at given samples.

    The shortest interval between changes gives a starting value. Linear regression of the change
    times on the tick numbers refines it. Returns None unless nearly all intervals are whole
    multiples of the period.
    """
    if len(changes) < _MIN_SWITCHES:
        return None
    intervals = np.diff(changes)
    shortest_interval = float(np.percentile(intervals, 5.0))
    if shortest_interval < _MIN_CLOCK_SAMPLES:
        return None
    clock = float(np.mean(intervals[intervals < 1.5 * shortest_interval]))
    elapsed = changes[1:] - changes[0]
    for _ in range(3):
        ticks = np.cumsum(np.round(intervals / clock))
        clock = float(ticks @ elapsed / (ticks @ ticks))
    distance = np.abs(intervals / clock - np.round(intervals / clock))
    return (
        clock * log.sample_time
        if np.mean(distance < _MAX_TICK_DISTANCE) > _MIN_AGREEING_SHARE
        else None
    )


def _estimate_clock_from_period(values: FloatArray, log: Log, prbs: Prbs) -> float | None:
    """PRBS clock [s] from the period of the sequence, for records that do not resolve switches.

    The autocorrelation of a maximum-length sequence is 1 at multiples of the period and nearly 0
    elsewhere. Returns None if the record does not repeat the sequence.
    """
    size = float(np.ptp(values))
    if prbs.periods < 2 or size == 0.0:
        return None
    n = len(values)
    spectrum = np.fft.rfft(values - values.mean(), 2 * n)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: n // 2 + 1]
    overlap = n - np.arange(len(correlation))
    correlation /= overlap * correlation[0] / n
    first = int(np.argmax(correlation < 0.5))
    lag = first + int(np.argmax(correlation[first:]))
    if first == 0 or correlation[lag] < _MIN_PERIOD_CORRELATION:
        return None
    repeats = np.flatnonzero(correlation > _MIN_PERIOD_CORRELATION)
    lag = int(repeats[repeats > first][0]) if np.any(repeats > first) else lag
    return float(lag * log.sample_time / (2**prbs.order - 1))


# Delays of the search, up to 24 ms in either direction, and their step [s]: 0.25 rad of phase at
# 200 Hz. A parabola refines the estimate.
_DELAY_STEP = 2e-4
_DELAYS = _DELAY_STEP * np.arange(-120.0, 121.0)
# Upper band limit over the frequency at which the encoder signal falls to its noise.
_BAND_SHARE = 0.5
# Upper over lower band limit. The wider band is for records with resonances below the narrow one.
_BAND_RATIOS = (2.0, 5.0)
# Powers of 1/s in the expansion of the spring reaction.
_SPRING_ORDERS = (0, 1, 2, 3, 4)
# Minimum number of spectral lines, and per coefficient of the regression.
_MIN_LINES = 60
_MIN_LINES_PER_COEFFICIENT = 4
# Minimum explained share of the command. Random fault-free arms below it had errors of 8 ms.
_MIN_EXPLAINED = 0.95
# Minimum decrease of the unexplained share, as a factor. Without a fault, noise gave up to 1.7 on
# planar arms, and up to 2.2 on chains.
_MIN_IMPROVEMENT = 3.0
# Spectral lines whose delays are computed at a time; those of a long record need gigabytes.
_BLOCK_LINES = 4096
# Phase error at the upper band limit due to friction and unmodelled lags [rad].
_PHASE_FLOOR = 0.03


@dataclass(frozen=True, slots=True)
class DelayProfile:
    """Unexplained share of the command of one record as a function of its delay."""

    unexplained: FloatArray  # (n_delays,) over `_DELAYS`
    lines: int  # spectral lines in the band
    band_hz: float  # upper band limit
    sample_time: float  # [s] of the log


def compute_delay_profile(log: Log, arm: Arm, i: JointIndex) -> DelayProfile | None:
    """Delay profile of joint i. Returns None if the record does not determine the delay."""
    record, T = prepare_record(log, arm), log.sample_time
    top = _BAND_SHARE * record.bands_hz[i]
    motor = record.inputs[i]
    torque = motor.values
    if motor.is_voltage:  # the scale is arbitrary
        torque = DriveLaw.of(arm.joints[i]).torque_without_aliases(torque, T)
    signals = np.column_stack([record.motor_angle, record.sliding[:, i], torque])
    profiles = [_band_profile(log, signals, i, (top / ratio, top)) for ratio in _BAND_RATIOS]
    valid = [each for each in profiles if each is not None]
    return min(valid, key=lambda each: float(each.unexplained.min()), default=None)


def pool_delays(profiles: Sequence[DelayProfile]) -> Delay | None:
    """Maximum-likelihood delay over several records.

    Returns None if the records do not determine the delay, or if it does not differ significantly
    from zero.
    """
    valid = [p for p in profiles if p.unexplained.min() < 1.0 - _MIN_EXPLAINED]
    if not valid:
        return None
    cost = np.sum([p.lines * np.log(p.unexplained) for p in valid], axis=0)
    best, grid = int(np.argmin(cost)), _DELAYS
    zero = len(grid) // 2
    lines = sum(p.lines for p in valid)
    if best in (0, len(grid) - 1) or cost[zero] - cost[best] < lines * np.log(_MIN_IMPROVEMENT):
        return None
    # The unexplained share is parabolic near its minimum; its logarithm is not.
    share = np.sum([p.lines * p.unexplained / p.unexplained.min() for p in valid], axis=0)
    left, middle, right = (float(share[k]) for k in (best - 1, best, best + 1))
    vertex = 0.5 * (left - right) / (left - 2.0 * middle + right)
    floor = _PHASE_FLOOR / (2.0 * np.pi * max(p.band_hz for p in valid))
    return Delay(float(grid[best]) + vertex * _DELAY_STEP, floor)


def _band_profile(
    log: Log, signals: FloatArray, i: int, band: tuple[float, float]
) -> DelayProfile | None:
    """Delay profile of joint i in one frequency band [Hz]; None if the record is too short."""
    T, n = log.sample_time, signals.shape[1] - 2
    edge = int(np.ceil(1.5 / (band[0] * T)))  # samples with end effects of the band-pass
    if len(signals) < 4 * edge:
        return None
    springs = [(j, order) for j in range(n) for order in _SPRING_ORDERS]
    derivatives = [(n + 1, 0), (i, -2), (i, -1), (n, 0), *springs]
    filtered = band_passes(signals, derivatives, *band, T)[edge:-edge]
    frequency: FloatArray = np.fft.rfftfreq(len(filtered), T).astype(np.float64)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    if inside.sum() < max(_MIN_LINES, _MIN_LINES_PER_COEFFICIENT * len(derivatives)):
        return None
    lines = np.fft.rfft(np.hanning(len(filtered))[:, None] * filtered, axis=0)[inside]
    columns = _stack_real_imaginary(lines[:, 1:])
    size = np.linalg.norm(columns, axis=0)
    total = float(np.sum(np.abs(lines[:, 0]) ** 2))
    if total == 0.0 or size.max() == 0.0:
        return None
    columns = columns[:, size > 0.0] / size[size > 0.0]
    basis, values, _ = singular_values(columns)
    basis = basis[:, values > 1e-7 * values[0]]
    explained = np.sum(_products(basis, lines[:, 0], frequency[inside]) ** 2, axis=0) / total
    unexplained = np.maximum(1.0 - explained, 1e-9)
    return DelayProfile(unexplained, int(inside.sum()), band[1], T)


def _products(basis: FloatArray, command: ComplexArray, frequency: FloatArray) -> FloatArray:
    """Products of a basis, (2 n_lines, n), with the command after each delay: (n, n_delays)."""
    of_real, of_imaginary = np.split(basis, 2)
    products = np.zeros((basis.shape[1], len(_DELAYS)))
    for start in range(0, len(command), _BLOCK_LINES):
        rows = slice(start, start + _BLOCK_LINES)
        turns = np.exp(2j * np.pi * np.outer(frequency[rows], _DELAYS))
        shifted = command[rows, None] * turns
        products += of_real[rows].T @ shifted.real + of_imaginary[rows].T @ shifted.imag
    return products


def _stack_real_imaginary(lines: ComplexArray) -> FloatArray:
    """Real parts above imaginary parts."""
    return np.concatenate([lines.real, lines.imag])
