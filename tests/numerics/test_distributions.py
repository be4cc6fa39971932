"""Closed-form distributions and the matrix exponential against SciPy."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.special import chdtrc, chdtri, stdtrit

from strainwave.numerics.distributions import (
    chi_square_limit,
    chi_square_tail,
    student_quantile,
)
from strainwave.numerics.linalg import exponential


@pytest.mark.parametrize("degrees", [1, 2, 3, 10, 25, 100, 101, 300])
@pytest.mark.parametrize("value", [0.0, 0.1, 1.0, 30.0, 100.0, 1e3, 1e5, np.inf])
def test_chi_square_tail(value: float, degrees: int) -> None:
    # rounding of a sum of a few hundred terms, each at most one
    assert chi_square_tail(value, degrees) == pytest.approx(chdtrc(degrees, value), abs=1e-13)


@pytest.mark.parametrize("degrees", [1, 2, 3, 10, 101])
@pytest.mark.parametrize("probability", [0.5, 0.05, 2.7e-3, 6e-7])
def test_chi_square_limit(probability: float, degrees: int) -> None:
    # 60 bisections of a tail probability with an error of about 1e-15
    expected = chdtri(degrees, probability)
    assert chi_square_limit(probability, degrees) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 5, 19, 20, 39, 200])
@pytest.mark.parametrize("probability", [0.5, 0.8, 0.975, 0.9999])
def test_student_quantile(probability: float, degrees: int) -> None:
    # 60 bisections of the angle
    expected = stdtrit(degrees, probability)
    assert student_quantile(probability, degrees) == pytest.approx(expected, rel=1e-10, abs=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-3, 0.1, 1.0, 5.0, 50.0])
def test_matrix_exponential(size: float) -> None:
    matrix = size * np.random.default_rng(5).normal(size=(5, 5))
    expected = expm(matrix)
    # squaring doubles the relative error: 1e-16 times about 2 |M|
    assert (
        np.abs(exponential(matrix) - expected).max()
        < 1e-13 * max(1.0, size) * np.abs(expected).max()
    )
