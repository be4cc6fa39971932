"""Conversion of sampled state-space models to continuous time."""

from __future__ import annotations

from dataclasses import replace
from math import factorial

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
from strainwave.statespace.propagation import propagate

# Fraction of the Nyquist frequency above which a pole may be an alias of a faster pole.
MAX_NYQUIST_SHARE = 0.8

# Largest condition number of the eigenvectors for which the eigendecomposition of A is used. For
# nearly multiple poles, the slower inverse scaling-and-squaring method is used.
MAX_EIGENVECTOR_CONDITION = 1e6

# Coefficients of (e^x - 1 - x)/x^2 = sum of x^k / (k + 2)!, highest power first. The truncation
# error is below rounding for |x| < _SMALL.
_HOLD_SERIES = [1.0 / factorial(k + 2) for k in range(14, -1, -1)]

_MAX_SERIES_ARGUMENT = 0.5


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
    return ContinuousStateSpace(
        A=A,
        B=B,
        C=model.C,
        D=D,
        input_names=model.input_names,
        output_names=model.output_names,
        warnings=_alias_warnings(A, T),
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


def _alias_warnings(A: FloatArray, T: float) -> tuple[Diagnostic, ...]:
    hz = float(np.abs(np.linalg.eigvals(A).imag).max(initial=0.0)) / (2.0 * np.pi)
    if hz < MAX_NYQUIST_SHARE * 0.5 / T:
        return ()
    place, rate_hz = STATE_SPACE_MODEL, 1.0 / T
    return (Diagnostic("pole-near-nyquist", place, frequency_hz=hz, rate_hz=rate_hz),)
