"""One regression at low frequencies, and the mean of several records' answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray

_PER_CYCLE = 10.0  # rows that repeat one another: 20 a cycle of the bandwidth, 2 are independent
_MEMORY = 200  # rows over which residuals may repeat one another: ten cycles of the bandwidth


@dataclass(frozen=True, slots=True)
class Fit:
    """Coefficients of one record's regression."""

    value: FloatArray  # (n_columns,)
    covariance: FloatArray  # (n_columns, n_columns)
    explained: float  # share of the target's variance
    rows: int


def regress(target: FloatArray, columns: FloatArray, prior: FloatArray | None = None) -> Fit | None:
    """Least squares by QR with a free constant, and deviations for rows that repeat one another.

    Parameters
    ----------
    target : (n_rows,)
    columns : (n_rows, n_columns)
    prior : (n_columns,), optional
        Deviations of the coefficients about zero, known beforehand; infinite: nothing is known.

    Returns
    -------
    Fit or None
        None where the columns do not determine the coefficients, or nothing varies.
    """
    y = target - target.mean()
    X = columns - columns.mean(axis=0)
    total = float(y @ y)
    size = np.linalg.norm(X, axis=0)
    if total == 0.0 or np.any(size == 0.0) or not np.all(np.isfinite(size)):
        return None
    X = X / size
    tight = np.zeros(0) if prior is None else np.flatnonzero(np.isfinite(prior))
    root = np.sqrt(total / len(y))
    for _ in range(2):
        ridge = np.zeros((len(tight), X.shape[1]))
        if prior is not None:
            ridge[np.arange(len(tight)), tight] = root / (prior[tight] * size[tight])
        Q, R = np.linalg.qr(np.vstack([X, ridge]))
        if np.min(np.abs(np.diag(R))) < 1e-7 * np.max(np.abs(np.diag(R))):
            return None
        value = np.linalg.solve(R, Q[: len(y)].T @ y)
        residual = y - X @ value
        root = float(np.sqrt(residual @ residual / max(1, len(y) - X.shape[1])))
        root = max(root, 1e-9 * float(np.sqrt(total / len(y))))
    inverse = np.linalg.inv(R)
    spread = inverse @ inverse.T * root**2 * _PER_CYCLE
    wider = np.maximum(
        1.0, _slow_deviation(X @ (inverse @ inverse.T), residual) / np.sqrt(np.diag(spread))
    )
    spread = spread * np.outer(wider, wider)
    return Fit(
        value=value / size,
        covariance=spread / np.outer(size, size),
        explained=1.0 - float(residual @ residual) / total,
        rows=len(y),
    )


def _slow_deviation(influence: FloatArray, residual: FloatArray) -> FloatArray:
    """Deviations of coefficients where residuals repeat one another over cycles of the bandwidth.

    The long-run variance of each coefficient's influences (Newey and West, 1987).

    Parameters
    ----------
    influence : (n_rows, n_columns)
        What a row's residual adds to each coefficient.
    residual : (n_rows,)

    Returns
    -------
    (n_columns,)
    """
    terms = influence * residual[:, None]
    n_rows = len(terms)
    n_lags = min(_MEMORY, n_rows // 4)
    spectrum = np.fft.rfft(terms, 2 * n_rows, axis=0)
    products = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n_rows, axis=0)[: n_lags + 1]
    weight = 1.0 - np.arange(n_lags + 1) / (n_lags + 1.0)
    weight[1:] *= 2.0
    return np.sqrt(np.maximum(weight @ products, 0.0))


def pooled(values: Sequence[float], deviations: Sequence[float]) -> tuple[float, float]:
    """Weighted mean of several records' answers, wider where they contradict one another.

    Parameters
    ----------
    values, deviations : sequence of float

    Returns
    -------
    value, standard deviation
    """
    x, weight = np.array(values), np.array(deviations) ** -2.0
    mean = float(weight @ x / weight.sum())
    scatter = float(weight @ (x - mean) ** 2) / max(1, len(x) - 1)
    return mean, float(np.sqrt(max(1.0, scatter) / weight.sum()))
