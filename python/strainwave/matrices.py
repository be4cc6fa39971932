"""Functions of small matrices, without SciPy: to import that takes longer than most stages."""

from __future__ import annotations

import numpy as np

from strainwave.records import FloatArray

_TERMS = 18  # 0.5^19 / 19! is below rounding


def exponential(matrix: FloatArray) -> FloatArray:
    """e^M by its series, scaled down by a power of two and squared up again.

    Parameters
    ----------
    matrix : (n, n)

    Returns
    -------
    (n, n)
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
