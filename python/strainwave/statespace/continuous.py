"""Propagation of the covariance of models to derived quantities, and continuous-time models."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import factorial
from typing import TypeVar

import numpy as np

from strainwave.domain import (
    STATE_SPACE_MODEL,
    ContinuousStateSpace,
    Diagnostic,
    FloatArray,
    StateSpace,
)
from strainwave.errors import NotIdentifiable
from strainwave.numerics.linalg import exponential

Model = TypeVar("Model", StateSpace, ContinuousStateSpace)

# Step of the central differences, in standard deviations. Their relative error is about the square
# of the step, and the step is far above rounding for data with noise.
DIFFERENCE_STEP_STDS = 0.01

# Relative eigenvalue of the correlation matrix below which a direction is rounding error.
MIN_EIGENVALUE_RATIO = 1e-13

# Fraction of the Nyquist frequency above which a pole may be an alias of a faster pole.
MAX_NYQUIST_SHARE = 0.8

# Largest condition number of the eigenvectors for which the eigendecomposition of A is used. For
# nearly multiple poles, the slower inverse scaling-and-squaring method is used.
MAX_EIGENVECTOR_CONDITION = 1e6

# Coefficients of (e^x - 1 - x)/x^2 = sum of x^k / (k + 2)!, highest power first. The truncation
# error is below rounding for |x| < _SMALL.
_HOLD_SERIES = [1.0 / factorial(k + 2) for k in range(14, -1, -1)]

_MAX_SERIES_ARGUMENT = 0.5


def propagate(
    model: Model, function: Callable[[Model], FloatArray], *, stacked: bool = False
) -> tuple[FloatArray, FloatArray | None]:
    """Value of a function of a model, and its covariance by the delta method.

    P_f = J P J', where J is the derivative of f. Central differences along the principal directions
    of P give J P^(1/2). The covariance has no component along changes of state coordinates, so
    these are not evaluated.

    `function`: Smooth near the model and invariant to changes of state coordinates; returns
        (n_values,).
    `stacked`: The function accepts a stack of models, whose matrices have a leading axis of length
        n_models, and returns (n_models, n_values).

    Returns values (n_values,) and their covariance (n_values, n_values), or None if the model has
    no covariance.
    """
    n_entries = sum(getattr(model, name).size for name in _names(model))
    steps = np.zeros((0, n_entries))
    if model.covariance is not None:
        steps = DIFFERENCE_STEP_STDS * _directions(model.covariance).T
    changes = np.concatenate([np.zeros((1, n_entries)), steps, -steps])
    if stacked:
        values = function(_with_changes(model, changes))
    else:
        values = np.stack([np.atleast_1d(function(_with_changes(model, c))) for c in changes])
    if model.covariance is None:
        return values[0], None
    J = (values[1 : len(steps) + 1] - values[len(steps) + 1 :]).T / (2.0 * DIFFERENCE_STEP_STDS)
    return values[0], J @ J.T


def _directions(covariance: FloatArray) -> FloatArray:
    """Factor S with S S' = covariance, from the eigenvalues of the correlation matrix.

    The correlation matrix is used because the entries have different units.
    """
    std = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    nonzero = np.flatnonzero(std > 0.0)
    if not len(nonzero):
        return np.zeros((len(covariance), 0))
    correlation = covariance[np.ix_(nonzero, nonzero)] / np.outer(std[nonzero], std[nonzero])
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    is_significant = values > MIN_EIGENVALUE_RATIO * values[-1]
    factor = np.zeros((len(covariance), int(is_significant.sum())))
    roots = np.sqrt(values[is_significant])
    factor[nonzero] = std[nonzero, None] * vectors[:, is_significant] * roots
    return factor


def _names(model: Model) -> tuple[str, ...]:
    return ("A", "B", "C", "D", "K") if isinstance(model, StateSpace) else ("A", "B", "C", "D")


def _with_changes(model: Model, change: FloatArray) -> Model:
    """Model with one change, or a stack of changes, added to its entries; without covariance."""
    entries, start = {}, 0
    for name in _names(model):
        matrix = getattr(model, name)
        part = change[..., start : start + matrix.size]
        entries[name] = matrix + part.reshape(*change.shape[:-1], *matrix.shape)
        start += matrix.size
    return replace(model, covariance=None, **entries)


def to_continuous(model: StateSpace) -> ContinuousStateSpace:
    """Convert a sampled model to continuous time, with the hold of each input.

    A = log(A_d) / T. P1 is the integral of exp(A s) over one sampling period, and P2 is the
    integral of exp(A (T - s)) s / T. For an input with zero-order hold, B = P1^-1 B_d and D = D_d.
    For an input with first-order hold, B = (A_d P2 + P1 - P2)^-1 B_d and D = D_d - C P2 B.

    The result has a covariance if the model has one. A pole near the Nyquist frequency, which may
    be an alias, gives a warning. Raises `NotIdentifiable` if a pole of the sampled model is zero or
    on the negative real axis: no continuous-time model of the same order exists.
    """
    converted = _convert(model)
    if model.covariance is None:
        return converted
    _, covariance = propagate(model, lambda near: _entries(_convert(near)), stacked=True)
    return replace(converted, covariance=covariance)


def _entries(model: ContinuousStateSpace) -> FloatArray:
    parts = (model.A, model.B, model.C, model.D)
    return np.concatenate([part.reshape(*part.shape[:-2], -1) for part in parts], axis=-1)


def _convert(model: StateSpace) -> ContinuousStateSpace:
    """Conversion without covariance of one model or a stack of models."""
    T = model.sample_time
    A, P1, P2 = _continuous_matrices(model.A, T)
    is_first_order = np.array([hold == "first" for hold in model.hold])
    B = np.asarray(np.linalg.solve(P1, model.B), dtype=np.float64)
    D = model.D.copy()
    if is_first_order.any():
        joined = model.A @ P2 + P1 - P2
        B[..., is_first_order] = np.linalg.solve(joined, model.B[..., is_first_order])
        D[..., is_first_order] -= model.C @ P2 @ B[..., is_first_order]
    warnings: tuple[Diagnostic, ...] = ()
    hz = float(np.abs(np.linalg.eigvals(A).imag).max(initial=0.0)) / (2.0 * np.pi)
    if hz >= MAX_NYQUIST_SHARE * 0.5 / T:
        place = STATE_SPACE_MODEL
        warnings = (Diagnostic("pole-near-nyquist", place, frequency_hz=hz, rate_hz=1.0 / T),)
    return ContinuousStateSpace(
        A=A,
        B=B,
        C=model.C,
        D=D,
        input_names=model.input_names,
        output_names=model.output_names,
        warnings=warnings,
    )


def _continuous_matrices(A: FloatArray, T: float) -> FloatArray:
    """Continuous-time A, and the integrals P1 and P2 of `to_continuous`: (3, ..., n, n).

    A is the real logarithm with the smallest imaginary parts of the eigenvalues.
    """
    values, vectors = np.linalg.eig(A)
    bad = values[(values.imag == 0.0) & (values.real <= 0.0)]
    if len(bad):
        raise NotIdentifiable(
            f"the sampled model has a pole at {bad[0].real:.3g}, which no continuous-time model of "
            "the same order has: lower the order"
        )
    if np.linalg.cond(vectors).max() >= MAX_EIGENVECTOR_CONDITION:
        if A.ndim > 2:
            return np.stack([_continuous_matrices(matrix, T) for matrix in A], axis=1)
        from scipy.linalg import logm

        logarithm = np.ascontiguousarray(np.real(logm(A)), dtype=np.float64) / T
        return np.stack([logarithm, *_hold_integrals(logarithm, T)])
    x = np.log(values.astype(complex))
    # the closed form loses digits for small x, so the series is used there
    small = np.abs(x) < _MAX_SERIES_ARGUMENT
    series = np.polyval(_HOLD_SERIES, x)
    nonzero = np.where(small, 1.0, x)
    second = np.where(small, series, (np.exp(nonzero) - 1.0 - nonzero) / nonzero**2)
    inverse = np.linalg.inv(vectors)
    functions = np.stack([x / T, T * (1.0 + x * second), T * second])
    return np.real((vectors * functions[..., None, :]) @ inverse)


def _hold_integrals(A: FloatArray, T: float) -> tuple[FloatArray, FloatArray]:
    """Integrals P1 and P2 from one block matrix exponential (Van Loan, IEEE Trans. AC 23, 1978)."""
    n = len(A)
    block = np.zeros((3 * n, 3 * n))
    block[:n, :n] = A * T
    block[:n, n : 2 * n] = np.eye(n) * T
    block[n : 2 * n, 2 * n :] = np.eye(n)
    top = exponential(block)[:n]
    return top[:, n : 2 * n], top[:, 2 * n :]
