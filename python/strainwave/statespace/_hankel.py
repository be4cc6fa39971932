"""Triangular factor of a block-Hankel matrix, the data of all subspace methods."""

from __future__ import annotations

import numpy as np

from strainwave import _core
from strainwave.domain import FloatArray
from strainwave.statespace._stack import Stack

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
