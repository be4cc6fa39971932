"""Innovations gain from noise covariances.

Triangular factor of a block-Hankel matrix, the data of all subspace methods.
"""

from __future__ import annotations

import numpy as np

from strainwave import _core
from strainwave.domain import FloatArray
from strainwave.statespace._stack import Stack


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


# Smallest ratio of pivots for which the Gram matrix is used instead of a QR decomposition. The
# relative error of the weakest direction is then about 1e-16 / 1e-12, below the noise of measured
# data.
MIN_PIVOT_RATIO = 1e-6

# Rows of each block of the QR decomposition; the full Hankel matrix is never stored.
ROWS_PER_BLOCK = 2048


def triangular_factor(data: Stack, depth: int, order: FloatArray) -> tuple[FloatArray, int]:
    """Triangular factor R with R'R = Z'Z, and the number of rows of the block-Hankel matrix Z.

    Row k of Z is [z[k], ..., z[k + depth - 1]] with z = [u, y]. The displacement structure gives
    Z'Z, and R is its Cholesky factor. If Z'Z is ill-conditioned, a blocked QR decomposition of Z is
    used.

    `depth`: Number of samples in a row of Z.
    `order`: Permutation of the columns of Z.
    """
    z = np.ascontiguousarray(np.hstack([data.inputs, data.outputs]))
    gram, rows = _core.hankel_gram(z, list(data.lengths), depth)
    try:
        R = np.linalg.cholesky(gram[np.ix_(order, order)]).T
    except np.linalg.LinAlgError:
        return _qr_factor(_blocked_qr(data, z, depth)[:, order]), rows
    pivots = np.diagonal(R)
    if pivots.min() < MIN_PIVOT_RATIO * pivots.max():
        return _qr_factor(_blocked_qr(data, z, depth)[:, order]), rows
    return np.asarray(R), rows


def solve_upper(R: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of R x = right for triangular R; the minimum-norm solution if R is singular."""
    pivots = np.abs(np.diagonal(R))
    if pivots.min() > MIN_PIVOT_RATIO * pivots.max():
        return np.asarray(np.linalg.solve(R, right))
    return np.asarray(np.linalg.lstsq(R, right, rcond=1e-12)[0], dtype=np.float64)


def _blocked_qr(data: Stack, z: FloatArray, depth: int) -> FloatArray:
    width = z.shape[1]
    R = np.zeros((0, depth * width))
    for record in data.rows():
        windows = np.lib.stride_tricks.sliding_window_view(z[record].ravel(), depth * width)
        windows = windows[::width]
        for start in range(0, len(windows), ROWS_PER_BLOCK):
            R = _qr_factor(np.vstack([R, windows[start : start + ROWS_PER_BLOCK]]))
    return R


def _qr_factor(matrix: FloatArray) -> FloatArray:
    """Triangular factor R of matrix = Q R."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))
