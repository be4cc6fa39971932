"""Distributions against SciPy."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import chdtrc, chdtri, stdtrit

from strainwave.domain.results.distributions import (
    CI95_STDS,
    CI99_STDS,
    STD_PER_MEDIAN,
    chi_square_limit,
    chi_square_tail,
    f_tail,
    student_degrees,
    student_quantile,
    student_tail,
)


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


def test_factors_of_intervals() -> None:
    normal = 10**6  # degrees of freedom from which Student's t is normal to six digits
    assert pytest.approx(stdtrit(normal, 0.975), abs=5e-5) == CI95_STDS
    assert pytest.approx(stdtrit(normal, 0.995), abs=5e-5) == CI99_STDS
    assert pytest.approx(1.0 / stdtrit(normal, 0.75), abs=5e-5) == STD_PER_MEDIAN


@pytest.mark.parametrize("degrees", [0.3, 1.0, 2.0, 3.5, 40.0, 1e5])
@pytest.mark.parametrize("value", [-2.0, 0.0, 0.7, 30.0, np.inf])
def test_distributions_of_real_degrees(value: float, degrees: float) -> None:
    assert student_tail(value, degrees) == pytest.approx(2.0 * stats.t.sf(abs(value), degrees))
    assert student_tail(value, np.inf) == pytest.approx(2.0 * stats.norm.sf(abs(value)))
    assert f_tail(value**2, 3.0, degrees) == pytest.approx(stats.f.sf(value**2, 3.0, degrees))
    assert np.isnan(student_tail(np.nan, degrees))


@pytest.mark.parametrize("degrees", [1.0, 3.5, 40.0])
def test_degrees_of_a_quantile(degrees: float) -> None:
    quantile = float(stats.t.ppf(0.975, degrees))
    assert student_degrees(quantile) == pytest.approx(degrees, rel=1e-6)
