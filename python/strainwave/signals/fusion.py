"""Complementary filter (10): high frequencies of one sensor, low frequencies of another."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, Fusion, Lag
from strainwave.numerics.filters import apply_lags


def fuse(rate: FloatArray, slow: FloatArray, fusion: Fusion, sample_time: float) -> FloatArray:
    """Sum of the high-pass filtered integral of a rate and the low-pass filtered slow signal, (10).

    y = (1 - F) (1/s) rate + F slow, with T = T_V:

        order 1: F = 1 / (1 + T s),
                 y = (T rate + slow) / (1 + T s);
        order 2: F = 1 / (1 + sqrt(2) T s + T^2 s^2),
                 y = (T^2 s rate + sqrt(2) T rate + slow) / (1 + sqrt(2) T s + T^2 s^2).

    The two filters sum to one: if `rate` is the derivative of `slow`, y = slow. All signals are
    (n_samples,).
    """
    # Only the high-pass filtered difference is added to slow, which avoids an initial transient.
    integral = np.r_[0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]))] * sample_time
    difference = integral - (slow - slow[0])
    return np.asarray(slow + difference - complement(difference, fusion, sample_time))


def complement(signal: FloatArray, fusion: Fusion, sample_time: float) -> FloatArray:
    """Low-pass F of the fusion, (n_samples,); its initial state is rest at the first sample."""
    low_pass = Lag(fusion.order, 1.0 / (2.0 * np.pi * fusion.time_constant))
    return apply_lags(signal, [low_pass], sample_time)


def bias_of(acceleration: FloatArray, velocity: FloatArray, sample_time: float, edge: int) -> float:
    """Bias of an acceleration [rad/s^2] relative to an encoder velocity [rad/s].

    The weighted mean of (acceleration - velocity') over the record, integrated by parts,

        sum(w a + w' v) / sum(w),    w = sin^4.

    The weight and its slope vanish at both ends, so a vibration of the spring between the two
    sensors does not contribute. `edge` samples at each end are excluded.
    """
    a, v = acceleration[edge:-edge], velocity[edge:-edge]
    phase = np.pi * (np.arange(len(a)) + 0.5) / len(a)
    weight = np.sin(phase) ** 4
    slope = 4.0 * np.sin(phase) ** 3 * np.cos(phase) * np.pi / (len(a) * sample_time)
    return float((weight @ a + slope @ v) / weight.sum())
