"""Signals -> the period that a motion repeats.

A second period brings no new motion: what the model lacks, and what counts and reversals do to the
signals, comes again with it. Deviations from leaving out stretches hold if a stretch is left out in
all periods, and a band is narrow against one period, not against all.
"""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, Signals

_LOOKED_AT = 1 << 17  # samples: a longer period says enough by itself
_ALIKE = 0.95  # correlation from which motion repeats; servoed motion comes to 0.999
_BESIDE = 2.0  # samples between a multiple and what it is expected to be: both are whole
_UNLIKE = 0.5  # below which it must have been before, or it is only slow


def period_of(signals: Signals) -> float:
    """Samples after which the joints' motion is the same again; all where it never is.

    Returns: At most two thirds of the samples, or all.
    """
    n = len(signals.time)
    velocity = signals.motor_velocity[:_LOOKED_AT]
    alike = _correlation(velocity - velocity.mean(axis=0))
    unlike = np.flatnonzero(alike < _UNLIKE)
    if not unlike.size:
        return float(n)
    peaks = 1 + np.flatnonzero((alike[1:-1] >= alike[:-2]) & (alike[1:-1] > alike[2:]))
    peaks = peaks[(peaks > unlike[0]) & (alike[peaks] > _ALIKE)]
    if not peaks.size or not _repeats(signals.motor_velocity, int(peaks[0])):
        return float(n)
    # a multiple is known as well as the period itself
    period = float(peaks[0])
    for k in range(2, len(alike)):
        near = np.flatnonzero(np.abs(peaks - k * period) <= _BESIDE)
        if not near.size:
            break
        period = float(peaks[near[np.argmax(alike[peaks[near]])]]) / k
    return period


def _correlation(motion: FloatArray) -> FloatArray:
    """Of a motion and itself so many samples later, both as long as both are there.

    2 x(t) x(t + l) / (x(t)^2 + x(t + l)^2), sums over t and the joints, each of unit variance.

    `motion` (n_samples, n_joints).

    Returns: (2 n_samples // 3,).
    """
    n, size = len(motion), motion.std(axis=0)
    x = motion / np.where(size > 0.0, size, 1.0)
    spectrum = np.sum(np.abs(np.fft.rfft(x, 2 * n, axis=0)) ** 2, axis=1)
    lag = np.arange(2 * n // 3)
    product = np.fft.irfft(spectrum, 2 * n)[lag]
    energy = np.r_[0.0, np.cumsum(np.sum(x**2, axis=1))]
    both = energy[n - lag] + energy[-1] - energy[lag]
    return np.asarray(2.0 * product / np.maximum(both, 1e-300))


def _repeats(motion: FloatArray, period: int) -> bool:
    """Whether the whole of a motion does, not only what was looked at."""
    every = max(1, len(motion) // _LOOKED_AT)
    now, then = motion[:-period:every], motion[period::every]
    changed = np.sum((then - now) ** 2, axis=0)
    size = np.sum((now - now.mean(axis=0)) ** 2 + (then - then.mean(axis=0)) ** 2, axis=0)
    return bool(np.all(changed <= (1.0 - _ALIKE) * size))
