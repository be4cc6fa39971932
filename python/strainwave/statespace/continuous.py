"""From a sampled model to the continuous-time one whose samples it gives."""

from __future__ import annotations

from dataclasses import replace
from math import factorial

import numpy as np

from strainwave.domain import ContinuousStateSpace, Diagnostic, FloatArray, StateSpace
from strainwave.errors import NotIdentifiable
from strainwave.numerics.linalg import exponential
from strainwave.statespace.propagation import propagate

# Share of the Nyquist frequency beyond which a pole may be the alias of a faster one.
NEAR_NYQUIST = 0.8

# Condition of the eigenvectors up to which functions of A are taken on its eigenvalues; beyond,
# poles all but coincide and the slower scaling and squaring is used.
WELL_CONDITIONED = 1e6

# (e^x - 1 - x)/x^2 = sum of x^k / (k + 2)!, highest power first; enough terms up to that size of x.
_SERIES = [1.0 / factorial(k + 2) for k in range(14, -1, -1)]
_SMALL = 0.5


def to_continuous(model: StateSpace) -> ContinuousStateSpace:
    """The continuous-time model, given how each input goes on between samples.

    A = log(A_d) / T. With P1 the integral of exp(A s) over one sample and P2 that of
    exp(A (T - s)) s / T: an input that is held enters as B = P1^-1 B_d; one that is joined by
    straight lines, as B = (A_d P2 + P1 - P2)^-1 B_d and D = D_d - C P2 B.

    Returns: With a covariance if the model has one. A warning names poles so near the Nyquist
    frequency that they may be aliases.

    Raises `NotIdentifiable`: A pole at zero or on the negative real axis, which no continuous-time
    model of this order has.
    """
    found = _convert(model)
    if model.covariance is None:
        return found
    _, covariance = propagate(model, lambda near: _entries(_convert(near)), stacked=True)
    return replace(found, covariance=covariance)


def _entries(model: ContinuousStateSpace) -> FloatArray:
    parts = (model.A, model.B, model.C, model.D)
    return np.concatenate([part.reshape(*part.shape[:-2], -1) for part in parts], axis=-1)


def _convert(model: StateSpace) -> ContinuousStateSpace:
    """Of one model, or of a stack of them."""
    T = model.sample_time
    A, P1, P2 = _between_samples(model.A, T)
    first = np.array([hold == "first" for hold in model.hold])
    B = np.asarray(np.linalg.solve(P1, model.B), dtype=np.float64)
    D = model.D.copy()
    if first.any():
        joined = model.A @ P2 + P1 - P2
        B[..., first] = np.linalg.solve(joined, model.B[..., first])
        D[..., first] -= model.C @ P2 @ B[..., first]
    return ContinuousStateSpace(
        A=A,
        B=B,
        C=model.C,
        D=D,
        input_names=model.input_names,
        output_names=model.output_names,
        warnings=_aliases(A, T),
    )


def _between_samples(A: FloatArray, T: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The real logarithm over T whose eigenvalues have the least imaginary parts, P1 and P2."""
    values, vectors = np.linalg.eig(A)
    bad = values[(values.imag == 0.0) & (values.real <= 0.0)]
    if len(bad):
        raise NotIdentifiable(
            f"the sampled model has a pole at {bad[0].real:.3g}, which no continuous-time model of "
            "the same order has: lower the order"
        )
    if np.linalg.cond(vectors).max() >= WELL_CONDITIONED:
        if A.ndim > 2:
            each = np.stack([np.stack(_between_samples(one, T)) for one in A], axis=1)
            return each[0], each[1], each[2]
        from scipy.linalg import logm

        logarithm = np.ascontiguousarray(np.real(logm(A)), dtype=np.float64) / T
        return logarithm, *_hold_integrals(logarithm, T)
    x = np.log(values.astype(complex))
    # (e^x - 1 - x)/x^2 cancels where x is small; its series ends below rounding up to there
    small = np.abs(x) < _SMALL
    series = np.polyval(_SERIES, x)
    away = np.where(small, 1.0, x)
    second = np.where(small, series, (np.exp(away) - 1.0 - away) / away**2)
    inverse = np.linalg.inv(vectors)
    shapes = np.stack([x / T, T * (1.0 + x * second), T * second])
    found = np.real((vectors * shapes[..., None, :]) @ inverse)
    return found[0], found[1], found[2]


def _hold_integrals(A: FloatArray, T: float) -> tuple[FloatArray, FloatArray]:
    """P1 and P2 as blocks of one matrix exponential (Van Loan, IEEE Trans. AC 23, 1978)."""
    n = len(A)
    whole = np.zeros((3 * n, 3 * n))
    whole[:n, :n] = A * T
    whole[:n, n : 2 * n] = np.eye(n) * T
    whole[n : 2 * n, 2 * n :] = np.eye(n)
    top = exponential(whole)[:n]
    return top[:, n : 2 * n], top[:, 2 * n :]


def _aliases(A: FloatArray, T: float) -> tuple[Diagnostic, ...]:
    fastest = float(np.abs(np.linalg.eigvals(A).imag).max(initial=0.0))
    if fastest < NEAR_NYQUIST * np.pi / T:
        return ()
    return (
        Diagnostic(
            "pole-near-nyquist",
            "state-space model",
            f"a pole at {fastest / (2.0 * np.pi):.3g} Hz, with samples at {1.0 / T:.3g} Hz, may be "
            "the alias of a faster one. Lower the order, or sample faster",
        ),
    )
