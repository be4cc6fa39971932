"""Joint tests and adjusted p-values, compared with their distributions and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from strainwave.fleet.monitoring.significance import adjust_p_values, joint_test, welch_test

KNOWN = float("inf")


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 12))
def test_the_statistic_equals_the_quadratic_form(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n)) + 2.0 * np.eye(n)
    S, d = root @ root.T, rng.normal(size=n)
    test = joint_test(d, [S], [KNOWN])
    assert test is not None
    if np.linalg.cond(S) < 1e6:  # otherwise the test omits directions as dependent
        expected = float(d @ np.linalg.solve(S, d))
        assert test.statistic == pytest.approx(expected, rel=1e-6)
        assert test.rank == n
        assert test.p == pytest.approx(stats.chi2.sf(expected, n), rel=1e-5)


def test_dependent_values_do_not_count_and_units_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    W = np.vstack([np.eye(3), [1.0, 2.0, 0.0]])
    root = rng.normal(size=(3, 3))
    S3, d3 = root @ root.T, rng.normal(size=3)
    units = np.diag([1e-6, 1e4, 1.0, 1e3])
    test = joint_test(units @ W @ d3, [units @ W @ S3 @ W.T @ units], [KNOWN])
    reference = joint_test(d3, [S3], [KNOWN])
    assert test is not None
    assert reference is not None
    assert (test.rank, test.n_values) == (3, 4)
    assert test.statistic == pytest.approx(reference.statistic, rel=1e-6)


def test_estimated_covariances_keep_the_level() -> None:
    """For covariances with 12 degrees of freedom, a chi-square test would reject about 20 %."""
    rng = np.random.default_rng(8)
    nu, n, runs = 12, 4, 2000
    p, naive = np.empty(runs), np.empty(runs)
    for k in range(runs):
        parts = [np.cov(rng.normal(size=(nu + 1, n)), rowvar=False) * scale for scale in (1.0, 3.0)]
        d = rng.normal(size=n) + np.sqrt(3.0) * rng.normal(size=n)
        test, reference = joint_test(d, parts, [nu, nu]), joint_test(d, parts, [KNOWN, KNOWN])
        assert test is not None
        assert reference is not None
        p[k], naive[k] = test.p, reference.p
    # 99.9 % interval of a binomial distribution, plus 0.5 % for the approximation of the test
    low, high = stats.binom.ppf([5e-4, 1 - 5e-4], runs, 0.05) / runs
    assert low - 0.005 < np.mean(p < 0.05) < high + 0.005
    assert np.mean(naive < 0.05) > 0.12


def test_too_few_degrees_give_no_test() -> None:
    assert joint_test(np.zeros(5), [np.eye(5)], [4.0]) is None
    assert joint_test(np.zeros(0), [np.zeros((0, 0))], [KNOWN]) is None
    assert joint_test(np.zeros(2), [np.diag([1.0, 0.0])], [KNOWN]) is None


def test_one_difference_is_tested_as_by_welch() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=9), 3.0 * rng.normal(size=15)
    stds = [float(np.std(x, ddof=1) / np.sqrt(len(x))) for x in (a, b)]
    _, p = welch_test(float(b.mean() - a.mean()), stds, [8.0, 14.0])
    assert p == pytest.approx(stats.ttest_ind(a, b, equal_var=False).pvalue, rel=1e-9)
    z, p = welch_test(3.0, [0.0, 1.5], [KNOWN, KNOWN])
    assert z == 2.0
    assert p == pytest.approx(2.0 * stats.norm.sf(2.0))


def test_the_holm_adjustment_of_an_example() -> None:
    assert adjust_p_values([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert adjust_p_values([]) == []


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=30))
def test_adjusted_p_values_are_larger_and_keep_the_order(p: list[float]) -> None:
    adjusted = adjust_p_values(p)
    assert all(a >= b for a, b in zip(adjusted, p, strict=True))
    assert min(adjusted) == pytest.approx(min(1.0, len(p) * min(p)))
    order = np.argsort(p, kind="stable")
    assert np.all(np.diff(np.array(adjusted)[order]) >= 0.0)
