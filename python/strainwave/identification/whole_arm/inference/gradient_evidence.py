"""Gradient of the loss of one record, with its information and its covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray, IntArray
from strainwave.identification.whole_arm.problem.objective import BLOCKS_PER_RECORD
from strainwave.identification.whole_arm.problem.weighted_rows import Rows, noise_autocovariances
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.numerics.spectra import spectrum_and_autocovariance

_HERMITE_SHARES = {1: 0.927, 3: 0.056, 5: 0.017}
"""Hermite degree -> share of the variance of r (1 + r^2)^(-1/2) for standard normal r.

The last entry includes all higher degrees. The gradient of the loss slightly whitens the noise.
"""


@dataclass(frozen=True, slots=True)
class RecordGradients:
    """Gradients and information of one record."""

    gradients: FloatArray  # (n_segments, n_unknowns) of the loss
    product: FloatArray  # (n_unknowns, n_unknowns) contribution to J'J
    curvature: FloatArray  # (n_unknowns, n_unknowns) second derivative of the loss
    steady: FloatArray  # (n_unknowns, n_unknowns) of the gradient, stationary errors
    noise: FloatArray  # (n_unknowns, n_unknowns) of the gradient, sensor noise only


def evidence_of(record: Dataset, rows: Rows, block: IntArray, noise: FloatArray) -> RecordGradients:
    """Compute gradients and information of one record, minimised over its own unknowns.

    `noise` is the sensor noise in weighted standard deviations. The gradient of the soft L1 loss
    has the weights (1 + r^2)^(-1/2), its second derivative (1 + r^2)^(-3/2).
    """
    n_initial, width = rows.evaluated.n_initial, rows.residual.shape[1]
    table = rows.columns
    flat = table.reshape(-1, table.shape[2])
    local, shared = flat[:, :n_initial], flat[:, n_initial:]
    n = shared.shape[1]
    if n_initial:  # orthogonal to the record's own unknowns
        shared = shared - local @ np.linalg.lstsq(local, shared)[0]
    gradients = shared * (rows.residual * rows.root).reshape(-1, 1)
    labels, segment = np.unique(np.repeat(block, width), return_inverse=True)
    sums = np.zeros((len(labels), n))
    np.add.at(sums, segment, gradients)
    robust_scale = np.sqrt(1.0 + rows.residual**2)
    scaled = shared / robust_scale.reshape(-1, 1)
    columns = shared.reshape(-1, width, n) * (rows.root * robust_scale)[..., None]
    steady, of_noise, rows_in = np.zeros((n, n)), np.zeros((n, n)), len(columns)
    for k, lags in enumerate(noise_autocovariances(record)):
        errors = _autocovariance(rows.residual[:, k], float(noise[k]))
        own_noise, correlation = np.zeros_like(errors), lags[:rows_in] / lags[0]
        share = noise[k] ** 2 / max(float(np.var(rows.residual[:, k])), noise[k] ** 2, 1e-300)
        of_loss = sum(weight * correlation**degree for degree, weight in _HERMITE_SHARES.items())
        own_noise[: len(correlation)] = errors[0] * share * of_loss
        covariances = gradient_covariances(columns[:, k], (errors, own_noise))
        steady, of_noise = steady + covariances[0], of_noise + covariances[1]
    return RecordGradients(sums, shared.T @ shared, scaled.T @ scaled, steady, of_noise)


def gradient_covariances(
    columns: FloatArray, autocovariances: Sequence[FloatArray]
) -> list[FloatArray]:
    """Covariances of columns' e for stationary errors e; columns is (n_rows, n_unknowns).

    Each autocovariance, (n_rows,) from lag zero, is tapered to the length of a segment (Newey and
    West, 1987). The covariance is the spectrum of the columns, weighted by the power spectrum of
    the errors. Returns one (n_unknowns, n_unknowns) for each autocovariance.
    """
    n = len(columns)
    max_lag = max(1, n // BLOCKS_PER_RECORD)
    n_fft = 2 * ((n + max_lag + 1) // 2)
    taper = 1.0 - np.arange(max_lag) / max_lag
    multiplicity = np.full(n_fft // 2 + 1, 2.0)  # positive and negative frequencies
    multiplicity[[0, -1]] = 1.0
    lines = np.fft.rfft(columns, n_fft, axis=0)
    covariances = []
    for autocovariance in autocovariances:
        lags = np.zeros(n_fft)
        lags[:max_lag] = taper * autocovariance[:max_lag]
        lags[n_fft - max_lag + 1 :] = lags[1:max_lag][::-1]
        power = np.maximum(np.fft.rfft(lags).real, 0.0)
        weighted = lines * np.sqrt(multiplicity * power / n_fft)[:, None]
        covariances.append(weighted.real.T @ weighted.real + weighted.imag.T @ weighted.imag)
    return covariances


def _autocovariance(residual: FloatArray, noise: float) -> FloatArray:
    """Autocovariance of the gradient of the loss, (n_rows,), with the sensor noise as lower limit.

    At standstill, the residuals of a quantised angle are smaller than the noise of its encoder.
    """
    n, variance, noise_variance = len(residual), float(np.var(residual)), noise**2
    if variance == 0.0:
        return np.asarray(noise_variance * np.eye(1, n)[0])
    _, products = spectrum_and_autocovariance(residual / np.sqrt(1.0 + residual**2))
    return np.asarray(products / n * max(1.0, noise_variance / variance))
