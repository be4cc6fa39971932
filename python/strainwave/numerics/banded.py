"""Matrices of which each row has few entries, side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Banded:
    """Rows of equal width, each with the column that it begins at; zeros elsewhere."""

    first: IntArray  # (n_rows,)
    entries: FloatArray  # (n_rows, width); zeros behind the last column
    n_columns: int

    def __matmul__(self, values: FloatArray) -> FloatArray:
        """Times a vector, (n_columns,): (n_rows,)."""
        longer = np.concatenate([values, np.zeros(self.entries.shape[1])])
        found = np.zeros(len(self.first))
        for k, column in enumerate(self.entries.T):
            found += column * longer[self.first + k]
        return found

    def rows(self, chosen: IntArray | BoolArray) -> Banded:
        """Some of the rows."""
        return Banded(self.first[chosen], self.entries[chosen], self.n_columns)

    def scaled(self, rows: FloatArray, columns: FloatArray) -> Banded:
        """Each row and each column times a number of its own."""
        longer = np.concatenate([columns, np.zeros(self.entries.shape[1])])
        entries = self.entries * rows[:, None]
        for k in range(entries.shape[1]):
            entries[:, k] *= longer[self.first + k]
        return Banded(self.first, entries, self.n_columns)

    def dense(self) -> FloatArray:
        """With all zeros: (n_rows, n_columns)."""
        width = self.entries.shape[1]
        full = np.zeros((len(self.first), self.n_columns + width))
        places = self.first[:, None] + np.arange(width)
        full[np.arange(len(full))[:, None], places] = self.entries
        return full[:, : self.n_columns]
