"""Correlation of errors between rows."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.numerics.spectra import rows_per_error


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
