"""Estimate the period of a repeated motion.

A second period adds no new motion: model error and the effects of encoder resolution and reversals
repeat. A jackknife is therefore valid only if a block is left out in all periods, and the bandwidth
must be compared with one period, not with the whole record.
"""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, Signals

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
