"""The five matrices as one vector, and the coordinates of the state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.statespace._riccati import is_stable
from strainwave.statespace._stack import Stack


@dataclass(frozen=True, slots=True)
class Matrices:
    """A, B, C, D, K and one initial state a record."""

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
        """A, B, C, D, K row by row, then the initial states: the core's layout."""
        parts = (self.A, self.B, self.C, self.D, self.K, self.initial_states)
        return np.concatenate([np.ravel(part) for part in parts])

    def transformed(self, T: FloatArray) -> Matrices:
        """The same model in coordinates T x."""
        inverse = np.linalg.inv(T)
        return Matrices(
            A=T @ self.A @ inverse,
            B=T @ self.B,
            C=self.C @ inverse,
            D=self.D,
            K=T @ self.K,
            initial_states=self.initial_states @ T.T,
        )


def shapes(order: int, n_inputs: int, n_outputs: int) -> tuple[tuple[int, int], ...]:
    """Shapes of A, B, C, D, K."""
    n, m, p = order, n_inputs, n_outputs
    return (n, n), (n, m), (p, n), (p, m), (n, p)


def n_entries(order: int, n_inputs: int, n_outputs: int) -> int:
    """Entries of A, B, C, D, K together."""
    return sum(rows * columns for rows, columns in shapes(order, n_inputs, n_outputs))


def split(vector: FloatArray, sizes: Sequence[tuple[int, int]]) -> list[FloatArray]:
    """Matrices of the given shapes from the front of a vector."""
    stops = np.cumsum([rows * columns for rows, columns in sizes])
    pieces = np.split(vector[: stops[-1]], stops[:-1])
    return [piece.reshape(shape) for piece, shape in zip(pieces, sizes, strict=True)]


def unpack(values: FloatArray, order: int, n_inputs: int, n_outputs: int) -> Matrices:
    """The inverse of `Matrices.pack`."""
    A, B, C, D, K = split(values, shapes(order, n_inputs, n_outputs))
    start = n_entries(order, n_inputs, n_outputs)
    return Matrices(A, B, C, D, K, initial_states=values[start:].reshape(-1, order))


def unscale(matrices: Matrices, data: Stack) -> Matrices:
    """From scaled channels to the user's."""
    return Matrices(
        A=matrices.A,
        B=matrices.B / data.input_scale,
        C=matrices.C * data.output_scale[:, None],
        D=matrices.D * data.output_scale[:, None] / data.input_scale,
        K=matrices.K / data.output_scale,
        initial_states=matrices.initial_states,
    )


def rescale(matrices: Matrices, data: Stack) -> Matrices:
    """From the user's channels to scaled ones."""
    return Matrices(
        A=matrices.A,
        B=matrices.B * data.input_scale,
        C=matrices.C / data.output_scale[:, None],
        D=matrices.D / data.output_scale[:, None] * data.input_scale,
        K=matrices.K * data.output_scale,
        initial_states=matrices.initial_states,
    )


def balanced(matrices: Matrices) -> Matrices:
    """The model in the coordinates of `balancing`."""
    return matrices.transformed(balancing(matrices))


def balancing(matrices: Matrices) -> FloatArray:
    """T such that in coordinates T x the predictor's states are as easy to reach as to see.

    The Gramians of (A - K C, [B, K], C) become equal and diagonal. Entries then have comparable
    weight, and the normal equations of a fit are as well conditioned as the data allow. Where a
    Gramian is singular, as for a state that no input moves, and where the predictor is unstable and
    has none, the coordinates stay.
    """
    closed = matrices.A - matrices.K @ matrices.C
    if not is_stable(closed):
        return np.eye(matrices.order)
    reach = _gramian(closed, np.hstack([matrices.B, matrices.K]))
    sight = _gramian(closed.T, matrices.C.T)
    try:
        L = np.linalg.cholesky(reach)
        squares, U = np.linalg.eigh(L.T @ sight @ L)
    except np.linalg.LinAlgError:
        return np.eye(matrices.order)
    if not squares[0] > 1e-24 * squares[-1]:  # a Hankel singular value lost to rounding
        return np.eye(matrices.order)
    # T = S^(1/2) U' L^-1 with S the Hankel singular values.
    T = np.sqrt(np.sqrt(squares))[:, None] * np.linalg.solve(L.T, U).T
    return np.asarray(T)


def _gramian(A: FloatArray, B: FloatArray) -> FloatArray:
    """X = A X A' + B B' by doubling; A stable."""
    X = B @ B.T
    for _ in range(60):
        step = A @ X @ A.T
        X = X + step
        if not np.abs(step).max() > 1e-15 * np.abs(X).max():
            break
        A = A @ A
    return 0.5 * (X + X.T)
