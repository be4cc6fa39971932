"""The ratio of two coefficients: over draws its error has the stated standard deviation."""

import numpy as np

from strainwave.numerics.statistics import ROWS_PER_INDEPENDENT_ROW, Regression, regress


def fit_of(rng: np.random.Generator, second: float) -> Regression:
    # each row stands for ten, as rows of a record oversample its bandwidth
    columns = np.repeat(rng.normal(size=(200, 2)), int(ROWS_PER_INDEPENDENT_ROW), axis=0)
    noise = np.repeat(rng.normal(size=200), int(ROWS_PER_INDEPENDENT_ROW))
    fit = regress(columns @ np.array([1.0, second]) + noise, columns)
    assert fit is not None
    return fit


def test_a_ratio_of_one_has_its_standard_deviation() -> None:
    rng = np.random.default_rng(0)
    ratios = [fit_of(rng, 1.0).ratio(5.0) for _ in range(200)]
    errors = np.array([(value - 1.0) / std for value, std in filter(None, ratios)])
    assert len(errors) == len(ratios)
    assert 0.8 < float(np.sqrt(np.mean(errors**2))) < 1.2  # 200 draws: 5 %


def test_a_denominator_near_zero_gives_no_ratio() -> None:
    assert fit_of(np.random.default_rng(0), 0.0).ratio(5.0) is None
