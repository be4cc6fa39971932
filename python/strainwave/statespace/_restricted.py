"""The gain as restricted likelihood has it: without the bias from fitting the plant to the noise.

What is fitted to the data takes a part of their noise with it, and the rest looks less coloured
than the noise was: K comes out too small, by half a standard deviation for a joint at 512 samples,
and the stated deviations of everything else with it. Restricted likelihood (Patterson and
Thompson, Biometrika 58, 1971; Cox and Reid, J. R. Stat. Soc. B 49, 1987) makes up for it: to the
cost comes

    (1/2) log det I_m(K),

I_m the information on A, B, C, D, that on the initial states taken out; what these take is in the
cost already, in the barrier at the unit circle. The minimum then lies about one Newton step away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.statespace._entries import Matrices, balancing
from strainwave.statespace._evaluate import Evaluator
from strainwave.statespace._riccati import is_stable

# Share of a standard deviation by which an entry of K is moved: far above rounding, and the curve
# is smooth.
_STEP = 0.2

# Samples that give the slope: more of them add to log det a constant, and noise that counts less
# and less.
_SAMPLES = 1024

_HALVINGS = 5


def restricted(evaluator: Evaluator, matrices: Matrices, covariance: FloatArray | None) -> Matrices:
    """The model where cost and (1/2) log det I_m are least together.

    `matrices`: At the minimum of the cost, scaled.
    `covariance` (n_entries, n_entries): Of their packed entries.

    Returns: As they came without a covariance, or where no step lowers the sum.
    """
    if covariance is None:
        return matrices
    T = balancing(matrices)
    change = _change_of_coordinates(matrices, T)
    start, spread = matrices.transformed(T), change @ covariance @ change.T
    values, slope = start.pack(), _slope(evaluator, start, spread)
    step = -spread @ slope
    before = _cost(evaluator, values)
    for _ in range(_HALVINGS):
        # log det changes by slope @ step to first order; the cost is evaluated
        if _cost(evaluator, values + step) + slope @ step < before:
            return evaluator.unpack(values + step).transformed(np.asarray(np.linalg.inv(T)))
        step = 0.5 * step
    return matrices


def _change_of_coordinates(matrices: Matrices, T: FloatArray) -> FloatArray:
    """(n_entries, n_entries): how packed entries change as x becomes T x."""
    m, p = matrices.B.shape[1], len(matrices.C)
    dual = np.linalg.inv(T).T
    parts = [np.kron(T, dual), np.kron(T, np.eye(m)), np.kron(np.eye(p), dual), np.eye(p * m)]
    parts += [np.kron(T, np.eye(p)), np.kron(np.eye(len(matrices.initial_states)), T)]
    size = sum(len(part) for part in parts)
    whole, at = np.zeros((size, size)), 0
    for part in parts:
        whole[at : at + len(part), at : at + len(part)] = part
        at += len(part)
    return whole


def _cost(evaluator: Evaluator, values: FloatArray) -> float:
    """(N/2) log det of the innovations' covariance, and the barrier -(1/2) log det(I - F (x) F)."""
    matrices = evaluator.unpack(values)
    F = matrices.A - matrices.K @ matrices.C
    if not is_stable(F):
        return float("inf")
    barrier = -0.5 * float(np.linalg.slogdet(np.eye(F.size) - np.kron(F, F))[1])
    return evaluator.cost(values) + barrier


def _slope(evaluator: Evaluator, matrices: Matrices, covariance: FloatArray) -> FloatArray:
    """Gradient of (1/2) log det I_m over all entries: by differences along those of K.

    It is zero along the directions of I_m and along changes of the state's coordinates, which
    leaves nothing open.
    """
    along, n = _coordinates(matrices), matrices.order
    first = matrices.A.size + matrices.B.size + matrices.C.size + matrices.D.size
    states = first + matrices.K.size
    unit = np.sqrt(np.maximum(np.diagonal(covariance)[:first], 0.0))
    free = np.flatnonzero(unit > 0.0)
    turned = along[free] / unit[free, None]
    Q = np.linalg.qr(turned, mode="complete")[0][:, n * n :]
    basis = np.zeros((first, Q.shape[1]))
    basis[free] = unit[free, None] * Q
    information = _Information.of(evaluator, matrices, basis, states)
    values, slope = matrices.pack(), np.zeros(len(covariance))
    for entry in range(first, states):
        size = _STEP * float(np.sqrt(max(covariance[entry, entry], 0.0)))
        for _ in range(_HALVINGS if size > 0.0 else 0):
            rise = information.half_log(values, entry, size)
            fall = information.half_log(values, entry, -size)
            if np.isfinite(rise - fall):
                slope[entry] = 0.5 * (rise - fall) / size
                break
            size *= 0.5  # a predictor at the edge of stability diverges on one side
    # A change of coordinates moves K as well; what that adds, A, B and C take back.
    rows = np.vstack([Q.T, turned.T])
    right = np.concatenate([np.zeros(Q.shape[1]), -along[first:].T @ slope[first:states]])
    slope[free] = np.linalg.lstsq(rows, right, rcond=1e-10)[0] / unit[free]
    return slope


def _coordinates(matrices: Matrices) -> FloatArray:
    """(entries of A, B, C, D, K; n^2): how each moves as the state's coordinates do."""
    A, B, C, n = matrices.A, matrices.B, matrices.C, matrices.order
    along = []
    for k in range(n * n):
        X = np.zeros((n, n))
        X.flat[k] = 1.0
        parts = (X @ A - A @ X, X @ B, -C @ X, np.zeros_like(matrices.D), X @ matrices.K)
        along.append(np.concatenate([np.ravel(part) for part in parts]))
    return np.stack(along, axis=1)


@dataclass(frozen=True, slots=True)
class _Information:
    """I_m near a model, on the first part of its data."""

    evaluator: Evaluator
    whitener: FloatArray
    basis: FloatArray  # (entries of A, B, C, D; directions)
    states: int  # where the initial states begin
    n_values: int  # up to the last initial state of the part

    @staticmethod
    def of(
        evaluator: Evaluator, matrices: Matrices, basis: FloatArray, states: int
    ) -> _Information:
        data, lengths, left = evaluator.data, [], _SAMPLES
        for length in data.lengths:
            if left > 0:
                lengths.append(min(length, left))
                left -= length
        # only the last of them is cut short, so that the part is of one piece
        rows = slice(0, sum(lengths))
        part = replace(
            data, inputs=data.inputs[rows], outputs=data.outputs[rows], lengths=tuple(lengths)
        )
        n_values = states + matrices.order * len(lengths)
        whitener = evaluator.whitener(matrices)
        return _Information(Evaluator(part, matrices.order), whitener, basis, states, n_values)

    def half_log(self, values: FloatArray, entry: int, step: float) -> float:
        """(1/2) log det I_m with one entry moved; infinite where the predictor diverges."""
        near = values[: self.n_values].copy()
        near[entry] += step
        hessian, _ = self.evaluator.core.normal_equations(near, self.whitener)
        if not np.isfinite(hessian).all():
            return float("inf")
        own = self.basis.T @ hessian[: len(self.basis)]
        through, of_states = own[:, self.states :], hessian[self.states :, self.states :]
        left = own[:, : len(self.basis)] @ self.basis
        left = left - through @ np.linalg.pinv(of_states, hermitian=True) @ through.T
        return 0.5 * float(np.linalg.slogdet(left)[1])
