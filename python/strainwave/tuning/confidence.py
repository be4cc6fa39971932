"""How sure a fit's parameters are: what its own noise, its stretches and its records say.

Three covariances go into each parameter's deviation:

- local, (J'J)^-1 of rows in deviations: an upper end if the model is right, as rows are weighed by
  how slow errors repeat, and those of a velocity are quick; a quarter of its variance is the least;
- sandwich, in which stretches of a record are as independent as they show themselves: right where
  errors go on for longer than the rows' weights allow for;
- scatter of the records, each judged by what it wants of the fit: it sees what is wrong with the
  model in different ways in different experiments.

None of them sees what is wrong with the model in the same way everywhere. Its size shows all the
same, as residuals larger than the sensors' own noise explains. Such an error does not average away
over the records: the share of a variance that the noise surely does not explain is counted once
more as if all records had it in common, which is as often as there are records.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.distributions import student_quantile
from strainwave.records import FloatArray
from strainwave.tuning.misfit import Misfit

_NOTHING = 1e-30  # information of what no record tells of
_LEAST_SHARE = 0.25  # of the local variance: a sandwich of some fifty stretches is uncertain
_UNSURE = 0.2  # share of a variance by which the noise behind it may be misjudged
_FEWEST = 3  # records that can scatter
_NORMAL = 1.96  # deviations of 95 %
_LEAST_LEFT = 1e-3  # of a gradient where one record alone tells a parameter
_VAGUE = 0.1  # relative deviation from which a parameter is hardly told
_SURER = 5.0  # times, that a sum must be surer than its parts to be named
_TAKES_PART = 0.2  # share of the largest component from which a parameter takes part


@dataclass(frozen=True, slots=True)
class Confidence:
    """Covariances of the parameters, each (n_unknowns, n_unknowns)."""

    combined: FloatArray
    local: FloatArray
    sandwich: FloatArray
    scatter: FloatArray  # NaN with fewer than three records

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


def confidence_of(misfit: Misfit, z: FloatArray) -> Confidence:
    """Covariances of the fitted parameters.

    Parameters
    ----------
    misfit : Misfit
        At its minimum in z.
    z : (n_unknowns,)

    Returns
    -------
    Confidence
        Correlations are those of the local one.
    """
    scores, products, curvatures = _scores(misfit, z)
    prior = misfit.search.prior.rows @ misfit.search.slope(z)
    known = prior.T @ prior
    whole = np.sum(products, axis=0) + known
    inverse = _inverse(whole)
    blocks = np.concatenate(scores)
    n = len(blocks)
    bread = np.sum(curvatures, axis=0) + known
    sandwich = _inverse(bread) @ (n / (n - 1.0) * blocks.T @ blocks + known) @ _inverse(bread)
    gradients = [block.sum(axis=0) for block in scores]
    scatter, pooled = _scatter(bread, known, curvatures, gradients)
    slope = misfit.search.slope(z)
    parts = [slope @ part @ slope.T for part in (inverse, sandwich, scatter)]
    own, sandwiched, scattered = (np.diag(part) for part in parts)
    n_records = len(misfit.records)
    variance = np.maximum(sandwiched, _LEAST_SHARE * own)
    if n_records >= _FEWEST:
        variance = variance + _excess(own, scattered, pooled, n_records)
    variance = variance * (1.0 + n_records * _beyond_noise(misfit, products, inverse))
    raised = np.sqrt(np.divide(variance, own, out=np.ones_like(own), where=own > 0.0))
    return Confidence(parts[0] * np.outer(raised, raised), *parts)


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


def _scores(
    misfit: Misfit, z: FloatArray
) -> tuple[list[FloatArray], list[FloatArray], list[FloatArray]]:
    """Each record's gradients, stretch by stretch, its part of J'J, and the loss's curvature.

    Weights (1 + r^2)^(-1/2) give the gradient of the soft L1 loss; it bends as (1 + r^2)^(-3/2).
    """
    scores, products, curvatures = [], [], []
    for rows, block in zip(misfit.rows(z), misfit.blocks(), strict=True):
        n = rows.shared.shape[2]
        table = np.concatenate([rows.local, rows.shared], axis=2) * rows.root[..., None]
        width = table.shape[1]
        flat = table.reshape(-1, table.shape[2])
        local, shared = flat[:, :-n], flat[:, -n:]
        own = np.linalg.lstsq(local, shared)[0]
        shared = shared - local @ own  # what the record's own unknowns cannot imitate
        each = shared * (rows.residual * rows.root).reshape(-1, 1)
        labels, at = np.unique(np.repeat(block, width), return_inverse=True)
        sums = np.zeros((len(labels), n))
        np.add.at(sums, at, each)
        scores.append(sums)
        products.append(shared.T @ shared)
        bent = shared / np.sqrt(1.0 + rows.residual.reshape(-1, 1) ** 2)
        curvatures.append(bent.T @ bent)
    return scores, products, curvatures


def _beyond_noise(
    misfit: Misfit, products: Sequence[FloatArray], inverse: FloatArray
) -> FloatArray:
    """The share of each local variance that the sensors' noise does not explain."""
    excess = np.zeros_like(inverse)
    for share, product in zip(misfit.noise_shares(), products, strict=True):
        excess += max(0.0, 1.0 - share - _UNSURE) * product
    return np.asarray(np.diag(inverse @ excess @ inverse) / np.diag(inverse))


def _scatter(
    whole: FloatArray,
    known: FloatArray,
    products: Sequence[FloatArray],
    gradients: Sequence[FloatArray],
) -> tuple[FloatArray, float]:
    """Covariance of the fit from the gradients of whole records, and their average excess.

    A fit bends to each record, the more the larger its leverage A = L^-1 P L^-T, L L' all
    information and P the record's own: of a gradient's variance A a share I - A is left. It is
    raised by (I - A)^(-1/2), after which a right model makes the scatter the local covariance
    (Bell and McCaffrey, 2002). A jackknife raises it by (I - A)^-1, which for a parameter that one
    record alone tells is beyond all bounds. The average excess is the mean square of the raised
    gradients over all records and directions, beside what is expected; never less than one.
    """
    if len(products) < _FEWEST:
        return np.full_like(whole, np.nan), 1.0
    unscale = _root_of(_inverse(whole))  # L^-T, whose square is the inverse
    meat = unscale.T @ known @ unscale
    squares = expected = 0.0
    for own, gradient in zip(products, gradients, strict=True):
        leverage, vectors = np.linalg.eigh(unscale.T @ own @ unscale)
        left = np.sqrt(np.maximum(1.0 - leverage, _LEAST_LEFT))
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


def _inverse(information: FloatArray) -> FloatArray:
    """Inverse by the eigenvalues of the scaled matrix; what nothing tells of is very uncertain."""
    scale = np.sqrt(np.diag(information))
    scale[scale == 0.0] = _NOTHING
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    values = np.maximum(values, 1e-13 * values[-1])
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


def only_together(
    names: Sequence[str], values: FloatArray, covariance: FloatArray
) -> Iterator[tuple[tuple[str, ...], float]]:
    """Groups of parameters that the data tell only together.

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
