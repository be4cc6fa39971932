"""Comparison of models by their predictions of data that their estimates do not use.

In-sample costs favour the model with more parameters, and their chi squares assume that the
residuals are noise. Folds are stretches longer than ten correlation times of the residuals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import FloatArray

MIN_CORRELATION_TIMES = 10.0
"""Minimum length of a fold in correlation times of the residuals."""

MIN_WEIGHT = 0.95
"""Weight from which a model with more parameters replaces one with fewer."""

_DRAWS = 1000  # of the Bayesian bootstrap


def log_density(
    mean_square: FloatArray, variance: FloatArray, count: FloatArray, others: FloatArray
) -> FloatArray:
    """Log predictive density of normal errors, but for a constant of the counts.

        - n / 2 ln s^2 - (n + m) / 2 ln(1 + n mean square / (m s^2))

    `variance` s^2 is the mean square in other folds; `count` n and `others` m are the numbers of
    independent errors in both. With many others it is - n / 2 (ln s^2 + mean square / s^2); with
    few, their variance is uncertain, and no single fold decides (Student's t).
    """
    tiny = np.finfo(float).tiny
    log_variance = np.log(np.maximum(variance, tiny))
    log_ratio = np.log(np.maximum(count * mean_square, tiny)) - log_variance
    ratio = np.logaddexp(0.0, log_ratio - np.log(np.maximum(others, tiny)))
    return np.asarray(-0.5 * (count * log_variance + (count + others) * ratio))


def model_weights(scores: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Weights (n_models,) of models by pseudo-BMA+ (Yao, Vehtari, Simpson and Gelman, 2018).

    `scores` (n_models, n_folds) are log predictive densities. A Bayesian bootstrap over the folds
    keeps a single fold from deciding.
    """
    n = scores.shape[1]
    totals = n * rng.dirichlet(np.ones(n), _DRAWS) @ scores.T
    likelihoods = np.exp(totals - totals.max(axis=1, keepdims=True))
    return np.asarray(np.mean(likelihoods / likelihoods.sum(axis=1, keepdims=True), axis=0))


def weight_over(scores: FloatArray, others: FloatArray, rng: np.random.Generator) -> float:
    """Weight of a model against one other, from their held-out scores (n_folds,)."""
    return float(model_weights(np.array([scores, others]), rng)[0])


def jackknife_std(estimates: FloatArray, records: Sequence[str]) -> FloatArray:
    """Standard deviations (n,) of estimates (n_folds, n), each without one stretch.

    The jackknife (Efron and Stein, 1981) over stretches, or over records if these differ more:
    errors of the model do not average out within a record. The effect of a record is the sum of
    those of its stretches, to first order.
    """
    effects, names = estimates - estimates.mean(axis=0), np.array(records)
    of_records = np.array([effects[names == name].sum(axis=0) for name in dict.fromkeys(records)])
    variances = [(len(x) - 1) / len(x) * np.sum(x**2, axis=0) for x in (effects, of_records)]
    return np.asarray(np.sqrt(np.max(variances, axis=0)))
