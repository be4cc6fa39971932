"""Packing of the state-space matrices into one vector, and state transformations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.statespace._riccati import is_stable, reflect_poles, stabilising_gain
from strainwave.statespace._stack import Stack


@dataclass(frozen=True, slots=True)
class Matrices:
    """State-space matrices A, B, C, D, K and the initial state of each record."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    K: FloatArray
    initial_states: FloatArray  # (n_records, order)

    @property
    def order(self) -> int:
        return len(self.A)

    def pack(self) -> FloatArray:
        """Entries in the layout of the core: A, B, C, D, K by rows, then the initial states."""
        parts = (self.A, self.B, self.C, self.D, self.K, self.initial_states)
        return np.concatenate([np.ravel(part) for part in parts])

    def transformed(self, T: FloatArray) -> Matrices:
        """Model with the state T x."""
        inverse = np.linalg.inv(T)
        return Matrices(
            A=T @ self.A @ inverse,
            B=T @ self.B,
            C=self.C @ inverse,
            D=self.D,
            K=T @ self.K,
            initial_states=self.initial_states @ T.T,
        )

    def with_units(self, inputs: FloatArray, outputs: FloatArray) -> Matrices:
        """Model of channels multiplied by factors (n_inputs,) and (n_outputs,)."""
        column = outputs[:, None]
        return replace(
            self,
            B=self.B / inputs,
            C=self.C * column,
            D=self.D * column / inputs,
            K=self.K / outputs,
        )


def shapes(order: int, n_inputs: int, n_outputs: int) -> tuple[tuple[int, int], ...]:
    """Shapes of A, B, C, D and K."""
    n, m, p = order, n_inputs, n_outputs
    return (n, n), (n, m), (p, n), (p, m), (n, p)


def n_entries(order: int, n_inputs: int, n_outputs: int) -> int:
    """Total number of entries of A, B, C, D and K."""
    return sum(rows * columns for rows, columns in shapes(order, n_inputs, n_outputs))


def unpack(values: FloatArray, order: int, n_inputs: int, n_outputs: int) -> Matrices:
    """Matrices from a packed vector; the inverse of `Matrices.pack`."""
    sizes = (*shapes(order, n_inputs, n_outputs), (-1, order))
    parts = np.split(values, np.cumsum([rows * columns for rows, columns in sizes[:-1]]))
    return Matrices(*(part.reshape(size) for part, size in zip(parts, sizes, strict=True)))


def unscale(matrices: Matrices, data: Stack) -> Matrices:
    """Convert a model of scaled channels to the units of the data."""
    return matrices.with_units(data.input_scale, data.output_scale)


def rescale(matrices: Matrices, data: Stack) -> Matrices:
    """Convert a model in the units of the data to scaled channels."""
    return matrices.with_units(1.0 / data.input_scale, 1.0 / data.output_scale)


def stabilise(matrices: Matrices) -> Matrices:
    """Model with the unstable poles reflected into the unit circle, and a stable predictor.

    The reflection of a pole scales the magnitude of the frequency response and changes its phase.
    """
    A, C = reflect_poles(matrices.A), matrices.C
    return replace(matrices, A=A, K=stabilising_gain(A, C, matrices.K, np.eye(len(C))))


def balance(matrices: Matrices) -> Matrices:
    """Model in the balanced coordinates of `balancing`."""
    return matrices.transformed(balancing(matrices))


def balancing(matrices: Matrices) -> FloatArray:
    """State transformation T that balances the predictor.

    In the coordinates T x, the controllability and observability Gramians of (A - K C, [B, K], C)
    are equal and diagonal, which keeps the normal equations of a fit well conditioned. T is the
    identity if the predictor is unstable or a Gramian is singular.
    """
    predictor = matrices.A - matrices.K @ matrices.C
    if not is_stable(predictor):
        return np.eye(matrices.order)
    controllability = _gramian(predictor, np.hstack([matrices.B, matrices.K]))
    observability = _gramian(predictor.T, matrices.C.T)
    try:
        L = np.linalg.cholesky(controllability)
        hankel_squares, U = np.linalg.eigh(L.T @ observability @ L)
    except np.linalg.LinAlgError:
        return np.eye(matrices.order)
    # smallest Hankel singular value below rounding
    if not hankel_squares[0] > 1e-24 * hankel_squares[-1]:
        return np.eye(matrices.order)
    # T = S^(1/2) U' L^-1, where S holds the Hankel singular values.
    T = np.sqrt(np.sqrt(hankel_squares))[:, None] * np.linalg.solve(L.T, U).T
    return np.asarray(T)


def _gramian(A: FloatArray, B: FloatArray) -> FloatArray:
    """Solution of X = A X A' + B B' by doubling, for stable A."""
    X = B @ B.T
    for _ in range(60):
        increment = A @ X @ A.T
        X = X + increment
        if not np.abs(increment).max() > 1e-15 * np.abs(X).max():
            break
        A = A @ A
    return 0.5 * (X + X.T)
