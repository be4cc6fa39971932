"""Innovations gain from noise covariances."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray


def innovations_gain(
    A: FloatArray, C: FloatArray, Q: FloatArray, S: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Steady Kalman predictor of x+ = A x + w, y = C x + v with cov [w; v] = [Q S; S' R].

    P = A P A' + Q - K (C P C' + R) K', K = (A P C' + S)(C P C' + R)^-1, by the structure-preserving
    doubling algorithm (Anderson, Int. J. Control 28, 1978): quadratic convergence, and A - K C is
    stable where the noise moves every state on or outside the unit circle.

    `A` (n, n).
    `Q` (n, n).
    `S` (n, p).

    Returns: `K` (n, p); `covariance`: C P C' + R, of the innovations.
    """
    n = len(A)
    weighted = np.linalg.solve(R, np.hstack([C, S.T]))
    F = (A - S @ weighted[:, :n]).T
    G = C.T @ weighted[:, :n]
    P = Q - S @ weighted[:, n:]
    identity = np.eye(n)
    for _ in range(60):
        inner = np.linalg.solve(identity + G @ P, np.hstack([F, G]))
        step = F.T @ P @ inner[:, :n]
        G = G + F @ inner[:, n:] @ F.T
        F = F @ inner[:, :n]
        P = P + 0.5 * (step + step.T)
        if not np.abs(step).max() > 1e-14 * np.abs(P).max():
            break
    covariance = C @ P @ C.T + R
    K = np.linalg.solve(covariance, (A @ P @ C.T + S).T).T
    return np.asarray(K, dtype=np.float64), covariance


def is_stable(A: FloatArray) -> bool:
    """Whether every eigenvalue lies inside the unit circle."""
    return bool(np.isfinite(A).all() and np.abs(np.linalg.eigvals(A)).max() < 1.0)


def stabilising_gain(A: FloatArray, C: FloatArray, K: FloatArray, R: FloatArray) -> FloatArray:
    """K if A - K C is stable; otherwise the stable predictor of the same noise spectrum.

    The innovations form with gain K is one model of w = K e, v = e; the Riccati equation finds the
    other. A little noise is added to every state, so that poles on the unit circle are moved too.
    """
    n = len(A)
    scale = np.trace(R) / len(R)
    for extra in (0.0, 1e-6, 1e-3, 1.0):
        if is_stable(A - K @ C):
            return K
        noise = (extra or 1e-9) * scale * np.eye(n)
        K, _ = innovations_gain(A, C, K @ R @ K.T + noise, K @ R, R)
    return K


def reflected(A: FloatArray) -> FloatArray:
    """A with eigenvalues on or outside the unit circle mirrored to its inside."""
    values, vectors = np.linalg.eig(A)
    moduli = np.abs(values)
    if (moduli < 1.0).all():
        return A
    inside = np.where(moduli >= 1.0, np.minimum(1.0 / moduli, 1.0 - 1e-6), moduli)
    mirrored = vectors @ np.diag(values / moduli * inside) @ np.linalg.inv(vectors)
    return np.asarray(mirrored.real)
