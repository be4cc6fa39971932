"""Functions of small matrices, without SciPy: to import that takes longer than most stages."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray

_BLOCK = 400  # rows whose factorisation stays in the processor's cache
_TERMS = 18  # 0.5^19 / 19! is below rounding


def exponential(matrix: FloatArray) -> FloatArray:
    """e^M by its series, scaled down by a power of two and squared up again.

    `matrix` (n, n).

    Returns: (n, n).
    """
    size = float(np.abs(matrix).sum(axis=0).max())
    halvings = max(0, int(np.ceil(np.log2(size))) + 1) if size > 0.0 else 0
    small = matrix / 2.0**halvings
    total = np.eye(len(matrix))
    for k in range(_TERMS, 0, -1):  # Horner
        total = np.eye(len(matrix)) + small @ total / k
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)


def triangular_factor(table: FloatArray) -> FloatArray:
    """R of the QR decomposition of a tall table, block by block and then of the blocks' own.

    Which is backward stable like the whole decomposition (Demmel, Grigori, Hoemmen and Langou,
    2012), and takes less than half as long where the table does not fit the cache.

    `table` (n_rows, n).

    Returns: (n_rows, n).
    """
    n_rows, n = table.shape
    n_blocks = n_rows // max(_BLOCK, 2 * n)
    if n_blocks > 1:
        whole = n_rows // n_blocks * n_blocks
        blocks = np.asarray(np.linalg.qr(table[:whole].reshape(n_blocks, -1, n), mode="r"))
        table = np.concatenate([blocks.reshape(-1, n), table[whole:]])
    return np.asarray(np.linalg.qr(table, mode="r"))
