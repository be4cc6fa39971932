"""Linear regression with correlated residuals, and comparison of models on held-out data.

Models are compared by their predictions of data that their estimates do not use: in-sample costs
favour the model with more parameters, and their chi squares assume that the residuals are noise.
Folds are stretches longer than ten correlation times of the residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray

ROWS_PER_INDEPENDENT_ROW = 10.0
"""Of 20 rows per period of the bandwidth frequency, 2 are independent."""
# Smallest residual over the target, in standard deviations.
_MIN_RESIDUAL_SHARE = 1e-9
# Maximum lag of the residual autocorrelation in rows: ten periods of the bandwidth frequency.
_MAX_LAG_ROWS = 200


@dataclass(frozen=True, slots=True)
class Regression:
    """Coefficients of a regression."""

    value: FloatArray  # (n_columns,)
    root: FloatArray  # (n_columns, n_columns); root root' is the covariance
    explained: float  # share of the variance of the target
    rows: int

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the coefficients, (n_columns, n_columns)."""
        return np.asarray(self.root @ self.root.T)

    def coefficient(self, k: int) -> tuple[float, float]:
        """Coefficient k and its standard deviation."""
        return float(self.value[k]), float(np.linalg.norm(self.root[k]))

    def relative(self, k: int) -> tuple[float, float]:
        """Coefficient k over the first one, the scale, and its standard deviation."""
        (value, std), scale = self.coefficient(k), float(self.value[0])
        return (value / scale, std / abs(scale)) if scale else (0.0, np.inf)

    def ratio(self, min_significance: float) -> tuple[float, float] | None:
        """Ratio of the first two coefficients and its standard deviation under a true ratio of 1.

        The standard deviation is evaluated at a ratio of 1 (Fieller): for an uncertain denominator,
        the value at the estimated ratio makes ratios far from 1 appear significant. None if the
        denominator is less than `min_significance` standard deviations from zero.
        """
        (a, b), covariance = self.value[:2], self.covariance[:2, :2]
        if abs(b) < min_significance * np.sqrt(covariance[1, 1]):
            return None
        variance = covariance[0, 0] - 2.0 * covariance[0, 1] + covariance[1, 1]
        return float(a / b), float(np.sqrt(variance) / abs(b))


def regress(
    target: FloatArray, columns: FloatArray, prior: FloatArray | None = None
) -> Regression | None:
    """Least squares by QR with a free constant. The covariance allows for correlated residuals.

    `target` has shape (n_rows,), `columns` (n_rows, n_columns). `prior`, of shape (n_columns,),
    holds prior standard deviations of the coefficients about zero; infinity means no prior.
    Returns None if the target or a column is constant, or if the columns are linearly dependent.
    """
    y = target - target.mean()
    X = columns - columns.mean(axis=0)
    total = float(y @ y)
    norms = np.linalg.norm(X, axis=0)
    if total == 0.0 or np.any(norms == 0.0) or not np.all(np.isfinite(norms)):
        return None
    X = X / norms
    known = np.zeros(0) if prior is None else np.flatnonzero(np.isfinite(prior))
    residual_std = np.sqrt(total / len(y))
    for _ in range(2 if len(known) else 1):
        ridge = np.zeros((len(known), X.shape[1]))
        if prior is not None:
            ridge[np.arange(len(known)), known] = residual_std / (prior[known] * norms[known])
        Q, R = np.linalg.qr(np.vstack([X, ridge]))
        if np.min(np.abs(np.diag(R))) < 1e-7 * np.max(np.abs(np.diag(R))):
            return None
        value = np.linalg.solve(R, Q[: len(y)].T @ y)
        residual = y - X @ value
        residual_std = float(np.sqrt(residual @ residual / max(1, len(y) - X.shape[1])))
        residual_std = max(residual_std, _MIN_RESIDUAL_SHARE * float(np.sqrt(total / len(y))))
    inverse = np.linalg.inv(R)
    root = inverse * residual_std * np.sqrt(ROWS_PER_INDEPENDENT_ROW)
    factor = np.maximum(
        1.0, long_run_std(X @ (inverse @ inverse.T), residual) / np.linalg.norm(root, axis=1)
    )
    return Regression(
        value=value / norms,
        root=root * (factor / norms)[:, None],
        explained=1.0 - float(residual @ residual) / total,
        rows=len(y),
    )


def long_run_std(influence: FloatArray, residual: FloatArray, stride: int = 1) -> FloatArray:
    """Standard deviations of the coefficients for autocorrelated residuals, (n_columns,).

    Long-run variance of the influence times the residual (Newey and West, 1987). `influence`, of
    shape (n_rows, n_columns), is the derivative of each coefficient with respect to a residual.
    """
    terms = influence * residual[:, None]
    n_rows = len(terms)
    n_lags = min(_MAX_LAG_ROWS // stride, n_rows // 4)
    length = 2 ** (n_rows + n_lags - 1).bit_length()
    spectrum = np.fft.rfft(terms, length, axis=0)
    autocovariance = np.fft.irfft(np.abs(spectrum) ** 2, length, axis=0)[: n_lags + 1]
    window = 1.0 - np.arange(n_lags + 1) / (n_lags + 1.0)
    window[1:] *= 2.0
    return np.sqrt(np.maximum(window @ autocovariance, 0.0))


def pool_estimates(values: Sequence[float], stds: Sequence[float]) -> tuple[float, float]:
    """Weighted mean over records and its standard deviation.

    `stds` holds the standard deviations of the values. The result's standard deviation
    increases if the values scatter more than `stds` explain.
    """
    x, weights = np.array(values), np.array(stds) ** -2.0
    mean = float(weights @ x / weights.sum())
    scatter = float(weights @ (x - mean) ** 2) / max(1, len(x) - 1)
    return mean, float(np.sqrt(max(1.0, scatter) / weights.sum()))


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
