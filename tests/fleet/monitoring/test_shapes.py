"""Changes over time: comparison with standard tests, false-alarm rate and detection."""

from __future__ import annotations

import secrets

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from strainwave.domain import FloatArray
from strainwave.domain.results.distributions import student_tail
from strainwave.fleet.monitoring.shapes import (
    MIN_VISITS,
    DetectedChange,
    ParameterSeries,
    cap_union_probability,
    estimate_visit_variance,
    fit_change,
    fitted_line,
    regressors,
)

FAILURE_P = 1e-4  # probability that a test with a fresh seed fails by chance


def series(
    value: FloatArray, std: FloatArray | float = 1.0, covariates: FloatArray | None = None
) -> ParameterSeries:
    n = len(value)
    covariate_table = np.empty((n, 0)) if covariates is None else covariates
    return ParameterSeries(
        7.0 * np.arange(n, dtype=np.float64), value, np.broadcast_to(std, n).copy(), covariate_table
    )


def found(one: ParameterSeries, seed: int = 0) -> DetectedChange:
    change = fit_change(one, np.random.default_rng(seed))
    assert change is not None
    return change


@given(st.integers(0, 2**32 - 1), st.integers(8, 30))
def test_a_drift_equals_linear_regression_if_visits_scatter(seed: int, n: int) -> None:
    """For small, equal standard deviations, the test is ordinary least squares with Student's t."""
    value = 100.0 + 50.0 * np.random.default_rng(seed).normal(size=n)
    visits = series(value, 0.01)
    change, regression = found(visits), stats.linregress(visits.time, value)
    assert change.drift == pytest.approx(regression.slope, rel=1e-6)
    assert change.drift_std == pytest.approx(regression.stderr, rel=1e-4)
    assert change.drift_p == pytest.approx(regression.pvalue, rel=1e-3)


def test_standard_deviations_of_runs_are_the_minimum() -> None:
    """The p-value does not decrease if the scatter is below the standard deviations."""
    n = 20
    value = 100.0 + 1e-3 * np.random.default_rng(0).normal(size=n) + 0.1 * (np.arange(n) >= 10)
    change = found(series(value, 1.0))
    assert change.p > 0.9
    assert change.size_std == pytest.approx(np.sqrt(1 / 10 + 1 / 10), rel=0.3)
    assert found(series(value, 1e-4)).p < 1e-12


@pytest.mark.parametrize("between", [0.0, 1.0, 5.0])
@pytest.mark.parametrize("n", [7, 16])
def test_the_false_alarm_rate_is_the_level(n: int, between: float) -> None:
    """Unequal standard deviations and a covariate; conservative without scatter between visits."""
    seed = secrets.randbits(32)
    rng = np.random.default_rng(seed)
    runs = 300
    p = np.empty(runs)
    for k in range(runs):
        std = np.exp(0.5 * rng.normal(size=n))
        temperature = rng.normal(size=(n, 1))
        value = (
            50.0 + 3.0 * temperature[:, 0] + between * rng.normal(size=n) + std * rng.normal(size=n)
        )
        change = fit_change(series(value, std, temperature), rng)
        assert change is not None
        p[k] = change.p
    for level in (0.2, 0.05):
        alarms = int(np.sum(p < level))
        # the weights are estimated, so the rate may exceed the level by 20 %
        assert alarms <= stats.binom.ppf(1.0 - FAILURE_P, runs, 1.2 * level), (seed, level)
    if between == 5.0:  # not conservative if the scatter between visits dominates
        assert np.sum(p < 0.2) >= stats.binom.ppf(FAILURE_P, runs, 0.2 / 1.5), seed


def test_a_step_is_located() -> None:
    rng = np.random.default_rng(3)
    value = 100.0 + 0.3 * rng.normal(size=24)
    value[15:] -= 2.0
    change = found(series(value, 0.2))
    assert (change.kind, change.first) == ("step", 15)
    assert change.size == pytest.approx(-2.0, abs=4.0 * change.size_std)
    assert change.level == pytest.approx(100.0, abs=0.4)
    assert change.p < 1e-5
    assert 0.1 < change.repeatability < 0.5


def test_the_beginning_of_a_drift_is_located() -> None:
    value = 10.0 + 0.01 * np.random.default_rng(1).normal(size=24)
    value[12:] += 0.1 * np.arange(1, 13)
    change = found(series(value, 0.005))
    assert change.kind == "drift since"
    assert abs(change.first - 11) <= 1
    assert change.size == pytest.approx(1.2, rel=0.05)
    line = list(fitted_line(change, series(value)))
    assert line[0][1] == line[1][1] == change.level
    assert line[-1] == (7.0 * 23, change.level + change.size)


def test_a_covariate_explains_a_change() -> None:
    rng = np.random.default_rng(2)
    temperature = 20.0 + np.linspace(0.0, 8.0, 20) + 3.0 * rng.normal(size=20)
    value = 0.06 * (1.0 - 0.01 * (temperature - 20.0)) + 1e-4 * rng.normal(size=20)
    assert found(series(value, 5e-5)).p < 0.01
    assert found(series(value, 5e-5, temperature[:, None])).p > 0.05


def test_redundant_covariates_are_dropped() -> None:
    rng = np.random.default_rng(0)
    temperature = rng.normal(size=12)
    table = np.column_stack(
        [temperature, np.full(12, 3.0), 2.0 * temperature - 5.0, rng.normal(size=12)]
    )
    X = regressors(series(np.zeros(12), 1.0, table))
    assert X.shape == (12, 3)
    np.testing.assert_allclose(X[:, 1:].mean(axis=0), 0.0, atol=1e-12)


def test_time_as_a_covariate_allows_no_test() -> None:
    visits = series(np.arange(10.0), 1.0, np.arange(10.0)[:, None])
    assert fit_change(visits, np.random.default_rng(0)) is None


def test_too_few_visits_or_equal_times_allow_no_test() -> None:
    rng = np.random.default_rng(0)
    assert fit_change(series(np.zeros(MIN_VISITS)), rng) is None
    assert fit_change(series(rng.normal(size=MIN_VISITS + 1)), rng) is not None
    equal_times = ParameterSeries(np.zeros(12), rng.normal(size=12), np.ones(12), np.empty((12, 0)))
    assert fit_change(equal_times, rng) is None


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 4.0))
def test_the_moment_equation_is_solved(seed: int, between: float) -> None:
    rng = np.random.default_rng(seed)
    std = np.exp(rng.normal(size=15))
    value = between * rng.normal(size=15) + std * rng.normal(size=15)
    X = np.column_stack([np.ones(15), np.arange(15.0)])
    tau2 = estimate_visit_variance(value, std, X)
    root = 1.0 / np.sqrt(std**2 + tau2)
    residual = (
        root * value - (X * root[:, None]) @ np.linalg.lstsq(X * root[:, None], root * value)[0]
    )
    total = float(residual @ residual)
    assert total == pytest.approx(13.0, rel=1e-6) if tau2 > 0.0 else total <= 13.0


def test_the_moment_estimate_is_unbiased() -> None:
    rng = np.random.default_rng(0)
    std = np.exp(0.5 * rng.normal(size=30))
    X = np.ones((30, 1))
    variances = [
        estimate_visit_variance(2.0 * rng.normal(size=30) + std * rng.normal(size=30), std, X)
        for _ in range(400)
    ]
    assert float(np.mean(variances)) == pytest.approx(
        4.0, rel=0.08
    )  # tolerance: four standard errors


def test_the_union_of_caps_equals_a_monte_carlo_count() -> None:
    """Steps and drifts in 12 visits, compared with 1,000,000 random directions."""
    rng = np.random.default_rng(7)
    n = 12
    columns = np.column_stack(
        [np.arange(n), *((np.arange(n) >= k).astype(float) for k in range(2, n))]
    )
    basis = np.linalg.qr(np.ones((n, 1)), mode="complete")[0]
    free = basis[:, 1:]
    directions = free @ (free.T @ columns)
    directions /= np.sqrt(np.sum(directions**2, axis=0))
    u = rng.normal(size=(1_000_000, n - 1))
    u /= np.sqrt(np.sum(u * u, axis=1))[:, None]
    share = np.max((u @ (free.T @ directions)) ** 2, axis=1)
    for quantile in (0.5, 0.95, 0.999):
        limit = float(np.quantile(share, quantile))
        p = cap_union_probability(limit, directions, free, rng)
        assert p == pytest.approx(
            1.0 - quantile, rel=0.08
        )  # 3 % for 1,000 counts, and 3 % for the samples of cap_union_probability


def test_one_direction_gives_student_s_t_and_small_p_values_add_up() -> None:
    rng = np.random.default_rng(0)
    free, orthogonal = np.eye(9), np.eye(9)[:, :4]
    for t2 in (0.3, 9.0, 400.0):
        share = t2 / (t2 + 8.0)
        assert cap_union_probability(share, orthogonal[:, :1], free, rng) == pytest.approx(
            student_tail(np.sqrt(t2), 8)
        )
    assert cap_union_probability(share, orthogonal, free, rng) == pytest.approx(
        4.0 * student_tail(np.sqrt(t2), 8)
    )
    assert cap_union_probability(1.0, orthogonal, free, rng) == 0.0
    assert cap_union_probability(0.0, orthogonal, free, rng) == pytest.approx(1.0)
