"""Trust-region least squares against SciPy, with bounds, and for problems without descent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from strainwave.domain import BoolArray, FloatArray, SearchEnd
from strainwave.numerics.search import Flat, Linearised, Minimum, minimise

Residual = Callable[[FloatArray], FloatArray]
FAR = 1e6


def rosenbrock(x: FloatArray) -> FloatArray:
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def two_decays(x: FloatArray) -> FloatArray:
    """Sum of two similar exponentials, with a residual that no parameters remove."""
    t = np.linspace(0.0, 4.0, 60)
    data = 2.0 * np.exp(-0.7 * t) + 1.0 * np.exp(-2.5 * t) + 0.02 * np.cos(9.0 * t)
    return np.asarray(x[0] * np.exp(-x[1] * t) + x[2] * np.exp(-x[3] * t) - data)


def badly_scaled(x: FloatArray) -> FloatArray:
    """Residuals whose parameters differ by a factor of a million."""
    return np.array([1e3 * (x[0] - 1e-3), 1e-3 * (x[1] - 1e3), x[0] * x[1] - 1.5])


@dataclass(frozen=True)
class Box:
    """Bounds, and a limit of the step length."""

    reach: FloatArray
    farthest: float = np.inf

    def move(self, x: FloatArray, step: FloatArray) -> FloatArray:
        return np.asarray(np.clip(x + step, -self.reach, self.reach))

    def at_bounds(self, x: FloatArray, gradient: FloatArray) -> BoolArray:
        return np.asarray((np.abs(x) >= self.reach) & (np.sign(x) * gradient < 0.0))

    def limit_step(self, x: FloatArray, step: FloatArray, share: float) -> FloatArray:
        near = np.clip(step, -share * self.farthest, share * self.farthest)
        return np.asarray(np.clip(near, -self.reach - x, self.reach - x))


class Problem:
    """Residual function in the form that `minimise` requires, with a list of evaluated points."""

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
) -> Minimum:
    problem = Problem(residual)
    x = np.array(start)
    result = minimise(
        problem.linearise,
        x,
        Box(np.broadcast_to(np.asarray(reach), x.shape), farthest),
        tolerance=tolerance,
        max_evaluations=max_evaluations,
    )
    assert result is not None
    # every evaluation counts, whether its step was accepted or rejected
    assert result.evaluations == len(problem.looked_at)
    return result


def linear(seed: int, rows: int = 12, n: int = 4) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-2.0, 2.0, n)
    return rng.normal(size=(rows, n)) * scale, rng.normal(size=rows)


@pytest.mark.parametrize("seed", range(5))
def test_a_linear_problem_is_solved_at_once(seed: int) -> None:
    A, b = linear(seed)
    result = found_for(lambda x: A @ x - b, [0.0] * 4, tolerance=1e-9)
    expected, cost, *_ = np.linalg.lstsq(A, b)
    assert result.end.is_minimum
    # one slightly damped step, and one or two further steps
    assert result.evaluations <= 4
    np.testing.assert_allclose(result.x, expected, rtol=1e-4)
    assert result.at.cost == pytest.approx(float(cost[0]), rel=1e-8)


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
    result = found_for(residual, start)
    reference = least_squares(residual, start, xtol=1e-14, ftol=1e-14, gtol=1e-14, x_scale="jac")
    assert result.end.is_minimum
    np.testing.assert_allclose(result.x, reference.x, rtol=1e-5)
    assert result.at.cost == pytest.approx(2.0 * reference.cost, rel=1e-8, abs=1e-13)


@pytest.mark.parametrize("seed", range(8))
def test_bounds_of_a_linear_problem(seed: int) -> None:
    A, b = linear(seed)
    unbounded = np.linalg.lstsq(A, b)[0]
    # bounds exclude the unbounded solution in two of four coordinates
    reach = np.abs(unbounded) * np.array([0.3, 2.0, 0.6, 2.0])
    result = found_for(lambda x: A @ x - b, [0.0] * 4, reach.tolist(), tolerance=1e-12)
    reference = lsq_linear(A, b, (-reach, reach), method="bvls", tol=1e-14)
    assert result.end.is_minimum
    assert np.all(np.abs(result.x) <= reach)
    np.testing.assert_allclose(result.x, reference.x, atol=1e-4 * float(np.max(reach)))
    assert result.at.cost == pytest.approx(2.0 * reference.cost, rel=1e-7)


@pytest.mark.parametrize("reach", [[0.5, 2.0], [2.0, 0.5], [0.3, 0.05]])
def test_bounds_of_a_curved_problem(reach: list[float]) -> None:
    result = found_for(rosenbrock, [-0.2, 0.04], reach)
    bounds = ([-reach[0], -reach[1]], reach)
    reference = least_squares(rosenbrock, [-0.2, 0.04], bounds=bounds, xtol=1e-14, gtol=1e-14)
    assert result.end.is_minimum
    # SciPy's iterates stay strictly inside the bounds
    np.testing.assert_allclose(result.x, reference.x, atol=2e-5)
    assert result.at.cost <= 2.0 * reference.cost + 1e-9
    assert np.any(np.abs(result.x) == np.array(reach))


def test_a_start_at_a_bound_comes_away_from_it() -> None:
    result = found_for(rosenbrock, [-2.0, 2.0], [2.0, 2.0])
    np.testing.assert_allclose(result.x, [1.0, 1.0], rtol=1e-5)


def test_short_steps_stay_in_a_narrow_valley() -> None:
    """Steps of limited length follow the valley: the sum stays near its optimum.

    The residual is 1000 times more sensitive to the sum of the unknowns than to each of them, and
    both start 8 away from the optimum.
    """
    A = np.array([[1.0, 1.0], [0.0, 1e-3]])
    optimum = np.array([-8.0, 8.0])
    problem = Problem(lambda x: np.asarray(A @ (x - optimum)))
    result = minimise(
        problem.linearise,
        np.zeros(2),
        Box(np.full(2, FAR), farthest=1.0),
        tolerance=1e-12,
        max_evaluations=100,
    )
    assert result is not None
    np.testing.assert_allclose(result.x, optimum, rtol=1e-3)
    # about one evaluation per step length, and all along the valley
    assert result.evaluations < 16
    assert max(abs(np.sum(x)) for x in problem.looked_at) < 1e-3


def test_an_unknown_without_information_does_not_change() -> None:
    A, b = linear(0)
    A[:, 2] = 0.0
    result = found_for(lambda x: A @ x - b, [0.0, 0.0, 0.7, 0.0], tolerance=1e-9)
    assert result.end.is_minimum
    assert result.x[2] == 0.7
    assert result.at.cost == pytest.approx(float(np.sum((A @ np.linalg.pinv(A) @ b - b) ** 2)))


def test_twins_do_not_run_away() -> None:
    A, b = linear(1)
    # Exact derivatives: difference quotients would separate the two columns by rounding.
    A[:, 3] = 2.0 * A[:, 1]

    def cost(x: FloatArray) -> float:
        return float(np.sum((A @ x - b) ** 2))

    def linearise(x: FloatArray) -> Linearised:
        factor = np.linalg.qr(np.column_stack([A, A @ x - b]), mode="r")
        return Linearised(cost(x), np.asarray(factor))

    result = minimise(linearise, np.zeros(4), Flat(), tolerance=1e-9, max_evaluations=50)
    minimum_norm = np.linalg.pinv(A) @ b
    assert result is not None
    assert result.end.is_minimum
    assert result.at.cost == pytest.approx(cost(minimum_norm))
    assert np.max(np.abs(result.x)) < 10.0 * np.max(np.abs(minimum_norm))


def test_steps_into_nowhere_are_refused() -> None:
    """The undamped Gauss-Newton step from -2 ends near 4, where the cost is undefined."""

    def residual(x: FloatArray) -> FloatArray:
        return np.array([np.exp(x[0]) - np.exp(-0.1)])

    problem = Problem(residual)

    def walled(x: FloatArray) -> Linearised | None:
        linearised = problem.linearise(x)
        return None if x[0] > 0.0 else linearised

    result = minimise(walled, np.array([-2.0]), Flat(), tolerance=1e-12, max_evaluations=100)
    assert result is not None
    assert result.end.is_minimum
    assert result.x[0] == pytest.approx(-0.1, abs=1e-6)
    assert result.evaluations == len(problem.looked_at)
    assert max(x[0] for x in problem.looked_at) > 0.0


def test_an_invalid_start_gives_no_minimum() -> None:
    looked_at: list[FloatArray] = []

    def nowhere(x: FloatArray) -> None:
        looked_at.append(x)

    result = minimise(nowhere, np.ones(1), Flat(), tolerance=1e-12, max_evaluations=100)
    assert result is None
    assert len(looked_at) == 1


@pytest.mark.parametrize(
    ("tolerance", "end"), [(1e-4, SearchEnd.NO_DESCENT), (0.1, SearchEnd.STALLED)]
)
def test_it_ends_where_no_step_helps(tolerance: float, end: SearchEnd) -> None:
    """With an inconsistent gradient, only a small predicted decrease counts as a minimum."""

    def linearise(x: FloatArray) -> Linearised:
        return Linearised(1.0 + float(np.sum(x**2)), np.array([[1.0, 1.0], [0.0, 0.0]]))

    result = minimise(linearise, np.zeros(1), Flat(), tolerance=tolerance, max_evaluations=100)
    assert result is not None
    assert result.x[0] == 0.0
    assert result.end is end
    assert 1 < result.evaluations < 100


def test_it_ends_where_limited_steps_gain_less_than_the_tolerance() -> None:
    """A hundred of them would be needed for a gain of one."""
    problem = Problem(lambda x: x - 100.0)
    box = Box(np.full(1, 1e3), farthest=1e-5)
    result = minimise(problem.linearise, np.zeros(1), box, tolerance=1.0, max_evaluations=100)
    assert result is not None
    assert result.end is SearchEnd.STALLED
    assert result.evaluations < 8


def test_no_step_increases_the_cost() -> None:
    problem = Problem(two_decays)
    start = np.array([3.0, 4.0, -2.0, 0.1])
    reach = np.full(4, 10.0)
    costs = []
    for max_evaluations in range(1, 20):
        result = minimise(
            problem.linearise, start, Box(reach), tolerance=1e-10, max_evaluations=max_evaluations
        )
        assert result is not None
        assert result.at.cost == problem.cost(result.x)
        costs.append(result.at.cost)
    looked_at = [problem.cost(x) for x in problem.looked_at[-max_evaluations:]]
    # some steps were rejected
    assert np.any(np.diff(looked_at) > 0.0)
    assert np.all(np.diff(costs) <= 0.0)
    assert costs[-1] < 0.5 * costs[0]


@pytest.mark.parametrize("residual", [rosenbrock, two_decays])
def test_the_cost_alone_rejects_steps_that_follow_a_rejected_one(residual: Residual) -> None:
    start = np.array([3.0, 4.0, -2.0, 0.1])[: 2 if residual is rosenbrock else 4]
    problems = [Problem(residual), Problem(residual)]
    plain, quick = (
        minimise(one.linearise, start, Flat(), tolerance=1e-10, max_evaluations=300, cost=cost)
        for one, cost in zip(problems, [None, problems[0].cost], strict=True)
    )
    assert plain is not None
    assert quick is not None
    assert np.array_equal(plain.x, quick.x)
    assert (plain.evaluations, plain.end) == (quick.evaluations, quick.end)
    assert len(problems[1].looked_at) <= len(problems[0].looked_at) == plain.evaluations


def test_the_cost_alone_rejects_all_but_the_first_step_where_none_helps() -> None:
    looked_at = []

    def cost(x: FloatArray) -> float:
        return 1.0 + float(np.sum(x**2))

    def linearise(x: FloatArray) -> Linearised:
        looked_at.append(x)
        return Linearised(cost(x), np.array([[1.0, 1.0], [0.0, 0.0]]))

    result = minimise(
        linearise, np.zeros(1), Flat(), tolerance=1e-4, max_evaluations=100, cost=cost
    )
    assert result is not None
    assert (result.x[0], result.end) == (0.0, SearchEnd.NO_DESCENT)
    assert result.evaluations == len(looked_at) == 2  # the start and the first step


def test_an_exhausted_budget_is_not_convergence() -> None:
    result = found_for(rosenbrock, [-1.2, 1.0], max_evaluations=4)
    assert result.end is SearchEnd.EVALUATION_LIMIT
    assert result.evaluations == 4
    assert result.at.cost < Problem(rosenbrock).cost(np.array([-1.2, 1.0]))


def test_the_tolerance_is_in_units_of_the_cost() -> None:
    best = found_for(two_decays, [1.0, 0.3, 1.0, 4.0])
    evaluations = []
    for tolerance in (1e-2, 1e-6):
        result = found_for(two_decays, [1.0, 0.3, 1.0, 4.0], tolerance=tolerance)
        assert result.end.is_minimum
        assert best.at.cost <= result.at.cost < best.at.cost + 3.0 * tolerance
        evaluations.append(result.evaluations)
    assert evaluations[0] < evaluations[1] <= best.evaluations


def test_a_cliff_ends_the_search_at_its_edge() -> None:
    """The cost jumps beyond 0.5, so the predicted decrease is never achieved."""

    def linearise(x: FloatArray) -> Linearised:
        residual = float(100.0 * (x[0] - 1.0))
        cost = residual**2 + (1e6 if x[0] > 0.5 else 0.0)
        return Linearised(cost, np.array([[100.0, residual], [0.0, 0.0]]))

    result = minimise(linearise, np.zeros(1), Box(np.ones(1)), tolerance=0.01, max_evaluations=200)
    assert result is not None
    assert result.evaluations < 60
    assert result.end.is_minimum
    assert 0.4 < result.x[0] <= 0.5


def test_a_jump_of_the_cost_ends_a_rough_search_at_its_first_step() -> None:
    looked_at, tried = [], []

    def cost(x: FloatArray) -> float:
        tried.append(x)
        return float((x[0] - 1.0) ** 2 + (50.0 if x[0] > 0.9 else 0.0))

    def linearise(x: FloatArray) -> Linearised:
        looked_at.append(x)
        return Linearised(cost(x), np.array([[1.0, float(x[0] - 1.0)], [0.0, 0.0]]))

    ends = {}
    for rough in (False, True):
        looked_at.clear()
        tried.clear()
        result = minimise(
            linearise,
            np.array([0.5]),
            Flat(),
            tolerance=0.01,
            damping=1e-8,
            near=True,
            rough=rough,
            max_evaluations=100,
            cost=cost,
        )
        assert result is not None
        assert len(looked_at) == 2  # later steps are tried by their costs
        ends[rough] = result.end, len(tried)
    assert ends[True] == (SearchEnd.STALLED, 2)  # the start and the step
    assert ends[False][1] > 2


def test_steps_that_gain_more_than_predicted_are_lengthened() -> None:
    """The linearised problem is three times as stiff as the cost, so whole steps are too short."""

    def cost(x: FloatArray) -> float:
        return float((x[0] - 1.0) ** 2)

    def linearise(x: FloatArray) -> Linearised:
        gradient = float(x[0] - 1.0)
        return Linearised(cost(x), np.array([[3.0, gradient / 3.0], [0.0, 0.0]]))

    def evaluations(near: bool) -> int:
        start, costs = np.array([0.0]), cost if near else None
        result = minimise(
            linearise, start, Flat(), tolerance=1e-6, near=near, max_evaluations=100, cost=costs
        )
        assert result is not None
        assert result.end.is_minimum
        assert result.x[0] == pytest.approx(1.0, abs=0.01)
        return result.evaluations

    assert evaluations(near=True) < 0.5 * evaluations(near=False)


def test_limited_steps_of_a_linear_problem_never_increase_the_cost() -> None:
    """Of nearly collinear columns, holding one coordinate at its limit can misdirect the others."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        A = rng.normal(size=(12, 1)) + 1e-3 * rng.normal(size=(12, 5))
        b = rng.normal(size=12)
        problem = Problem(lambda x, A=A, b=b: A @ x - b)  # type: ignore[misc]
        result = minimise(
            problem.linearise,
            np.zeros(5),
            Box(np.full(5, FAR), 1.0),
            tolerance=1e-9,
            damping=1e-9,
            max_evaluations=20,
        )
        assert result is not None
        assert np.all(np.diff([problem.cost(x) for x in problem.looked_at]) < 0.0)
