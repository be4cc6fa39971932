"""Spectral densities by Welch's method.

SciPy provides the method too, but its import takes 0.2 s.

Residual analysis: autocorrelation of residuals and cross-correlation with the inputs.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, ResidualCorrelation

Trend = Literal["mean", "line"]
"""Trend that is removed from each window before the transform."""


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
    weight = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(segment) / segment)
    spectra = window_spectra(columns, weight, segment - segment // 2, trend=trend)
    by_frequency = np.moveaxis(spectra, 0, 2)  # (n_frequencies, n, n_windows)
    density = by_frequency.conj() @ np.swapaxes(by_frequency, 1, 2)
    density *= sample_time / (len(spectra) * (weight @ weight))
    density[1 : (segment + 1) // 2] *= 2.0
    return np.asarray(np.fft.rfftfreq(segment, sample_time)), np.asarray(density)


MAX_LAGS = 25
"""Maximum lag of each sign, as in MATLAB's `resid`."""


def correlate_residuals(
    residual: FloatArray, inputs: FloatArray, lag_time: float
) -> ResidualCorrelation:
    """Normalised correlations r(l) = sum e[k] x[k - l] / sqrt(sum e^2 sum x^2) without means.

    `residual` has shape (n_samples,), `inputs` (n_samples, n_inputs), and samples are `lag_time`
    [s] apart. If residual and input are independent, the variance of r is (1/n) sum_j rho_e(j)
    rho_u(j) at every lag, also for coloured signals (Bartlett, 1946).
    """
    n = len(residual)
    lags = max(1, min(MAX_LAGS, n // 4))
    residual_spectrum, autocovariance = spectrum_and_autocovariance(residual)
    power = float(autocovariance[0]) or 1.0  # the correlation of a constant signal is zero
    cross, std = [], []
    for column in inputs.T:
        input_spectrum, input_autocovariance = spectrum_and_autocovariance(column)
        input_power = float(input_autocovariance[0]) or 1.0
        products = (
            np.fft.irfft(residual_spectrum * input_spectrum.conj(), 2 * n)
            / np.sqrt(power)
            / np.sqrt(input_power)
        )
        cross.append(np.concatenate([products[-lags:], products[: lags + 1]]))
        terms = (autocovariance / power) * (input_autocovariance / input_power)
        std.append(np.sqrt(max(1.0, 1.0 + 2.0 * float(np.sum(terms[1 : n // 2]))) / n))
    return ResidualCorrelation(
        lag_time=lag_time,
        n_samples=n,
        autocorrelation=autocovariance[: lags + 1] / power,
        cross_correlation=np.column_stack(cross) if cross else np.zeros((2 * lags + 1, 0)),
        cross_std=np.array(std),
    )


def expected_autocorrelation(
    frequency_hz: FloatArray, density: FloatArray, lag_time: float, lags: int, n_samples: int
) -> tuple[FloatArray, FloatArray]:
    """Autocorrelation of noise with a given density, and the standard deviation of its estimate.

    Both have shape (lags + 1,). `density` is one-sided; the estimate uses `n_samples` samples.
    Bartlett (1946):

        Var r(l) = (1/n) sum_j [rho_j^2 + rho_(j+l) rho_(j-l) - 4 rho_l rho_j rho_(j-l)
                                + 2 rho_j^2 rho_l^2]
    """
    offsets = np.arange(-4 * lags, 4 * lags + 1)
    cosines = np.cos(2.0 * np.pi * np.outer(offsets * lag_time, frequency_hz))
    weights = density / np.maximum(np.sum(density), np.finfo(float).tiny)
    rho, zero = cosines @ weights, 4 * lags
    inner = np.arange(2 * lags, len(rho) - 2 * lags)
    variance = [
        np.sum(
            rho[inner] ** 2
            + rho[inner + lag] * rho[inner - lag]
            - 4.0 * rho[zero + lag] * rho[inner] * rho[inner - lag]
            + 2.0 * rho[inner] ** 2 * rho[zero + lag] ** 2
        )
        for lag in range(lags + 1)
    ]
    std = np.sqrt(np.clip(variance, 0.0, None) / n_samples)
    return rho[zero : zero + lags + 1], std


def estimate_rows_per_error(column: FloatArray) -> float:
    """Rows per independent error of a series (n_rows,), from its autocorrelation."""
    return rows_per_error(spectrum_and_autocovariance(column)[1][: len(column) // 2])


def spectrum_and_autocovariance(column: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Zero-padded spectrum (n + 1,) and autocovariance times n (n,) of a series (n,).

    Both are without the mean; the autocovariance starts at lag zero. Because of the padding,
    correlations are not circular.
    """
    n = len(column)
    spectrum = np.asarray(np.fft.rfft(column - column.mean(), 2 * n))
    return spectrum, np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[:n]


def rows_per_error(covariance: FloatArray) -> float:
    """Variance inflation factor: 1 + 2 sum of autocorrelations before the first negative one.

    `covariance` (n_lags,) starts at lag zero.
    """
    if covariance[0] <= 0.0:
        return 1.0
    correlation = covariance / covariance[0]
    negative = np.flatnonzero(correlation < 0.0)
    n_lags = negative[0] if negative.size else len(correlation)
    return float(1.0 + 2.0 * np.sum(correlation[1:n_lags]))
