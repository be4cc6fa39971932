"""State-space matrices: packing into one vector, state transformations, gains of the predictor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.statespace._stack import Stack


@dataclass(frozen=True, slots=True)
class ModelMatrices:
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

    def transformed(self, T: FloatArray) -> ModelMatrices:
        """Model with the state T x."""
        inverse = np.linalg.inv(T)
        return ModelMatrices(
            A=T @ self.A @ inverse,
            B=T @ self.B,
            C=self.C @ inverse,
            D=self.D,
            K=T @ self.K,
            initial_states=self.initial_states @ T.T,
        )

    def with_units(self, inputs: FloatArray, outputs: FloatArray) -> ModelMatrices:
        """Model of channels multiplied by factors (n_inputs,) and (n_outputs,)."""
        column = outputs[:, None]
        return replace(
            self,
            B=self.B / inputs,
            C=self.C * column,
            D=self.D * column / inputs,
            K=self.K / outputs,
        )


def _shapes(order: int, n_inputs: int, n_outputs: int) -> tuple[tuple[int, int], ...]:
    """Shapes of A, B, C, D and K."""
    n, m, p = order, n_inputs, n_outputs
    return (n, n), (n, m), (p, n), (p, m), (n, p)


def n_entries(order: int, n_inputs: int, n_outputs: int) -> int:
    """Total number of entries of A, B, C, D and K."""
    return sum(rows * columns for rows, columns in _shapes(order, n_inputs, n_outputs))


def unpack(values: FloatArray, order: int, n_inputs: int, n_outputs: int) -> ModelMatrices:
    """Matrices from a packed vector; the inverse of `Matrices.pack`."""
    sizes = (*_shapes(order, n_inputs, n_outputs), (-1, order))
    parts = np.split(values, np.cumsum([rows * columns for rows, columns in sizes[:-1]]))
    return ModelMatrices(*(part.reshape(size) for part, size in zip(parts, sizes, strict=True)))


def unscale(matrices: ModelMatrices, data: Stack) -> ModelMatrices:
    """Convert a model of scaled channels to the units of the data."""
    return matrices.with_units(data.input_scale, data.output_scale)


def rescale(matrices: ModelMatrices, data: Stack) -> ModelMatrices:
    """Convert a model in the units of the data to scaled channels."""
    return matrices.with_units(1.0 / data.input_scale, 1.0 / data.output_scale)


def stabilise(matrices: ModelMatrices) -> ModelMatrices:
    """Model with the unstable poles reflected into the unit circle, and a stable predictor.

    The reflection of a pole scales the magnitude of the frequency response and changes its phase.
    """
    A, C = reflect_poles(matrices.A), matrices.C
    return replace(matrices, A=A, K=stabilising_gain(A, C, matrices.K, np.eye(len(C))))


def balance(matrices: ModelMatrices) -> ModelMatrices:
    """Model in the balanced coordinates of `balancing`."""
    return matrices.transformed(balancing(matrices))


def balancing(matrices: ModelMatrices) -> FloatArray:
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


def innovations_gain(
    A: FloatArray, C: FloatArray, Q: FloatArray, S: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Gain of the steady-state Kalman predictor, and covariance of its innovations.

    The model is x+ = A x + w, y = C x + v with cov [w; v] = [Q S; S' R]. The gain solves

        P = A P A' + Q - K (C P C' + R) K',   K = (A P C' + S) (C P C' + R)^-1

    by the structure-preserving doubling algorithm (Anderson, Int. J. Control 28, 1978), which
    converges quadratically. A - K C is stable if the noise excites all modes on or outside the unit
    circle.

    Q has shape (n, n), S (n, p) and R (p, p). Returns K (n, p) and C P C' + R (p, p).
    """
    n = len(A)
    weighted = np.linalg.solve(R, np.hstack([C, S.T]))
    F = (A - S @ weighted[:, :n]).T
    G = C.T @ weighted[:, :n]
    P = Q - S @ weighted[:, n:]
    identity = np.eye(n)
    for _ in range(60):
        solution = np.linalg.solve(identity + G @ P, np.hstack([F, G]))
        increment = F.T @ P @ solution[:, :n]
        G = G + F @ solution[:, n:] @ F.T
        F = F @ solution[:, :n]
        P = P + 0.5 * (increment + increment.T)
        if not np.abs(increment).max() > 1e-14 * np.abs(P).max():
            break
    covariance = C @ P @ C.T + R
    K = np.linalg.solve(covariance, (A @ P @ C.T + S).T).T
    return np.asarray(K, dtype=np.float64), covariance


def is_stable(A: FloatArray) -> bool:
    """Whether all eigenvalues of A lie inside the unit circle."""
    return bool(np.isfinite(A).all() and np.abs(np.linalg.eigvals(A)).max() < 1.0)


def stabilising_gain(A: FloatArray, C: FloatArray, K: FloatArray, R: FloatArray) -> FloatArray:
    """Gain K, or the gain of the stable predictor with the same noise spectrum.

    K is returned if A - K C is stable. Otherwise the Riccati equation with w = K e and v = e gives
    the stable predictor. A small process noise on every state moves eigenvalues away from the unit
    circle.
    """
    n = len(A)
    scale = np.trace(R) / len(R)
    for extra in (0.0, 1e-6, 1e-3, 1.0):
        if is_stable(A - K @ C):
            return K
        noise = (extra or 1e-9) * scale * np.eye(n)
        K, _ = innovations_gain(A, C, K @ R @ K.T + noise, K @ R, R)
    return K


def reflect_poles(A: FloatArray) -> FloatArray:
    """Matrix A with the eigenvalues on or outside the unit circle reflected to the inside."""
    values, vectors = np.linalg.eig(A)
    moduli = np.abs(values)
    if (moduli < 1.0).all():
        return A
    new_moduli = np.where(moduli >= 1.0, np.minimum(1.0 / moduli, 1.0 - 1e-6), moduli)
    result = vectors @ np.diag(values / moduli * new_moduli) @ np.linalg.inv(vectors)
    return np.asarray(result.real)
