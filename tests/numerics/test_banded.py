"""Banded matrices against dense matrices."""

from __future__ import annotations

import numpy as np

from strainwave.numerics.linalg import Banded


def test_products_and_rows_are_those_of_the_dense_matrix() -> None:
    rng = np.random.default_rng(6)
    entries = rng.normal(size=(7, 3))
    entries[-1, 1:] = 0.0  # the last row extends beyond the last column
    banded = Banded(np.array([0, 0, 1, 3, 4, 5, 7]), entries, 8)
    dense = banded.dense()
    assert dense.shape == (7, 8)
    assert dense[3, 3:6].tolist() == entries[3].tolist()
    assert np.count_nonzero(dense) == 7 * 3 - 2
    values = rng.normal(size=8)
    np.testing.assert_allclose(banded @ values, dense @ values, atol=1e-14)
    assert banded.rows(np.array([2, 5])).dense().tolist() == dense[[2, 5]].tolist()
