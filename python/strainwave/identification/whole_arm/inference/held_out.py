"""Held-out prediction: the scores by which fits of the same records are compared.

In-sample costs favour the model with more parameters, and their chi squares assume that the
residuals are noise. Folds are stretches longer than ten correlation times of the residuals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import FloatArray, IntArray
from strainwave.identification.whole_arm.problem.objective import BLOCKS_PER_RECORD
from strainwave.identification.whole_arm.problem.weighted_rows import Rows
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.numerics.correlations import estimate_rows_per_error
from strainwave.numerics.held_out import MIN_CORRELATION_TIMES, log_density
from strainwave.numerics.linalg import triangular_factor

_MIN_FOLDS = 2  # of a record; the other folds estimate the variance of a channel


def held_out_scores(fits: Sequence[Fit]) -> FloatArray:
    """Log predictive densities of fits of the same records, (n_fits, n_folds).

    log p(fold) = -n / (2 kappa) [ln s^2 + RSS / (n s^2)], summed over the channels of the fold. s^2
    is the variance in the other folds of the record, and kappa the number of rows per independent
    residual, the largest of the fits. The parameters without a fold are one Gauss-Newton step from
    the fit: the least squares solution of the factors of the other folds, stacked.
    """
    rows = [fit.objective.rows(fit.z) for fit in fits]
    correlation = [
        np.max([[estimate_rows_per_error(e) for e in one.errors.T] for one in of_record], axis=0)
        for of_record in zip(*rows, strict=True)
    ]
    folds = [
        _folds(len(of_fit.residual), float(np.max(kappa)))
        for of_fit, kappa in zip(rows[0], correlation, strict=True)
    ]
    return np.array(
        [_scores(fit, own, folds, correlation) for fit, own in zip(fits, rows, strict=True)]
    )


def _folds(n_rows: int, rows_per_error: float) -> IntArray:
    """Number of the fold of each row of a record, (n_rows,)."""
    n_folds = int(n_rows / (MIN_CORRELATION_TIMES * rows_per_error))
    n_folds = min(max(n_folds, _MIN_FOLDS), BLOCKS_PER_RECORD)
    return np.arange(n_rows) * n_folds // n_rows


def _scores(
    fit: Fit, rows: Sequence[Rows], folds: Sequence[IntArray], correlation: Sequence[FloatArray]
) -> FloatArray:
    """Log predictive densities of the folds of all records, (n_folds,)."""
    columns = [_shared_columns(one) for one in rows]
    parts = [
        (k, fold == number) for k, fold in enumerate(folds) for number in range(int(fold[-1]) + 1)
    ]
    factors = []
    for k, held in parts:
        weighted = columns[k][held] * rows[k].root[held][..., None]
        residual = (rows[k].residual * rows[k].root)[held][..., None]
        table = np.concatenate([weighted, residual], axis=2)
        factors.append(triangular_factor(table.reshape(-1, table.shape[2])))
    prior = np.column_stack(fit.space.linearise_prior(fit.z))
    predicted = [np.zeros_like(one.residual) for one in rows]
    for number, (k, held) in enumerate(parts):
        others = np.concatenate([prior, *factors[:number], *factors[number + 1 :]])
        step = np.linalg.lstsq(others[:, :-1], -others[:, -1])[0]
        predicted[k][held] = (rows[k].residual[held] + columns[k][held] @ step) * rows[k].stds
    scores = []
    for k, held in parts:
        squares = predicted[k] ** 2
        held_out, variance = np.mean(squares[held], axis=0), np.mean(squares[~held], axis=0)
        count = np.sum(held) / correlation[k]
        scores.append(float(np.sum(log_density(held_out, variance, count))))
    return np.array(scores)


def _shared_columns(rows: Rows) -> FloatArray:
    """Derivatives of the residuals in standard deviations by the shared unknowns.

    They are orthogonal to the record parameters, as those of the weighted rows. Their shape is
    (n_rows, n_channels, n_unknowns).
    """
    table, n = rows.columns, rows.evaluated.n_initial
    flat = table.reshape(-1, table.shape[2])
    shared = flat[:, n:]
    if n:
        shared = shared - flat[:, :n] @ np.linalg.lstsq(flat[:, :n], shared)[0]
    return np.asarray(shared.reshape(*table.shape[:2], -1) / rows.root[..., None])
