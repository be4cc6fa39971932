"""One velocity from two sensors: high frequencies of one, low frequencies of the other, (10)."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, Fusion, Lag
from strainwave.numerics.filters import lagged


def fuse(rate: FloatArray, slow: FloatArray, fusion: Fusion, sample_time: float) -> FloatArray:
    """High-passed integral of a rate plus a low-passed slow signal, (10).

    y = (1 - F) (1/s) rate + F slow. With T = T_V:
    order 1, F = 1 / (1 + T s): y = (T rate + slow) / (1 + T s);
    order 2, F = 1 / (1 + sqrt(2) T s + T^2 s^2):
    y = (T^2 s rate + sqrt(2) T rate + slow) / (1 + sqrt(2) T s + T^2 s^2).
    Both sum to one: where `rate` is the slope of `slow`, y = slow.

    Parameters
    ----------
    rate : (n_samples,)
    slow : (n_samples,)
    fusion : Fusion
    sample_time : float [s]

    Returns
    -------
    (n_samples,)
    """
    # from slow itself, only what the integral knows better is added: no transient at the start
    integral = np.r_[0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]))] * sample_time
    difference = integral - (slow - slow[0])
    return np.asarray(slow + difference - complement(difference, fusion, sample_time))


def complement(signal: FloatArray, fusion: Fusion, sample_time: float) -> FloatArray:
    """The low-pass F of the fusion, from standstill at the first sample.

    Parameters
    ----------
    signal : (n_samples,)
    fusion : Fusion
    sample_time : float [s]

    Returns
    -------
    (n_samples,)
    """
    low_pass = Lag(fusion.order, 1.0 / (2.0 * np.pi * fusion.time_constant))
    return lagged(signal, [low_pass], sample_time)


def bias_of(acceleration: FloatArray, velocity: FloatArray, sample_time: float, edge: int) -> float:
    """What an acceleration differs by from an encoder's, at the lowest frequencies.

    The weighted mean of (acceleration - velocity') over the record, integrated by parts,
    sum(w a + w' v) / sum(w), with w = sin^4, which vanishes at either end with its slope: a
    vibration of the spring between the two sensors has no share in it.

    Parameters
    ----------
    acceleration : (n_samples,) [rad/s^2]
    velocity : (n_samples,) [rad/s]
    sample_time : float [s]
    edge : int
        Samples to leave out at either end.

    Returns
    -------
    float [rad/s^2]
    """
    a, v = acceleration[edge:-edge], velocity[edge:-edge]
    phase = np.pi * (np.arange(len(a)) + 0.5) / len(a)
    weight = np.sin(phase) ** 4
    slope = 4.0 * np.sin(phase) ** 3 * np.cos(phase) * np.pi / (len(a) * sample_time)
    return float((weight @ a + slope @ v) / weight.sum())
