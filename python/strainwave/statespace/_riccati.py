"""Innovations gain from noise covariances."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray


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
