"""How sure a fit's parameters are: what its own noise, its stretches and its records say.

Four covariances describe each parameter's deviation:

- local, (J'J)^-1 of rows in deviations: an upper end if the model is right, as rows are weighed by
  how slow errors repeat, and those of a velocity are quick;
- sandwich, in which stretches of a record are as independent as they show themselves: right where
  errors come and go, or go on for longer than the rows' weights allow for; but some fifty stretches
  know a variance only so well;
- steady, a sandwich of errors that are alike from a record's first row to its last: a thousand rows
  show how each channel's repeat, and so how little of quick ones a slow effect sees;
- scatter of the records, each judged by what it wants of the fit: it sees what is wrong with the
  model in different ways in different experiments.

A variance is the larger one of both sandwiches, with what the scatter adds to it. Correlations are
those of the steady one, as a sum of parameters sees other errors than each of them: that of a
joint's viscous frictions is slow, and what is slow is better known than the rows' weights say.

What the rigid step knows is weighed by deviations that are never small, so that the records have
the last word. That makes its errors no larger: in both sandwiches they are what the rigid step
reports, and more only where the fit contradicts it.

None of them sees what is wrong with the model in the same way everywhere. Its size shows all the
same, as residuals larger than the sensors' own noise explains. Such an error does not average away
over the records: the share of a variance that the noise surely does not explain is counted once
more as if all records had it in common, which is as often as there are records.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, IntArray
from strainwave.identification.whole_arm.objective import BLOCKS, Objective, Rows, lagged_products
from strainwave.numerics.distributions import student_quantile
from strainwave.numerics.parallel import side_by_side

LEAST_SHARE = 1e-3
"""Of the local variance: what no record identifies shows no errors either."""

_NOTHING = 1e-30  # information of what no record shows
_LEAST_KEPT = 1e-6  # of a variance that is left in the prior's residuals
_UNSURE = 0.2  # share of a variance by which the noise behind it may be misjudged
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
    each = zip(objective.rows(z), objective.blocks(), noise, strict=True)
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
    products = [record.product for record in records]
    variance = variance * (1.0 + n_records * _beyond_noise(objective, z, products, inverse))
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
    steady: FloatArray  # (n_unknowns, n_unknowns) of the gradient, its errors alike throughout


def _evidence(rows: Rows, block: IntArray, noise: FloatArray) -> _Evidence:
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
    return _Evidence(sums, shared.T @ shared, bent.T @ bent, _steady(columns, rows.residual, noise))


def _steady(columns: FloatArray, residual: FloatArray, noise: FloatArray) -> FloatArray:
    """Covariance of a record's gradient if each channel's errors are alike in all its rows.

    Autocovariances up to a stretch's length, tapered (Newey and West, 1987), make a power spectrum,
    which weighs the columns' own.
    """
    found = np.zeros((columns.shape[2], columns.shape[2]))
    for k in range(columns.shape[1]):
        found += gradient_covariance(
            columns[:, k], _autocovariance(residual[:, k], float(noise[k]))
        )
    return found


def gradient_covariance(columns: FloatArray, autocovariance: FloatArray) -> FloatArray:
    """Covariance of columns' products with stationary errors, whose spectrum weighs the columns'.

    Parameters
    ----------
    columns : (n_rows, n_unknowns)
    autocovariance : (n_rows,)
        Of the errors, from lag zero on; tapered beyond a stretch's length.

    Returns
    -------
    (n_unknowns, n_unknowns)
    """
    n = len(columns)
    reach = max(1, n // BLOCKS)
    around = 2 * ((n + reach + 1) // 2)
    taper = 1.0 - np.arange(reach) / reach
    twice = np.full(around // 2 + 1, 2.0)  # lines above and below zero
    twice[[0, -1]] = 1.0
    lags = np.zeros(around)
    lags[:reach] = taper * autocovariance[:reach]
    lags[around - reach + 1 :] = lags[1:reach][::-1]
    power = np.maximum(np.fft.rfft(lags).real, 0.0)
    lines = np.fft.rfft(columns, around, axis=0)
    lines *= np.sqrt(twice * power / around)[:, None]
    return np.asarray(lines.real.T @ lines.real + lines.imag.T @ lines.imag)


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


def _beyond_noise(
    objective: Objective, z: FloatArray, products: Sequence[FloatArray], inverse: FloatArray
) -> FloatArray:
    """The share of each local variance that the sensors' noise does not explain."""
    excess = np.zeros_like(inverse)
    for share, product in zip(objective.noise_shares(z), products, strict=True):
        excess += max(0.0, 1.0 - share - _UNSURE) * product
    return np.asarray(np.diag(inverse @ excess @ inverse) / np.diag(inverse))


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
