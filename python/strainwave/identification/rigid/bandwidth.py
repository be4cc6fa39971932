"""Search for the bandwidth of the rigid step, and the model error that it shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import FloatArray, Signals
from strainwave.dynamics.arm import Arm
from strainwave.identification.rigid.equations import convert_estimate
from strainwave.identification.rigid.filtered_record import FilteredRecord, n_compliances, prepare
from strainwave.identification.rigid.trial import Trial, fit_trial

_BANDWIDTH_RATIO = 2.0**0.5  # ratio of successive bandwidths; squared if no gear is elastic
# log of a significant ratio of standard deviations, the accuracy of the jackknife
_MIN_LOG_GAIN = np.log(1.1)
_MAX_BANDWIDTHS_WITHOUT_GAIN = 3  # successive bandwidths without improvement that end the search

Motion = tuple[Signals, float]
"""Signals of a record and their period in samples."""


def search_bandwidths(motions: Sequence[Motion], arm: Arm) -> list[Trial]:
    """Fit at increasing bandwidths while the estimates improve and the gears are nearly rigid."""
    trials: list[Trial] = []
    least_spread, n_without_gain = np.full(len(arm.rigid_columns), np.inf), 0
    is_rigid = n_compliances(arm) == 0
    for bandwidth in bandwidths_of(motions, _BANDWIDTH_RATIO ** (2 if is_rigid else 1)):
        limits = [trial.max_rigid_bandwidth for trial in trials[-2:]]
        if len(limits) > 1 and bandwidth > max(limits):  # a single trial may be unreliable
            break
        stretches = prepare_all(arm, motions, bandwidth)
        last = trials[-1] if trials else None
        start = convert_estimate(last.estimate, last.stretches, stretches) if last else None
        trial = fit_trial(arm, stretches, start)
        trials.append(trial)
        has_improved = bool(np.any(trial.spread < least_spread - _MIN_LOG_GAIN))
        n_without_gain = 0 if has_improved else n_without_gain + 1
        least_spread = np.minimum(least_spread, trial.spread)
        if n_without_gain >= _MAX_BANDWIDTHS_WITHOUT_GAIN:
            break
    return trials


def bandwidths_of(motions: Sequence[Motion], step: float) -> Iterator[float]:
    """Yield bandwidths from that of 90 % of the motion's power to half the signals' bandwidth."""
    top = min(s.bandwidth_hz or 0.5 / s.sample_time for s, _ in motions) / 2.0
    shortest = min(period * s.sample_time for s, period in motions)
    bandwidth = max(8.0 / shortest, _motion_band([s for s, _ in motions]))
    bandwidth = min(bandwidth, top)
    while bandwidth <= top:
        yield bandwidth
        bandwidth *= step


def _motion_band(records: Sequence[Signals]) -> float:
    """Frequency [Hz] below which 90 % of the power of each velocity in the records lies."""
    frequencies, powers = [], []
    for signals in records:
        velocity, count = signals.motor_velocity, len(signals.time)
        centred_index = np.arange(count) - 0.5 * (count - 1)
        detrended = velocity - velocity.mean(axis=0)
        slope = centred_index @ detrended / (centred_index @ centred_index)
        detrended -= np.outer(centred_index, slope)
        frequencies.append(np.fft.rfftfreq(count, signals.sample_time))
        powers.append(np.abs(np.fft.rfft(detrended, axis=0)) ** 2 / count)
    frequency, power = np.concatenate(frequencies), np.concatenate(powers)
    order = np.argsort(frequency, kind="stable")
    cumulative = np.cumsum(power[order], axis=0)
    reached = [np.searchsorted(c, 0.9 * c[-1]) for c in cumulative.T if c[-1] > 0.0]
    return max((float(frequency[order[k]]) for k in reached), default=0.0)


def prepare_all(
    arm: Arm, motions: Sequence[Motion], bandwidth_hz: float
) -> tuple[FilteredRecord, ...]:
    """Filter all records for the equations of one bandwidth."""
    return tuple(prepare(arm, s, bandwidth_hz, period) for s, period in motions)


def select_bandwidth(trials: Sequence[Trial]) -> Trial:
    """Select the bandwidth at which all standard deviations are close to their minimum.

    The regret of a bandwidth is the largest ratio of a standard deviation to its minimum over the
    bandwidths. For elastic gears, the lowest bandwidth with a small regret is selected, because
    model error is largest at high frequencies. For rigid gears, the standard deviations include the
    model error, because noise of the acceleration or a delay biases inertias at high frequencies;
    bandwidths with few rows count only if there are no others.
    """
    is_rigid = not n_compliances(trials[0].arm)
    if is_rigid:
        trials = [t for t in trials if not t.has_short_blocks] or trials
    spread = np.array([trial.spread for trial in trials])
    for k, trial in enumerate(trials if is_rigid else ()):
        near = neighbours(trials, trial)
        below = [t for t in near if t.bandwidth_hz < trial.bandwidth_hz]
        others = [(t.solution, np.diag(t.covariance)) for t in below or near]
        excess = excess_variance(trial.solution, others)
        spread[k] = 0.5 * np.log(np.exp(2.0 * spread[k]) + excess)
    least_spread = spread.min(axis=0)
    identified = np.isfinite(least_spread)
    regret = np.max(spread[:, identified] - least_spread[identified], axis=1, initial=0.0)
    if is_rigid:
        return trials[int(np.argmin(regret))]
    return trials[int(np.argmax(regret <= regret.min() + _MIN_LOG_GAIN))]


def neighbours(trials: Sequence[Trial], best: Trial) -> list[Trial]:
    """Trials within about a factor of two of the best bandwidth."""
    return [
        t for t in trials if t is not best and 0.45 <= t.bandwidth_hz / best.bandwidth_hz <= 2.1
    ]


def excess_variance(
    value: FloatArray | float, others: Sequence[tuple[FloatArray, FloatArray]]
) -> FloatArray:
    """Variance of the model error of an estimate, from its change with the bandwidth.

    With an exact model, the estimates at all bandwidths agree within their standard deviations. The
    excess is the median over neighbouring bandwidths, which is insensitive to uncertain trials at
    low bandwidths. `others` has estimates and variances at these.
    """
    excess = [np.clip((other - value) ** 2 - variance, 0.0, None) for other, variance in others]
    return np.asarray(np.median(excess, axis=0) if excess else np.zeros_like(value))
