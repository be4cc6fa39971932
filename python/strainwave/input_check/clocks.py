"""PRBS and servo clocks estimated from the times at which the commands change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import FloatArray, Log, Prbs, channel_parts
from strainwave.dynamics.arm import Arm

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


@dataclass(frozen=True, slots=True)
class Clocks:
    """Clock periods and levels of the commands in one log."""

    prbs: float | None = None  # [s] clock of the PRBS
    servo: float | None = None  # [s] update period of the servo output
    level: Mapping[str, float] = field(default_factory=dict)  # half the range of open-loop inputs
    excited: frozenset[str] = frozenset()  # commands that contain a test signal

    def retimed(self, factor: float) -> Clocks:
        """Clocks after all time stamps are multiplied by `factor`."""
        prbs, servo = (None if x is None else factor * x for x in (self.prbs, self.servo))
        return replace(self, prbs=prbs, servo=servo)


def estimate_clocks(log: Log, arm: Arm) -> Clocks:
    """Estimate the PRBS and servo clocks of a log from its commands."""
    experiment = log.experiment
    level: dict[str, float] = {}
    prbs = servo = None
    for i, control in enumerate(experiment.control, start=1):
        name = f"u{i}" if f"u{i}" in log.channels else f"torque{i}"
        if name not in log.channels:
            continue
        values = log.channels[name]
        if control == "open" and experiment.prbs is not None:
            level[name] = 0.5 * float(np.ptp(values))
            if _has_two_levels(values):
                prbs = prbs or _estimate_clock(_jumps(values), log)
                prbs = prbs or _estimate_clock_from_period(values, log, experiment.prbs)
        elif control == "servo":
            if arm.servo is not None:
                servo = servo or _estimate_clock(_changes(values), log)
            if experiment.prbs is not None and experiment.joint == i:
                prbs = prbs or _estimate_clock(_jumps(values), log)
    return Clocks(prbs, servo, level, find_excited_inputs(log))


def find_excited_inputs(log: Log) -> frozenset[str]:
    """Commands with at least `_MIN_SWITCHES` jumps larger than `_MIN_JUMP_SHARE` of their range."""
    excited = set()
    for name, values in log.channels.items():
        if channel_parts(name)[0] in ("u", "torque"):
            jumps = np.abs(np.diff(values)) > _MIN_JUMP_SHARE * float(np.ptp(values))
            if jumps.sum() >= _MIN_SWITCHES:
                excited.add(name)
    return frozenset(excited)


def _changes(values: FloatArray) -> FloatArray:
    """Samples at which a signal changes by more than rounding."""
    change = np.abs(np.diff(values))
    return np.flatnonzero(change > _ROUNDING * float(np.ptp(values))).astype(np.float64)


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


def _has_two_levels(values: FloatArray) -> bool:
    """Whether a signal has few samples near the middle of its range."""
    size, middle = float(np.ptp(values)), 0.5 * float(values.max() + values.min())
    return bool(np.mean(np.abs(values - middle) < 0.2 * size) < 1.0 - _MIN_AGREEING_SHARE)


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
