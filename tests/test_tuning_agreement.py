"""Whether the rigid and the whole-arm fit agree: the statistic's distribution, and faults."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.records import FloatArray, StageDifference
from strainwave.tuning.agreement import DISAGREES, disagreement
from strainwave.tuning.confidence import residual_covariance

N_RUNS = 4000


def problem(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Prior rows whitened, their errors' covariance, and the records' information."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(4, 6))
    errors = np.diag(rng.uniform(0.2, 1.0, 4))  # less than one by a least deviation
    columns = rng.normal(size=(30, 6))
    return rows, errors, columns.T @ columns


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_differences_scatter_as_their_covariance_says(seed: int) -> None:
    """Fits of simulated priors and records: normalised squares are chi-square."""
    rows, errors, information = problem(seed)
    rng = np.random.default_rng(100 + seed)
    answer = rows @ np.linalg.inv(information + rows.T @ rows)
    expected = residual_covariance(errors, answer, rows, information)
    prior = rng.multivariate_normal(np.zeros(4), errors, N_RUNS)
    gradient = rng.multivariate_normal(np.zeros(6), information, N_RUNS)
    # the minimum of |rows x - prior|^2 + (x - g)' information (x - g), g = information^-1 gradient
    x = np.linalg.solve(information + rows.T @ rows, (prior @ rows + gradient).T).T
    left = x @ rows.T - prior
    squares = np.einsum("ki,ij,kj->k", left, np.linalg.inv(expected), left)
    # mean and variance of a chi-square of four degrees, to four standard errors
    assert squares.mean() == pytest.approx(4.0, abs=4.0 * np.sqrt(8.0 / N_RUNS))
    assert squares.var() == pytest.approx(8.0, abs=4.0 * np.sqrt(640.0 / N_RUNS))


def test_of_an_efficient_fit_it_is_the_rigid_variance_less_that_of_the_combination() -> None:
    rows, _, information = problem(3)
    combined = rows @ np.linalg.inv(information + rows.T @ rows) @ rows.T
    answer = rows @ np.linalg.inv(information + rows.T @ rows)
    found = residual_covariance(np.eye(4), answer, rows, information)
    np.testing.assert_allclose(found, np.eye(4) - combined, atol=1e-12)


def test_it_is_a_finding_from_three_deviations_on() -> None:
    near = StageDifference("beta", None, 0.6, 0.6 + 0.99 * DISAGREES * 0.01, 0.01, "kg m^2")
    far = StageDifference("motor_inertia", 2, 5e-5, 5.8e-5, 1e-6, "kg m^2")
    assert list(disagreement((near,))) == []
    (said,) = disagreement((near, far))
    assert said.code == "stages-disagree"
    assert "8.0 standard deviations" in said.message
    assert "motor_inertia of joint 2 5e-05 by the rigid and 5.8e-05" in said.message
    assert "beta" not in said.message
    causes = ("motor constant", "clock", "dead zone", "friction")
    assert sorted(causes, key=said.message.index) == list(causes)
