"""Triangular factor of a block-Hankel matrix: all that a subspace method needs of the data."""

from __future__ import annotations

import numpy as np

from strainwave import _core
from strainwave.domain import FloatArray
from strainwave.statespace._stack import Stack

# Squaring the data loses the square of a pivot against one. Down to this ratio what rounding
# leaves of the smallest direction, 1e-16 / 1e-12, is still below the scatter of any real record.
SMALLEST_PIVOT = 1e-6

# Rows factored at a time where squaring would lose too much: the tall matrix is never stored.
BLOCK = 2048


def triangular_factor(data: Stack, depth: int, order: FloatArray) -> tuple[FloatArray, int]:
    """R with R'R = Z'Z, columns of Z reordered.

    Row k of Z is [z[k], ..., z[k + depth - 1]] with z = [u, y]. Z'Z comes from its displacement
    structure and R from Cholesky; where that would lose digits, from a blocked QR of Z.

    `depth`: Samples side by side in a row of Z.
    `order` (n_inputs + n_outputs): Columns of Z as they are to stand in R.

    Returns: `rows`: Rows of Z.
    """
    z = np.ascontiguousarray(np.hstack([data.inputs, data.outputs]))
    gram, rows = _core.hankel_gram(z, list(data.lengths), depth)
    try:
        R = np.linalg.cholesky(gram[np.ix_(order, order)]).T
    except np.linalg.LinAlgError:
        return _upper(_blocked_qr(data, z, depth)[:, order]), rows
    pivots = np.diagonal(R)
    if pivots.min() < SMALLEST_PIVOT * pivots.max():
        return _upper(_blocked_qr(data, z, depth)[:, order]), rows
    return np.asarray(R), rows


def solve_upper(R: FloatArray, right: FloatArray) -> FloatArray:
    """R^-1 right for triangular R; of least norm where columns of R depend on one another."""
    pivots = np.abs(np.diagonal(R))
    if pivots.min() > SMALLEST_PIVOT * pivots.max():
        return np.asarray(np.linalg.solve(R, right))
    return np.asarray(np.linalg.lstsq(R, right, rcond=1e-12)[0], dtype=np.float64)


def _blocked_qr(data: Stack, z: FloatArray, depth: int) -> FloatArray:
    width = z.shape[1]
    R = np.zeros((0, depth * width))
    for record in data.rows():
        windows = np.lib.stride_tricks.sliding_window_view(z[record].ravel(), depth * width)
        windows = windows[::width]
        for start in range(0, len(windows), BLOCK):
            R = _upper(np.vstack([R, windows[start : start + BLOCK]]))
    return R


def _upper(matrix: FloatArray) -> FloatArray:
    """R of matrix = Q R."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))
