"""Spectral densities by Welch's method.

SciPy provides the method too, but its import takes 0.2 s.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from strainwave.domain import ComplexArray, FloatArray

Trend = Literal["mean", "line"]
"""Trend that is removed from each window before the transform."""


def periodic_hann(samples: int) -> FloatArray:
    """Periodic Hann window; copies shifted by half its length sum to one."""
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(samples) / samples))


def window_spectra(
    columns: FloatArray, window: FloatArray, step: int, *, trend: Trend = "mean"
) -> ComplexArray:
    """Fourier transforms of windows that start every `step` samples.

    `columns` (n_samples, n_columns).
    `window` (n_window,): Weights, at most n_samples long.

    Returns (n_windows, n_frequencies, n_columns), from zero to the Nyquist frequency.
    """
    size = len(window)
    windows = np.lib.stride_tricks.sliding_window_view(columns, size, axis=0)[::step]
    windows = windows - windows.mean(axis=2, keepdims=True)
    if trend == "line":
        time_index = np.arange(size) - 0.5 * (size - 1)
        windows -= (windows @ time_index)[:, :, None] * (time_index / (time_index @ time_index))
    return np.asarray(np.swapaxes(np.fft.rfft(windows * window), 1, 2))


def cross_spectral_densities(
    columns: FloatArray, sample_time: float, segment: int, *, trend: Trend = "mean"
) -> tuple[FloatArray, ComplexArray]:
    """One-sided cross-spectral densities by Welch's method with half-overlapping Hann windows.

    `columns` (n_samples, n_columns).
    `sample_time` [s].
    `segment`: Samples per window.

    Returns frequencies (n_frequencies,) [Hz] and densities (n_frequencies, n_columns, n_columns)
    [1/Hz] with conj(x_i) x_j at (i, j).
    """
    weight = periodic_hann(segment)
    spectra = window_spectra(columns, weight, segment - segment // 2, trend=trend)
    by_frequency = np.moveaxis(spectra, 0, 2)  # (n_frequencies, n, n_windows)
    density = by_frequency.conj() @ np.swapaxes(by_frequency, 1, 2)
    density *= sample_time / (len(spectra) * (weight @ weight))
    density[1 : (segment + 1) // 2] *= 2.0
    return np.asarray(np.fft.rfftfreq(segment, sample_time)), np.asarray(density)
