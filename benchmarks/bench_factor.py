"""Triangular factor of the rows of one record of seven joints, against NumPy's LAPACK.

Both take one core if OPENBLAS_NUM_THREADS=1. The peer forms the weighted table first, which
`weighted_factor` does not store.
"""

from __future__ import annotations

import numpy as np

from benchmarks.timing import Row, best_of
from strainwave.domain import FloatArray
from strainwave.numerics.linalg import triangular_factor, weighted_factor

_N_ROWS, _N_CHANNELS, _N_UNKNOWNS = 1755, 49, 94


def rows() -> list[Row]:
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(_N_ROWS, _N_CHANNELS, _N_UNKNOWNS))
    scale, residual = rng.uniform(0.5, 2.0, columns.shape[:2]), rng.normal(size=columns.shape[:2])

    def table() -> FloatArray:
        weighted = columns * scale[..., None]
        return np.concatenate([weighted, residual[..., None]], axis=2).reshape(residual.size, -1)

    plain, size = table(), f"{residual.size:,} x {_N_UNKNOWNS + 1}"
    return [
        Row(
            f"triangular factor, {size}",
            best_of(lambda: triangular_factor(plain)),
            "NumPy qr",
            best_of(lambda: np.linalg.qr(plain, mode="r")),
        ),
        Row(
            f"the same, with weights, {size}",
            best_of(lambda: weighted_factor([columns], scale, residual, [])),
            "NumPy qr",
            best_of(lambda: np.linalg.qr(table(), mode="r")),
        ),
    ]
