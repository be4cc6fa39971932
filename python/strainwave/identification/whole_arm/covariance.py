"""Covariance of a fit's parameters: from its information, its residuals and its records.

Four covariances describe the error of each parameter:

- local, (J'J)^-1 of rows in standard deviations: an upper limit if the model is right, as rows are
  weighted by how long errors repeat, and those of a velocity are quick;
- sandwich: the gradients of stretches of a record are as independent as they turn out. It is right
  where errors come and go, but fifty stretches determine a variance only so well;
- steady: a sandwich of errors that are stationary in a record. A thousand rows show their spectrum,
  and so how little of quick errors a slow effect sees;
- scatter of the records, each judged by what it demands of the fit. It shows errors of the model
  that differ between experiments.

A variance is the larger one of sandwich and steady, plus what the scatter adds. Correlations are
those of steady, as a sum of parameters sees other errors than each of its terms.

The rigid model is weighted by standard deviations with a lower limit, so that the records decide.
Its errors in both sandwiches are those that the rigid step reports, and larger only where the fit
contradicts it.

None of the four shows an error of the model that is the same in every record, as of the friction
law, the drive or the plant's own integrator. Its size shows in residuals that exceed the sensors'
noise, and it does not average out over records: the share of a variance that the noise does not
explain counts once more for each record. That share is the parameter's own, by the spectra of its
derivatives, of the residuals and of the noise. The noise of a difference of rounded angles rises
with the square of the frequency, so that at the resonances an error of the model exceeds the noise
many times although it is small in the sum over all frequencies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, IntArray
from strainwave.identification.whole_arm.dataset import Dataset
from strainwave.identification.whole_arm.objective import (
    BLOCKS,
    Objective,
    Rows,
    lagged,
    lagged_products,
)
from strainwave.numerics.distributions import student_quantile
from strainwave.numerics.parallel import side_by_side

LEAST_SHARE = 1e-3
"""Of the local variance: what no record identifies shows no errors either."""

_NOTHING = 1e-30  # information of what no record shows
_LEAST_KEPT = 1e-6  # of a variance that is left in the prior's residuals
_HERMITE = {1: 0.927, 3: 0.056, 5: 0.017}
"""Shares of the variance of r (1 + r^2)^(-1/2), r standard normal, by degree; the last has all
higher ones. The slope of the loss makes quick noise a little whiter."""
_NOISE_TOLERANCE = 0.2  # share of a variance by which the noise behind it may be misjudged
_FEWEST = 3  # records that can scatter
_NORMAL = 1.96  # deviations of 95 %
_LEAST_LEFT = 1e-3  # of a gradient where one record alone identifies a parameter
_VAGUE = 0.1  # relative deviation from which a parameter is hardly identified
_SURER = 5.0  # times, that a sum must be surer than its parts to be named
_TAKES_PART = 0.2  # share of the largest component from which a parameter takes part


@dataclass(frozen=True, slots=True)
class Confidence:
    """Covariances of the parameters, each (n_unknowns, n_unknowns)."""

    combined: FloatArray
    local: FloatArray
    sandwich: FloatArray
    steady: FloatArray
    scatter: FloatArray  # NaN with fewer than three records
    prior_residual: FloatArray  # (n_prior,) whitened: the fit less what the rigid model knows
    prior_covariance: tuple[FloatArray, FloatArray]
    """Of that residual, (n_prior, n_prior), by the gradients of stretches and by steady errors."""

    @property
    def cautious(self) -> FloatArray:
        """The combined one, no variance below the local one: for evidence that something is there.

        A sandwich of few stretches may be far too sure by chance.
        """
        combined, local = np.diag(self.combined), np.diag(self.local)
        ones = np.ones_like(local)
        raised = np.sqrt(np.divide(local, combined, out=ones, where=combined > 0.0))
        raised = np.maximum(raised, 1.0)
        return np.asarray(self.combined * np.outer(raised, raised))


def confidence_of(objective: Objective, z: FloatArray) -> Confidence:
    """Covariances of the fitted parameters.

    Parameters
    ----------
    objective : Objective
        At its minimum in z.
    z : (n_unknowns,)

    Returns
    -------
    Confidence
        Correlations are those of the steady one.
    """
    noise = [
        np.minimum(1.0, record.noise / weights.deviation)
        for record, weights in zip(objective.records, objective.weights, strict=True)
    ]
    each = zip(objective.records, objective.rows(z), objective.blocks(), noise, strict=True)
    records = side_by_side([partial(_evidence, *one) for one in each])
    space, prior = objective.space, objective.space.prior
    slope = space.slope(z)
    rows, own_rows = prior.rows @ slope, space.own_prior[0] @ slope
    of_unknowns = own_rows.T @ own_rows
    known = rows.T @ rows + of_unknowns
    inverse = inverse_information(sum((record.product for record in records), known))
    bread = sum((record.curvature for record in records), known)
    unbread = inverse_information(bread)
    blocks = np.concatenate([record.gradients for record in records])
    n = len(blocks)
    high_variance = n / (n - 1.0) * blocks.T @ blocks
    left = prior.rows @ space.parameters(z) - prior.target
    larger = _contradicted(prior.errors, left, rows @ unbread, rows, high_variance)
    from_prior = larger * rows.T @ prior.errors @ rows + of_unknowns
    sandwich = unbread @ (high_variance + from_prior) @ unbread
    steady = unbread @ sum((record.steady for record in records), from_prior) @ unbread
    steady = steady + LEAST_SHARE * inverse
    scatter, pooled = _scatter(bread, known, records)
    local, sandwich, steady, scatter = (
        slope @ part @ slope.T for part in (inverse, sandwich, steady, scatter)
    )
    own, sandwiched, steadied, scattered = (
        np.diag(part) for part in (local, sandwich, steady, scatter)
    )
    n_records = len(records)
    variance = np.maximum(sandwiched, steadied)
    if n_records >= _FEWEST:
        variance = variance + _excess(own, scattered, pooled, n_records)
    variance = variance * (1.0 + n_records * _beyond_noise(slope @ unbread, records))
    ones = np.ones_like(variance)
    raised = np.sqrt(np.divide(variance, steadied, out=ones, where=steadied > 0.0))
    by_errors = sum((record.steady for record in records), np.zeros_like(known))
    expected = tuple(
        residual_covariance(prior.errors, rows @ unbread, rows, meat)
        for meat in (high_variance, by_errors)
    )
    return Confidence(
        steady * np.outer(raised, raised),
        local,
        sandwich,
        steady,
        scatter,
        left,
        (expected[0], expected[1]),
    )


def _excess(own: FloatArray, scattered: FloatArray, pooled: float, n_records: int) -> FloatArray:
    """What few records that scatter add to variances.

    A parameter's own scatter is a chi-square of few degrees: where all in all the records scatter
    as their noise says, its excess is chance. Where they scatter by far more, that is an error of
    the model, of which they are a small sample: it counts by the square of Student's t over the
    normal's, and no parameter is spared its average.
    """
    student = (student_quantile(0.975, n_records - 1) / _NORMAL) ** 2
    counted = student * (1.0 - 1.0 / pooled)
    return np.asarray(np.maximum((scattered - own) * counted, own * (pooled - 1.0) * student))


@dataclass(frozen=True, slots=True)
class _Evidence:
    """What one record says of the unknowns."""

    gradients: FloatArray  # (n_stretches, n_unknowns) of the loss
    product: FloatArray  # (n_unknowns, n_unknowns) its part of J'J
    curvature: FloatArray  # (n_unknowns, n_unknowns) how the loss bends
    steady: FloatArray  # (n_unknowns, n_unknowns) of the gradient if errors are stationary
    noise: FloatArray  # (n_unknowns, n_unknowns) the same of the sensors' noise alone


def _evidence(record: Dataset, rows: Rows, block: IntArray, noise: FloatArray) -> _Evidence:
    """Of one record, its own unknowns at their best; its sensors' noise is in deviations.

    Weights (1 + r^2)^(-1/2) give the gradient of the soft L1 loss; it bends as (1 + r^2)^(-3/2).
    """
    n_own, width = len(rows.step), rows.residual.shape[1]
    table = rows.evaluated.columns * (rows.root / rows.deviation)[..., None]
    flat = table.reshape(-1, table.shape[2])
    local, shared = flat[:, :n_own], flat[:, n_own:]
    n = shared.shape[1]
    own = np.linalg.lstsq(local, shared)[0]
    shared = shared - local @ own  # what the record's own unknowns cannot imitate
    each = shared * (rows.residual * rows.root).reshape(-1, 1)
    labels, at = np.unique(np.repeat(block, width), return_inverse=True)
    sums = np.zeros((len(labels), n))
    np.add.at(sums, at, each)
    bend = np.sqrt(1.0 + rows.residual**2)
    bent = shared / bend.reshape(-1, 1)
    columns = shared.reshape(-1, width, n) * (rows.root * bend)[..., None]
    steady, of_noise, rows_in = np.zeros((n, n)), np.zeros((n, n)), len(columns)
    for k, channel in enumerate(record.channels):
        errors = _autocovariance(rows.residual[:, k], float(noise[k]))
        own_noise = np.zeros_like(errors)
        filtered = lagged(record.kernels.taps(rate=channel.rate), record.kernels.step)[:rows_in]
        share = noise[k] ** 2 / max(float(np.var(rows.residual[:, k])), noise[k] ** 2, 1e-300)
        own_noise[: len(filtered)] = errors[0] * share * _softened(filtered / filtered[0])
        both = gradient_covariances(columns[:, k], (errors, own_noise))
        steady, of_noise = steady + both[0], of_noise + both[1]
    return _Evidence(sums, shared.T @ shared, bent.T @ bent, steady, of_noise)


def _softened(correlation: FloatArray) -> FloatArray:
    """Autocorrelations of the loss's slope r (1 + r^2)^(-1/2) for normal r of these: Hermite's."""
    return np.asarray(sum(weight * correlation**k for k, weight in _HERMITE.items()))


def gradient_covariances(
    columns: FloatArray, autocovariances: Sequence[FloatArray]
) -> list[FloatArray]:
    """Covariances of the products of columns, (n_rows, n_unknowns), with stationary errors.

    Autocovariances of the errors, (n_rows,) each from lag zero on, are tapered beyond the length of
    a stretch (Newey and West, 1987). Their power spectrum weighs that of the columns. One
    (n_unknowns, n_unknowns) for each kind of errors.
    """
    n = len(columns)
    reach = max(1, n // BLOCKS)
    around = 2 * ((n + reach + 1) // 2)
    taper = 1.0 - np.arange(reach) / reach
    twice = np.full(around // 2 + 1, 2.0)  # lines above and below zero
    twice[[0, -1]] = 1.0
    lines = np.fft.rfft(columns, around, axis=0)
    covariances = []
    for autocovariance in autocovariances:
        lags = np.zeros(around)
        lags[:reach] = taper * autocovariance[:reach]
        lags[around - reach + 1 :] = lags[1:reach][::-1]
        power = np.maximum(np.fft.rfft(lags).real, 0.0)
        weighted = lines * np.sqrt(twice * power / around)[:, None]
        covariances.append(weighted.real.T @ weighted.real + weighted.imag.T @ weighted.imag)
    return covariances


def _autocovariance(residual: FloatArray, noise: float) -> FloatArray:
    """Of the loss's slope: (n_rows,). Errors count as no smaller than the sensor's noise.

    That of a motor at standstill is more than what they show.
    """
    n, size, least = len(residual), float(np.var(residual)), noise**2
    if size == 0.0:
        return np.asarray(least * np.eye(1, n)[0])
    _, lagged = lagged_products(residual / np.sqrt(1.0 + residual**2))
    return np.asarray(lagged / n * max(1.0, least / size))


def _contradicted(
    errors: FloatArray, left: FloatArray, answer: FloatArray, rows: FloatArray, meat: FloatArray
) -> float:
    """How many times larger the prior's residuals are than its errors explain, in squares.

    A mean over all rows, never less than one.
    """
    if not len(left):
        return 1.0
    expected = np.diag(residual_covariance(errors, answer, rows, meat))
    expected = np.maximum(expected, _LEAST_KEPT * np.diag(errors))
    return max(1.0, float(np.mean(left**2 / expected)))


def residual_covariance(
    errors: FloatArray, answer: FloatArray, rows: FloatArray, meat: FloatArray
) -> FloatArray:
    """Covariance of the prior's residuals at the fit's minimum.

    The fit answers errors e of the prior, whose rows are G, and gradients g of the records by
    B (G' e + g), B the inverse of all information: of e it leaves (I - G B G') e - G B g. So the
    fit's having followed the prior is counted. Were both efficient, it would be the prior's
    covariance less that of the combination.

    Parameters
    ----------
    errors : (n_prior, n_prior)
        Covariance of e.
    answer : (n_prior, n_unknowns)
        G B.
    rows : (n_prior, n_unknowns)
        G.
    meat : (n_unknowns, n_unknowns)
        Covariance of g.

    Returns
    -------
    (n_prior, n_prior)
    """
    kept = np.eye(len(rows)) - answer @ rows.T
    return np.asarray(kept @ errors @ kept.T + answer @ meat @ answer.T)


def _beyond_noise(answer: FloatArray, records: Sequence[_Evidence]) -> FloatArray:
    """The share of each parameter's variance that the sensors' noise does not explain.

    `answer` is the derivative of the parameters by the gradient, (n_unknowns, n_unknowns).
    """
    shown, noise = (
        np.einsum("ij,jk,ik->i", answer, sum(parts, np.zeros_like(answer)), answer)
        for parts in zip(*((record.steady, record.noise) for record in records), strict=True)
    )
    explained = np.divide(noise, shown, out=np.ones_like(shown), where=shown > 0.0)
    return np.asarray(np.maximum(0.0, 1.0 - explained - _NOISE_TOLERANCE))


def _scatter(
    whole: FloatArray, known: FloatArray, records: Sequence[_Evidence]
) -> tuple[FloatArray, float]:
    """Covariance of the fit from the gradients of whole records, and their average excess.

    A fit bends to each record, the more the larger its leverage A = L^-1 P L^-T, L L' all
    information and P the record's own: of a gradient's variance A a share I - A is left. It is
    raised by (I - A)^(-1/2), after which a right model makes the scatter the local covariance
    (Bell and McCaffrey, 2002). A jackknife raises it by (I - A)^-1, which for a parameter that one
    record identifies is beyond all bounds. The average excess is the mean square of the raised
    gradients over all records and directions, beside what is expected; never less than one. The
    prior counts as it does in the local covariance, beside which the scatter is set.
    """
    if len(records) < _FEWEST:
        return np.full_like(whole, np.nan), 1.0
    unscale = _root_of(inverse_information(whole))  # L^-T, whose square is the inverse
    meat = unscale.T @ known @ unscale
    squares = expected = 0.0
    for record in records:
        leverage, vectors = np.linalg.eigh(unscale.T @ record.curvature @ unscale)
        left = np.sqrt(np.maximum(1.0 - leverage, _LEAST_LEFT))
        gradient = record.gradients.sum(axis=0)
        raised = vectors @ (vectors.T @ (unscale.T @ gradient) / left)
        meat = meat + np.outer(raised, raised)
        squares += float(raised @ raised)
        expected += float(np.sum(leverage))
    return np.asarray(unscale @ meat @ unscale.T), max(1.0, squares / max(expected, 1e-300))


def _root_of(covariance: FloatArray) -> FloatArray:
    """L with L L' = covariance."""
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def inverse_information(information: FloatArray) -> FloatArray:
    """Inverse by the eigenvalues of the scaled matrix; what is not identified is very uncertain.

    Parameters
    ----------
    information : (n_unknowns, n_unknowns)

    Returns
    -------
    (n_unknowns, n_unknowns)
    """
    scale = np.sqrt(np.diag(information))
    scale[scale == 0.0] = _NOTHING
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    values = np.maximum(values, 1e-13 * values[-1])
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


def only_together(
    names: Sequence[str], values: FloatArray, covariance: FloatArray
) -> Iterator[tuple[tuple[str, ...], float]]:
    """Groups of parameters of which the data identify only a combination.

    Parameters
    ----------
    names : sequence of str
    values : (n,)
    covariance : (n, n)

    Yields
    ------
    names : tuple of str
        Of the parameters that trade off against each other.
    deviation : float
        Their relative standard deviation along that direction.
    """
    size = np.where(values == 0.0, 1.0, np.abs(values))
    relative = covariance / np.outer(size, size)
    spread, directions = np.linalg.eigh(relative)
    for variance, direction in zip(spread[::-1], directions.T[::-1], strict=True):
        deviation = float(np.sqrt(max(variance, 0.0)))
        if deviation < _VAGUE:
            return
        takes_part = np.abs(direction) > _TAKES_PART * np.max(np.abs(direction))
        part = np.flatnonzero(takes_part)
        if len(part) < 2:
            continue
        # alone each must be much vaguer than with the others held
        information = np.linalg.pinv(relative[np.ix_(part, part)], hermitian=True)
        alone = np.sqrt(np.diag(relative)[part])
        held = 1.0 / np.sqrt(np.diag(information))
        if np.min(alone / held) > _SURER:
            yield tuple(names[int(k)] for k in part), deviation
