"""The trust region against SciPy's, within bounds, and where nothing helps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from strainwave.domain import BoolArray, FloatArray
from strainwave.numerics.trust_region import Flat, Found, Linearised, minimise

Residual = Callable[[FloatArray], FloatArray]
FAR = 1e6


def rosenbrock(x: FloatArray) -> FloatArray:
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def two_decays(x: FloatArray) -> FloatArray:
    """Two exponentials that resemble each other, with an error that no values remove."""
    t = np.linspace(0.0, 4.0, 60)
    data = 2.0 * np.exp(-0.7 * t) + 1.0 * np.exp(-2.5 * t) + 0.02 * np.cos(9.0 * t)
    return np.asarray(x[0] * np.exp(-x[1] * t) + x[2] * np.exp(-x[3] * t) - data)


def badly_scaled(x: FloatArray) -> FloatArray:
    """Unknowns whose sizes are a million apart."""
    return np.array([1e3 * (x[0] - 1e-3), 1e-3 * (x[1] - 1e3), x[0] * x[1] - 1.5])


@dataclass(frozen=True)
class Box:
    """Bounds, and how long a step may be."""

    reach: FloatArray
    farthest: float = np.inf

    def moved(self, x: FloatArray, step: FloatArray) -> FloatArray:
        return np.asarray(np.clip(x + step, -self.reach, self.reach))

    def bounded(self, x: FloatArray, gradient: FloatArray) -> BoolArray:
        return np.asarray((np.abs(x) >= self.reach) & (np.sign(x) * gradient < 0.0))

    def trusted(self, x: FloatArray, step: FloatArray, share: float) -> FloatArray:
        near = np.clip(step, -share * self.farthest, share * self.farthest)
        return np.asarray(np.clip(near, -self.reach - x, self.reach - x))


class Problem:
    """Residuals as what `minimise` takes, and what it asked for."""

    def __init__(self, residual: Residual) -> None:
        self.residual = residual
        self.looked_at: list[FloatArray] = []

    def cost(self, x: FloatArray) -> float:
        return float(np.sum(self.residual(x) ** 2))

    def linearise(self, x: FloatArray) -> Linearised:
        self.looked_at.append(x.copy())
        r = self.residual(x)
        h = 1e-6 * np.maximum(np.abs(x), 1e-3)
        slopes = [
            (self.residual(x + step) - self.residual(x - step)) / (2.0 * size)
            for step, size in zip(np.diag(h), h, strict=True)
        ]
        table = np.column_stack([*slopes, r])
        return Linearised(float(np.sum(r**2)), np.asarray(np.linalg.qr(table, mode="r")))


def found_for(
    residual: Residual,
    start: list[float],
    reach: list[float] | float = FAR,
    *,
    farthest: float = np.inf,
    tolerance: float = 1e-14,
    max_evaluations: int = 300,
) -> Found:
    problem = Problem(residual)
    x = np.array(start)
    found = minimise(
        problem.linearise,
        x,
        Box(np.broadcast_to(np.asarray(reach), x.shape), farthest),
        tolerance=tolerance,
        max_evaluations=max_evaluations,
    )
    assert found is not None
    # every look counts, whether its step was taken or refused
    assert found.evaluations == len(problem.looked_at)
    return found


def linear(seed: int, rows: int = 12, n: int = 4) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-2.0, 2.0, n)
    return rng.normal(size=(rows, n)) * scale, rng.normal(size=rows)


@pytest.mark.parametrize("seed", range(5))
def test_a_linear_problem_is_solved_at_once(seed: int) -> None:
    A, b = linear(seed)
    found = found_for(lambda x: A @ x - b, [0.0] * 4, tolerance=1e-9)
    expected, cost, *_ = np.linalg.lstsq(A, b)
    assert found.converged
    # a first, slightly damped step and one or two to finish it
    assert found.evaluations <= 4
    np.testing.assert_allclose(found.x, expected, rtol=1e-4)
    assert found.at.cost == pytest.approx(float(cost[0]), rel=1e-8)


@pytest.mark.parametrize(
    ("residual", "start"),
    [
        (rosenbrock, [-1.2, 1.0]),
        (rosenbrock, [3.0, -4.0]),
        (two_decays, [1.0, 0.3, 1.0, 4.0]),
        (badly_scaled, [1e-2, 10.0]),
    ],
)
def test_it_ends_where_scipy_does(residual: Residual, start: list[float]) -> None:
    found = found_for(residual, start)
    reference = least_squares(residual, start, xtol=1e-14, ftol=1e-14, gtol=1e-14, x_scale="jac")
    assert found.converged
    np.testing.assert_allclose(found.x, reference.x, rtol=1e-5)
    assert found.at.cost == pytest.approx(2.0 * reference.cost, rel=1e-8, abs=1e-13)


@pytest.mark.parametrize("seed", range(8))
def test_bounds_of_a_linear_problem(seed: int) -> None:
    A, b = linear(seed)
    free = np.linalg.lstsq(A, b)[0]
    # two of the four are kept from where they would go
    reach = np.abs(free) * np.array([0.3, 2.0, 0.6, 2.0])
    found = found_for(lambda x: A @ x - b, [0.0] * 4, reach.tolist(), tolerance=1e-12)
    reference = lsq_linear(A, b, (-reach, reach), method="bvls", tol=1e-14)
    assert found.converged
    assert np.all(np.abs(found.x) <= reach)
    np.testing.assert_allclose(found.x, reference.x, atol=1e-4 * float(np.max(reach)))
    assert found.at.cost == pytest.approx(2.0 * reference.cost, rel=1e-7)


@pytest.mark.parametrize("reach", [[0.5, 2.0], [2.0, 0.5], [0.3, 0.05]])
def test_bounds_of_a_curved_problem(reach: list[float]) -> None:
    found = found_for(rosenbrock, [-0.2, 0.04], reach)
    bounds = ([-reach[0], -reach[1]], reach)
    reference = least_squares(rosenbrock, [-0.2, 0.04], bounds=bounds, xtol=1e-14, gtol=1e-14)
    assert found.converged
    # SciPy stays inside its bounds, by a little
    np.testing.assert_allclose(found.x, reference.x, atol=2e-5)
    assert found.at.cost <= 2.0 * reference.cost + 1e-9
    assert np.any(np.abs(found.x) == np.array(reach))


def test_a_start_at_a_bound_comes_away_from_it() -> None:
    found = found_for(rosenbrock, [-2.0, 2.0], [2.0, 2.0])
    np.testing.assert_allclose(found.x, [1.0, 1.0], rtol=1e-5)


def test_short_steps_stay_in_a_narrow_valley() -> None:
    """The sum is reported a thousand times better than its parts, which are 8 away."""
    A = np.array([[1.0, 1.0], [0.0, 1e-3]])
    there = np.array([-8.0, 8.0])
    problem = Problem(lambda x: np.asarray(A @ (x - there)))
    found = minimise(
        problem.linearise,
        np.zeros(2),
        Box(np.full(2, FAR), farthest=1.0),
        tolerance=1e-12,
        max_evaluations=100,
    )
    assert found is not None
    np.testing.assert_allclose(found.x, there, rtol=1e-3)
    # hardly more steps than there are lengths, and each along the valley
    assert found.evaluations < 16
    assert max(abs(np.sum(x)) for x in problem.looked_at) < 1e-3


def test_what_nothing_shows_of_stays_where_it_is() -> None:
    A, b = linear(0)
    A[:, 2] = 0.0
    found = found_for(lambda x: A @ x - b, [0.0, 0.0, 0.7, 0.0], tolerance=1e-9)
    assert found.converged
    assert found.x[2] == 0.7
    assert found.at.cost == pytest.approx(float(np.sum((A @ np.linalg.pinv(A) @ b - b) ** 2)))


def test_twins_do_not_run_away() -> None:
    A, b = linear(1)
    A[:, 3] = 2.0 * A[:, 1]  # exactly: differences would separate the two by their rounding

    def cost(x: FloatArray) -> float:
        return float(np.sum((A @ x - b) ** 2))

    def linearise(x: FloatArray) -> Linearised:
        factor = np.linalg.qr(np.column_stack([A, A @ x - b]), mode="r")
        return Linearised(cost(x), np.asarray(factor))

    found = minimise(linearise, np.zeros(4), Flat(), tolerance=1e-9, max_evaluations=50)
    least = np.linalg.pinv(A) @ b
    assert found is not None
    assert found.converged
    assert found.at.cost == pytest.approx(cost(least))
    assert np.max(np.abs(found.x)) < 10.0 * np.max(np.abs(least))


def test_steps_into_nowhere_are_refused() -> None:
    """A plain Gauss-Newton step from -2 lands at about 4, beyond the wall."""

    def residual(x: FloatArray) -> FloatArray:
        return np.array([np.exp(x[0]) - np.exp(-0.1)])

    problem = Problem(residual)

    def walled(x: FloatArray) -> Linearised | None:
        at = problem.linearise(x)
        return None if x[0] > 0.0 else at

    found = minimise(walled, np.array([-2.0]), Flat(), tolerance=1e-12, max_evaluations=100)
    assert found is not None
    assert found.converged
    assert found.x[0] == pytest.approx(-0.1, abs=1e-6)
    assert found.evaluations == len(problem.looked_at)
    assert max(x[0] for x in problem.looked_at) > 0.0


def test_there_is_nothing_to_find_where_there_is_no_problem() -> None:
    looked_at: list[FloatArray] = []

    def nowhere(x: FloatArray) -> None:
        looked_at.append(x)

    found = minimise(nowhere, np.ones(1), Flat(), tolerance=1e-12, max_evaluations=100)
    assert found is None
    assert len(looked_at) == 1


@pytest.mark.parametrize(("tolerance", "converged"), [(1e-4, False), (0.1, True)])
def test_it_ends_where_no_step_helps(tolerance: float, converged: bool) -> None:
    """A slope that is not the cost's: a little of a gain is forgiven, not much of it."""

    def linearise(x: FloatArray) -> Linearised:
        return Linearised(1.0 + float(np.sum(x**2)), np.array([[1.0, 1.0], [0.0, 0.0]]))

    found = minimise(linearise, np.zeros(1), Flat(), tolerance=tolerance, max_evaluations=100)
    assert found is not None
    assert found.x[0] == 0.0
    assert found.converged is converged
    assert 1 < found.evaluations < 100


def test_no_step_is_taken_that_raises_the_cost() -> None:
    problem = Problem(two_decays)
    start = np.array([3.0, 4.0, -2.0, 0.1])
    reach = np.full(4, 10.0)
    costs = []
    for most in range(1, 20):
        found = minimise(
            problem.linearise, start, Box(reach), tolerance=1e-10, max_evaluations=most
        )
        assert found is not None
        assert found.at.cost == problem.cost(found.x)
        costs.append(found.at.cost)
    looked_at = [problem.cost(x) for x in problem.looked_at[-most:]]
    # some looks were refused
    assert np.any(np.diff(looked_at) > 0.0)
    assert np.all(np.diff(costs) <= 0.0)
    assert costs[-1] < 0.5 * costs[0]


def test_it_says_so_when_evaluations_run_out() -> None:
    found = found_for(rosenbrock, [-1.2, 1.0], max_evaluations=4)
    assert not found.converged
    assert found.evaluations == 4
    assert found.at.cost < Problem(rosenbrock).cost(np.array([-1.2, 1.0]))


def test_the_tolerance_is_in_units_of_the_cost() -> None:
    best = found_for(two_decays, [1.0, 0.3, 1.0, 4.0])
    evaluations = []
    for tolerance in (1e-2, 1e-6):
        found = found_for(two_decays, [1.0, 0.3, 1.0, 4.0], tolerance=tolerance)
        assert found.converged
        assert best.at.cost <= found.at.cost < best.at.cost + 3.0 * tolerance
        evaluations.append(found.evaluations)
    assert evaluations[0] < evaluations[1] <= best.evaluations


def test_a_cliff_ends_the_search_at_its_edge() -> None:
    """Beyond one half the cost is a hundred higher: the predicted gain is never to be had."""

    def linearise(x: FloatArray) -> Linearised:
        off = float(100.0 * (x[0] - 1.0))
        cost = off**2 + (1e6 if x[0] > 0.5 else 0.0)
        return Linearised(cost, np.array([[100.0, off], [0.0, 0.0]]))

    found = minimise(linearise, np.zeros(1), Box(np.ones(1)), tolerance=0.01, max_evaluations=200)
    assert found is not None
    assert found.evaluations < 60
    assert found.converged
    assert 0.4 < found.x[0] <= 0.5
