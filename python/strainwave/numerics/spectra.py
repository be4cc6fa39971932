"""Spectra of records in overlapping windows: the one estimate by Welch's method.

SciPy has it too, at a fifth of a second for its import.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from strainwave.domain import ComplexArray, FloatArray

Trend = Literal["mean", "line"]
"""What is taken off each window before its transform."""


def periodic_hann(samples: int) -> FloatArray:
    """The Hann window whose shifts by half of it add up to one."""
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(samples) / samples))


def window_spectra(
    columns: FloatArray, window: FloatArray, step: int, *, trend: Trend = "mean"
) -> ComplexArray:
    """Fourier transforms of windows that begin every few samples.

    `columns` (n_samples, n_columns).
    `window` (n_window,): Weights; no longer than the columns.
    `step`: Samples from one beginning to the next.

    Returns: (n_windows, n_frequencies, n_columns): By frequencies from zero to the Nyquist
    frequency.
    """
    size = len(window)
    windows = np.lib.stride_tricks.sliding_window_view(columns, size, axis=0)[::step]
    windows = windows - windows.mean(axis=2, keepdims=True)
    if trend == "line":
        along = np.arange(size) - 0.5 * (size - 1)
        windows -= (windows @ along)[:, :, None] * (along / (along @ along))
    return np.asarray(np.swapaxes(np.fft.rfft(windows * window), 1, 2))


def cross_spectral_densities(
    columns: FloatArray,
    sample_time: float,
    segment: int,
    *,
    trend: Trend = "mean",
) -> tuple[FloatArray, ComplexArray]:
    """Cross-spectral densities by Welch's method: Hann windows that half overlap.

    `columns` (n_samples, n_columns).
    `sample_time` [s].
    `segment`: Samples in a window.

    Returns: `frequencies` (n_frequencies,) [Hz]; `densities` (n_frequencies, n_columns, n_columns)
    [1/Hz]: One-sided; conj(x_i) x_j in place (i, j).
    """
    weight = periodic_hann(segment)
    lines = window_spectra(columns, weight, segment - segment // 2, trend=trend)
    by_frequency = np.moveaxis(lines, 0, 2)  # (n_frequencies, n, n_windows)
    density = by_frequency.conj() @ np.swapaxes(by_frequency, 1, 2)
    density *= sample_time / (len(lines) * (weight @ weight))
    density[1 : (segment + 1) // 2] *= 2.0
    return np.asarray(np.fft.rfftfreq(segment, sample_time)), np.asarray(density)
