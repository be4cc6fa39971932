"""Functions of small matrices without SciPy, whose import takes longer than most stages.

Matrices with few, contiguous entries per row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave import _core
from strainwave.domain import BoolArray, ComplexArray, FloatArray, IntArray

_TAYLOR_TERMS = 18  # number of Taylor terms: 0.5^19 / 19! is below rounding


def exponential(matrix: FloatArray) -> FloatArray:
    """Matrix exponential e^M (n, n) by scaling and squaring of its Taylor series."""
    size = float(np.abs(matrix).sum(axis=0).max())
    halvings = max(0, int(np.ceil(np.log2(size))) + 1) if size > 0.0 else 0
    scaled = matrix / 2.0**halvings
    result = np.eye(len(matrix))
    for k in range(_TAYLOR_TERMS, 0, -1):  # Horner's scheme
        result = np.eye(len(matrix)) + scaled @ result / k
    for _ in range(halvings):
        result = result @ result
    return np.asarray(result)


def triangular_factor(table: FloatArray) -> FloatArray:
    """Triangular factor R (n, n) of the QR decomposition of a table (n_rows, n).

    The signs of the rows of R are arbitrary. R is zero in rows of zero columns, and to rounding in
    other rows if the table has fewer rows than columns. The method is backward stable (Demmel,
    Grigori, Hoemmen and Langou, 2012). The GIL is released.
    """
    return _core.triangular_factor(np.ascontiguousarray(table))


def weighted_factor(
    columns: Sequence[FloatArray], scale: FloatArray, residual: FloatArray, biased: Sequence[int]
) -> FloatArray:
    """Triangular factor R (n + 1, n + 1) of [scale columns, residual] without biases.

    `columns` are derivatives (n_rows, n_channels, ...), n in all, side by side, and `scale`
    (n_rows, n_channels) their factors. `residual` (n_rows, n_channels) contains its factors. A bias
    is a constant in a channel of `biased`: the rows of the channel are projected onto the
    complement of the channel's factors. The table is not stored, which halves the time of large
    ones. The GIL is released.
    """
    return _core.weighted_factor(
        [np.ascontiguousarray(part) for part in columns],
        np.ascontiguousarray(scale),
        np.ascontiguousarray(residual),
        biased,
    )


def eigenvalues(matrices: FloatArray) -> ComplexArray:
    """Eigenvalues (n_matrices, n) of matrices (n_matrices, n, n), of each in any order.

    Matrices share registers: many small ones take a quarter of the time of `np.linalg.eigvals`. The
    GIL is released. Raises LinAlgError for entries that are not finite.
    """
    try:
        return _core.eigenvalues(np.ascontiguousarray(matrices)).view(np.complex128)[..., 0]
    except ArithmeticError as error:
        raise np.linalg.LinAlgError(str(error)) from error


def singular_values(matrix: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """U (n_rows, rank), s (rank,) descending and V' (rank, n_columns) of a finite matrix U s V'.

    LAPACK's divide and conquer fails on some matrices of which many singular values are rounding
    errors; the transpose has the same decomposition and another path through the algorithm. Raises
    LinAlgError if both fail.
    """
    try:
        left, values, right = np.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        right, values, left = (x.T for x in np.linalg.svd(matrix.T, full_matrices=False))
    return left, values, right


@dataclass(frozen=True, slots=True)
class Banded:
    """Matrix whose rows have the same number of contiguous entries and are zero elsewhere."""

    first: IntArray  # (n_rows,) first column of each row
    entries: FloatArray  # (n_rows, width), zero beyond the last column
    n_columns: int

    def __matmul__(self, values: FloatArray) -> FloatArray:
        """Product (n_rows,) with a vector (n_columns,)."""
        return _core.window_products(self.first, self.entries, np.ascontiguousarray(values))

    def rows(self, chosen: IntArray | BoolArray) -> Banded:
        """Matrix of selected rows."""
        return Banded(self.first[chosen], self.entries[chosen], self.n_columns)

    def dense(self) -> FloatArray:
        """Dense matrix (n_rows, n_columns)."""
        width = self.entries.shape[1]
        dense_matrix = np.zeros((len(self.first), self.n_columns + width))
        columns = self.first[:, None] + np.arange(width)
        dense_matrix[np.arange(len(dense_matrix))[:, None], columns] = self.entries
        return dense_matrix[:, : self.n_columns]
