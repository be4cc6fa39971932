"""Covariance of the whole-arm fit.

Four covariances describe the error of each parameter:

- local, (J'J)^-1, with the rows of J in standard deviations. The rows are weighted by the
  correlation time of the errors. The errors of a velocity decorrelate quickly, so for a correct
  model this is an upper bound;
- sandwich, from the gradients of segments of each record. It is valid for nonstationary errors, but
  about 50 segments estimate a variance only roughly;
- steady, a sandwich for errors that are stationary within a record. About 1,000 rows determine
  their spectrum, so it resolves how slow effects average quick errors;
- scatter, from the gradients of whole records. It includes model errors that differ between
  experiments.

The variance within records is the larger of sandwich and steady. Correlations are those of the
steady covariance, because a combination of parameters depends on other errors than its terms. What
follows is added as model error.

The rows of the rigid model are weighted by standard deviations with a lower limit, so that the
records dominate. Both sandwiches use the errors that the rigid step reports. They are scaled up
only if the fit contradicts the rigid model.

None of the four includes a model error that is the same in every record, such as an error of the
friction law, of the drive, or of the integrator. Such an error appears as a residual above the
sensor noise, and it does not average out over records. The share of a variance that noise does not
explain is therefore counted once more for each record. This share depends on the parameter: it
follows from the spectra of its derivatives, of the residuals and of the noise. The noise of a
differentiated, quantised angle rises with the square of the frequency. At the resonances, a model
error can thus exceed the noise many times although its share in the total power is small. A model
error depends on the same motion as the derivatives, so neither spectra nor segments show how far it
averages out: its share of the variance is at least that of the local one.

Two engines differ by 1e-4 of an inertia or stiffness, however small the noise: no standard
deviation of an unknown without sign is smaller. Base parameters of chains are signed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np

from strainwave.domain import FloatArray, IntArray
from strainwave.domain.results.distributions import CI95_STDS, student_quantile
from strainwave.identification.whole_arm.problem.objective import BLOCKS_PER_RECORD, Objective
from strainwave.identification.whole_arm.problem.weighted_rows import Rows, noise_autocovariances
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.search import Fit
from strainwave.numerics.filters import fast_length
from strainwave.numerics.spectra import spectrum_and_autocovariance

MIN_VARIANCE_SHARE = 1e-3
"""Share of the local variance that is added to the steady variance.

Residuals contain no errors of parameters that no record identifies.
"""

SIMULATION_ERROR = 1e-4
"""Standard deviation of an unknown without sign by errors of simulations, relative to its value."""

_MIN_INFORMATION = 1e-30  # information of a parameter that no record depends on
_MIN_VARIANCE_RATIO = 1e-6  # lower limit of a variance of prior residuals, relative to the prior
_NOISE_TOLERANCE = 0.2  # relative uncertainty of the sensor-noise part of a variance
_MIN_RECORDS = 3  # minimum number of records for the scatter
_MIN_REMAINING = 1e-3  # lower limit of 1 - leverage; near 0, one record identifies a parameter


@dataclass(frozen=True, slots=True)
class Confidence:
    """Covariances of the parameters, each (n_unknowns, n_unknowns)."""

    combined: FloatArray
    local: FloatArray
    sandwich: FloatArray
    steady: FloatArray
    scatter: FloatArray  # NaN with fewer than `_MIN_RECORDS` records
    prior_residual: FloatArray  # (n_prior,) whitened: fit minus rigid model
    prior_covariance: tuple[FloatArray, FloatArray]
    """Covariances of that residual, (n_prior, n_prior): by segment gradients, by steady errors."""

    @property
    def cautious(self) -> FloatArray:
        """Combined covariance with the local variances as lower limit, for significance tests.

        A sandwich of few segments can be far too small by chance.
        """
        variances = np.maximum(np.diag(self.local), np.diag(self.combined))
        return with_variances(self.combined, variances)


def with_variances(covariance: FloatArray, variances: FloatArray) -> FloatArray:
    """The correlations of a covariance with other variances; zero variances stay."""
    own = np.diag(covariance)
    scale = np.sqrt(np.divide(variances, own, out=np.ones_like(own), where=own > 0.0))
    return np.asarray(covariance * np.outer(scale, scale))


_computed: WeakKeyDictionary[Fit, Confidence] = WeakKeyDictionary()


def confidence_of(fit: Fit) -> Confidence:
    """Covariances of the unknowns of a fit, computed once."""
    if fit not in _computed:
        _computed[fit] = confidence_at(fit.objective, fit.z)
    return _computed[fit]


def confidence_at(objective: Objective, z: FloatArray) -> Confidence:
    """Covariances of the unknowns at a minimum.

    `z`, (n_unknowns,), minimises `objective`.
    """
    blocks_of_rows = objective.blocks()

    def evidence(k: int, rows: Rows) -> RecordGradients:
        record = objective.records[k]
        noise = np.minimum(1.0, record.noise / objective.weights[k].stds)
        return evidence_of(record, rows, blocks_of_rows[k], noise)

    records = objective.map_rows(z, evidence)
    space, prior, n_records = objective.space, objective.space.prior, len(records)
    slope = space.slope(z)
    rows, own_rows = prior.rows @ slope, space.own_prior[0] @ slope
    own_information = own_rows.T @ own_rows
    known = rows.T @ rows + own_information
    inverse = inverse_information(sum((record.product for record in records), known))
    bread = sum((record.curvature for record in records), known)
    answer = inverse_information(bread)
    blocks = np.concatenate([record.gradients for record in records])
    segment_meat = len(blocks) / (len(blocks) - 1.0) * blocks.T @ blocks
    steady_meat = sum((record.steady for record in records), np.zeros_like(known))
    residual = prior.rows @ space.parameters(z) - prior.target
    scale = _prior_scale(prior.errors, residual, rows @ answer, rows, segment_meat)
    prior_meat = scale * rows.T @ prior.errors @ rows + own_information
    scatter, pooled = _scatter(bread, known, records)
    local, sandwich, steady, scatter = (
        slope @ part @ slope.T
        for part in (
            inverse,
            answer @ (segment_meat + prior_meat) @ answer,
            answer @ (steady_meat + prior_meat) @ answer + MIN_VARIANCE_SHARE * inverse,
            scatter,
        )
    )
    variance = np.maximum(np.diag(sandwich), np.diag(steady))
    unexplained = _unexplained_share(slope @ answer, records)
    raised = variance + unexplained * np.maximum(np.diag(local) - variance, 0.0)
    model_error = raised - variance + n_records * unexplained * raised
    if n_records >= _MIN_RECORDS:
        # the scatter of one parameter has few degrees of freedom, so the excess of a variance is
        # scaled by the squared ratio of the quantiles of Student's t and the normal distribution;
        # if the pooled scatter agrees with the noise, the excess is chance
        quantile_ratio = (student_quantile(0.975, n_records - 1) / CI95_STDS) ** 2
        excess = np.maximum(np.diag(scatter) - raised, 0.0) * quantile_ratio
        model_error = model_error + excess * (1.0 - 1.0 / pooled)
    is_positive = np.array([not unknown.signed for unknown in space.unknowns])
    values = np.where(is_positive, space.parameters(z), 0.0)
    model_error = model_error + (SIMULATION_ERROR * values) ** 2
    by_segments, by_steady_errors = (
        residual_covariance(prior.errors, rows @ answer, rows, meat)
        for meat in (segment_meat, steady_meat)
    )
    return Confidence(
        with_variances(steady, variance + model_error),
        local,
        sandwich,
        steady,
        scatter,
        residual,
        (by_segments, by_steady_errors),
    )


def _prior_scale(
    errors: FloatArray, residual: FloatArray, answer: FloatArray, rows: FloatArray, meat: FloatArray
) -> float:
    """Mean ratio of squared prior residuals to their expectation; at least 1."""
    if not len(residual):
        return 1.0
    expected = np.diag(residual_covariance(errors, answer, rows, meat))
    expected = np.maximum(expected, _MIN_VARIANCE_RATIO * np.diag(errors))
    return max(1.0, float(np.mean(residual**2 / expected)))


def residual_covariance(
    errors: FloatArray, answer: FloatArray, rows: FloatArray, meat: FloatArray
) -> FloatArray:
    """Covariance of the prior residuals at the minimum of the fit.

    Errors e of the prior with rows G, and gradients g of the records, shift the fit by
    B (G' e + g), where B is the inverse of the total information. The prior residual is
    (I - G B G') e - G B g, which includes the correlation of fit and prior. If both are efficient,
    this is the covariance of the prior minus that of the combination.

    `errors`, (n_prior, n_prior), is the covariance of e; `answer` is G B and `rows` is G, both
    (n_prior, n_unknowns); `meat`, (n_unknowns, n_unknowns), is the covariance of g. Returns
    (n_prior, n_prior).
    """
    remaining = np.eye(len(rows)) - answer @ rows.T
    return np.asarray(remaining @ errors @ remaining.T + answer @ meat @ answer.T)


def _unexplained_share(answer: FloatArray, records: Sequence[RecordGradients]) -> FloatArray:
    """Share of the variance of each parameter that sensor noise does not explain.

    `answer`, (n_unknowns, n_unknowns), is the derivative of the parameters by the gradient.
    """
    total, noise = (
        np.einsum("ij,jk,ik->i", answer, sum(parts, np.zeros_like(answer)), answer)
        for parts in zip(*((record.steady, record.noise) for record in records), strict=True)
    )
    explained = np.divide(noise, total, out=np.ones_like(total), where=total > 0.0)
    return np.asarray(np.maximum(0.0, 1.0 - explained - _NOISE_TOLERANCE))


def _scatter(
    whole: FloatArray, known: FloatArray, records: Sequence[RecordGradients]
) -> tuple[FloatArray, float]:
    """Covariance of the fit from the gradients of whole records, and the pooled excess.

    With the leverage A = L^-1 P L^-T of a record, L L' the total information and P that of the
    record, the fit reduces the variance A of its gradient by the factor I - A. The gradient is
    multiplied by (I - A)^(-1/2), so that for a correct model the scatter equals the local
    covariance (Bell and McCaffrey, 2002). A jackknife uses (I - A)^-1, which is unbounded for a
    parameter that only one record identifies. The pooled excess is the mean square of the corrected
    gradients over all records and directions, relative to its expectation; it is at least 1. The
    prior contributes as in the local covariance.
    """
    if len(records) < _MIN_RECORDS:
        return np.full_like(whole, np.nan), 1.0
    inverse = inverse_information(whole)
    scale = np.sqrt(np.diag(inverse))
    values, vectors = np.linalg.eigh(inverse / np.outer(scale, scale))
    unscale = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))  # L^-T
    meat = unscale.T @ known @ unscale
    squares = expected = 0.0
    for record in records:
        leverage, vectors = np.linalg.eigh(unscale.T @ record.curvature @ unscale)
        root_remaining = np.sqrt(np.maximum(1.0 - leverage, _MIN_REMAINING))
        gradient = record.gradients.sum(axis=0)
        corrected = vectors @ (vectors.T @ (unscale.T @ gradient) / root_remaining)
        meat = meat + np.outer(corrected, corrected)
        squares += float(corrected @ corrected)
        expected += float(np.sum(leverage))
    return np.asarray(unscale @ meat @ unscale.T), max(1.0, squares / max(expected, 1e-300))


def inverse_information(information: FloatArray) -> FloatArray:
    """Regularised inverse of an information matrix, (n_unknowns, n_unknowns).

    Uses the eigenvalues of the matrix scaled to unit diagonal, with a lower limit. Parameters that
    are not identifiable have very large variances.
    """
    scale = np.sqrt(np.diag(information))
    scale[scale == 0.0] = _MIN_INFORMATION
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    values = np.maximum(values, 1e-13 * values[-1])
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


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
    table = rows.shared_columns
    width, n = table.shape[1:]
    shared = table.reshape(-1, n)
    weighted_residual = (rows.residual * rows.root).ravel()
    starts = [*np.flatnonzero(np.diff(block, prepend=-1)) * width, len(shared)]
    segments = (slice(*ends) for ends in pairwise(starts))  # of consecutive rows
    sums = np.array([weighted_residual[one] @ shared[one] for one in segments])
    robust_scale = np.sqrt(1.0 + rows.residual**2)
    product = shared.T @ shared
    scaled = shared / robust_scale.reshape(-1, 1)
    curvature = scaled.T @ scaled
    np.multiply(shared, (rows.root * robust_scale).reshape(-1, 1), out=scaled)
    columns = scaled.reshape(-1, width, n)
    steady, of_noise, rows_in = np.zeros((n, n)), np.zeros((n, n)), len(columns)
    for k, lags in enumerate(noise_autocovariances(record)):
        errors = _autocovariance(rows.residual[:, k], float(noise[k]))
        own_noise, correlation = np.zeros_like(errors), lags[:rows_in] / lags[0]
        share = noise[k] ** 2 / max(float(np.var(rows.residual[:, k])), noise[k] ** 2, 1e-300)
        of_loss = sum(weight * correlation**degree for degree, weight in _HERMITE_SHARES.items())
        own_noise[: len(correlation)] = errors[0] * share * of_loss
        covariances = gradient_covariances(columns[:, k], (errors, own_noise))
        steady, of_noise = steady + covariances[0], of_noise + covariances[1]
    return RecordGradients(sums, product, curvature, steady, of_noise)


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
    n_fft = fast_length(n + max_lag)
    taper = 1.0 - np.arange(max_lag) / max_lag
    multiplicity = np.full(n_fft // 2 + 1, 2.0)  # positive and negative frequencies
    multiplicity[[0, -1]] = 1.0
    lines = np.fft.rfft(columns, n_fft, axis=0)
    parts = np.concatenate([lines.real, lines.imag])
    covariances = []
    for autocovariance in autocovariances:
        lags = np.zeros(n_fft)
        lags[:max_lag] = taper * autocovariance[:max_lag]
        lags[n_fft - max_lag + 1 :] = lags[1:max_lag][::-1]
        power = np.maximum(np.fft.rfft(lags).real, 0.0)
        weighted = parts * np.tile(np.sqrt(multiplicity * power / n_fft), 2)[:, None]
        covariances.append(weighted.T @ weighted)
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
