"""Functions of small matrices against NumPy and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from strainwave.domain import FloatArray
from strainwave.numerics.linalg import (
    eigenvalues,
    exponential,
    singular_values,
    triangular_factor,
    weighted_factor,
)


@pytest.mark.parametrize("n", [1, 2, 3, 8, 20, 48, 69])
@pytest.mark.parametrize("count", [1, 8, 21])
def test_eigenvalues_are_lapacks(n: int, count: int) -> None:
    rng = np.random.default_rng(n + count)
    units = 10.0 ** rng.uniform(-6.0, 6.0, n)  # of states, which balancing removes
    matrices = rng.normal(size=(count, n, n)) * units / units[:, None]
    expected, values = np.linalg.eigvals(matrices), eigenvalues(matrices)
    distance = np.abs(values[:, :, None] - expected[:, None])
    # backward errors of both are some roundings of a norm of about the root of n
    assert max(distance.min(axis=1).max(), distance.min(axis=2).max()) < 1e-11


def test_eigenvalues_take_strided_matrices_and_none() -> None:
    matrices = np.random.default_rng(1).normal(size=(4, 5, 10))[..., ::2]
    np.testing.assert_array_equal(eigenvalues(matrices), eigenvalues(matrices.copy()))
    assert eigenvalues(matrices[:0]).shape == (0, 5)


def test_eigenvalues_of_what_is_not_finite_are_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="finite"):
        eigenvalues(np.full((2, 3, 3), np.nan))
    with pytest.raises(ValueError, match="square"):
        eigenvalues(np.zeros((2, 3, 4)))


@pytest.mark.parametrize("shape", [(7, 7), (399, 4), (800, 3), (2501, 22), (1000, 450)])
def test_a_triangular_factor_is_lapacks(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(shape[0])
    table = rng.normal(size=shape) * 10.0 ** rng.uniform(-6.0, 6.0, shape[1])
    expected, R = np.asarray(np.linalg.qr(table, mode="r")), triangular_factor(table)
    assert R.shape == expected.shape
    np.testing.assert_array_equal(R, np.triu(R))
    size = np.linalg.norm(table, axis=0)
    # the sign of each row of R is arbitrary
    np.testing.assert_allclose(np.abs(R) / size, np.abs(expected) / size, atol=1e-12)


@pytest.mark.parametrize("shape", [(0, 3), (3, 5), (5, 0)])
def test_a_triangular_factor_is_square_for_any_number_of_rows(shape: tuple[int, int]) -> None:
    table = np.random.default_rng(1).normal(size=shape)
    R = triangular_factor(table)
    assert R.shape == (shape[1], shape[1])
    np.testing.assert_allclose(R.T @ R, table.T @ table, atol=1e-14)


def test_a_triangular_factor_takes_strided_tables() -> None:
    table = np.random.default_rng(1).normal(size=(50, 8))
    R, expected = triangular_factor(table[:, ::2]), triangular_factor(table[:, ::2].copy())
    np.testing.assert_array_equal(R, expected)


def test_a_weighted_factor_takes_strided_columns_and_rejects_sizes_that_do_not_fit() -> None:
    columns, rows = np.random.default_rng(1).normal(size=(4, 3, 4)), np.ones((4, 3))
    R = weighted_factor([columns[..., ::2], columns[..., 1:2]], rows, rows, [2])
    together = columns[..., [0, 2, 1]].copy()
    np.testing.assert_array_equal(R, weighted_factor([together], rows, rows, [2]))
    with pytest.raises(ValueError, match="columns: expected 3 x 4 rows, got 4 x 3"):
        weighted_factor([columns], np.ones((3, 4)), np.ones((3, 4)), [])
    with pytest.raises(ValueError, match="residual: expected 4 x 3 rows, got 4 x 2"):
        weighted_factor([columns], rows, rows[:, :2], [])
    with pytest.raises(ValueError, match="biased: expected numbers below 3, got 3"):
        weighted_factor([columns], rows, rows, [0, 3])


def test_a_triangular_factor_is_more_accurate_than_normal_equations() -> None:
    """Two columns that differ by 1e-10: the square of the difference is below rounding."""
    rng = np.random.default_rng(1)
    first = rng.normal(size=2000)
    second = first + 1e-10 * rng.normal(size=2000)
    R = triangular_factor(np.column_stack([first, second]))
    expected = np.linalg.norm(second - first * (first @ second) / (first @ first))
    assert abs(R[1, 1]) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("size", [0.0, 1e-3, 1.0, 30.0])
def test_the_exponential_is_scipys(size: float) -> None:
    matrix = size * np.random.default_rng(2).normal(size=(4, 4))
    expected = expm(matrix)
    scale = np.max(np.abs(expected))
    np.testing.assert_allclose(exponential(matrix) / scale, expected / scale, atol=1e-12)


@pytest.mark.parametrize("shape", [(7, 3), (3, 7), (5, 5)])
def test_singular_values_follow_from_the_transpose_if_lapack_fails(
    shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    matrix = np.random.default_rng(2).normal(size=shape)
    expected_left, expected, _ = singular_values(matrix)
    decompose = np.linalg.svd

    def fails(each: FloatArray, full_matrices: bool) -> object:
        if each is matrix:
            raise np.linalg.LinAlgError("SVD did not converge")
        return decompose(each, full_matrices=full_matrices)

    monkeypatch.setattr(np.linalg, "svd", fails)
    left, values, right = singular_values(matrix)
    np.testing.assert_allclose(values, expected, rtol=1e-13)
    np.testing.assert_allclose(left * values @ right, matrix, atol=1e-13)
    assert left.shape == expected_left.shape
