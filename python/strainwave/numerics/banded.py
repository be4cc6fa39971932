"""Matrices with few, contiguous entries per row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Banded:
    """Matrix whose rows have the same number of contiguous entries and are zero elsewhere."""

    first: IntArray  # (n_rows,) first column of each row
    entries: FloatArray  # (n_rows, width), zero beyond the last column
    n_columns: int

    def __matmul__(self, values: FloatArray) -> FloatArray:
        """Product (n_rows,) with a vector (n_columns,)."""
        padded = np.concatenate([values, np.zeros(self.entries.shape[1])])
        product = np.zeros(len(self.first))
        for k, column in enumerate(self.entries.T):
            product += column * padded[self.first + k]
        return product

    def rows(self, chosen: IntArray | BoolArray) -> Banded:
        """Matrix of selected rows."""
        return Banded(self.first[chosen], self.entries[chosen], self.n_columns)

    def scaled(self, rows: FloatArray, columns: FloatArray) -> Banded:
        """Matrix with rows and columns multiplied by the given factors."""
        padded = np.concatenate([columns, np.zeros(self.entries.shape[1])])
        entries = self.entries * rows[:, None]
        for k in range(entries.shape[1]):
            entries[:, k] *= padded[self.first + k]
        return Banded(self.first, entries, self.n_columns)

    def dense(self) -> FloatArray:
        """Dense matrix (n_rows, n_columns)."""
        width = self.entries.shape[1]
        dense_matrix = np.zeros((len(self.first), self.n_columns + width))
        columns = self.first[:, None] + np.arange(width)
        dense_matrix[np.arange(len(dense_matrix))[:, None], columns] = self.entries
        return dense_matrix[:, : self.n_columns]
