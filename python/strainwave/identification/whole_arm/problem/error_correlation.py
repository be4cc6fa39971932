"""Correlation of errors between rows."""

from __future__ import annotations

import numpy as np

from strainwave.domain import ComplexArray, FloatArray
from strainwave.identification.whole_arm.records.dataset import Dataset


def estimate_rows_per_error(column: FloatArray) -> float:
    """Rows per independent error of a series (n_rows,), from its autocorrelation."""
    return rows_per_error(spectrum_and_autocovariance(column)[1][: len(column) // 2])


def spectrum_and_autocovariance(column: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Zero-padded spectrum (n + 1,) and autocovariance times n (n,) of a series (n,).

    Both are without the mean; the autocovariance starts at lag zero.
    """
    n = len(column)
    spectrum = np.asarray(np.fft.rfft(column - column.mean(), 2 * n))
    return spectrum, np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[:n]


def white_noise_autocovariance(taps: FloatArray, step: int) -> FloatArray:
    """Autocovariance (n_lags,) of filtered and decimated white noise of unit variance.

    `taps` (n_taps,) are those of the filter; a row follows every `step` samples. The first lag is
    zero.
    """
    return np.array([taps[: len(taps) - k] @ taps[k:] for k in range(0, len(taps), step)])


def noise_autocovariances(record: Dataset) -> list[FloatArray]:
    """Autocovariance (n_lags,) of each channel's noise for white sensor noise of unit variance."""
    taps = (record.kernels.taps(rate=channel.rate) for channel in record.channels)
    return [white_noise_autocovariance(one, record.kernels.step) for one in taps]


def filtered_rows_per_error(record: Dataset) -> FloatArray:
    """Rows per independent error (n_channels,) of filtered white noise."""
    return np.array([rows_per_error(lags) for lags in noise_autocovariances(record)])


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
