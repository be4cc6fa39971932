"""Searches: trust-region least squares, and the best choice of one candidate per coordinate.

The least squares are for problems with many rows and few unknowns. Each evaluation returns the
triangular factor R of [J r] = Q R, where J is the weighted Jacobian and r the residual. R has as
many rows as there are unknowns, plus one. SciPy's `least_squares` computes a singular value
decomposition of all rows at every step, which takes longer than their simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Protocol

import numpy as np

from strainwave.domain import BoolArray, FloatArray, SearchEnd
from strainwave.numerics.linalg import singular_values

# Ratio of actual to predicted decrease above which the damping decreases, and below which it
# increases.
_MIN_GOOD_GAIN_RATIO, _MAX_POOR_GAIN_RATIO = 0.75, 0.25
# Coulomb friction makes the cost rough, so a small predicted decrease may not be achievable.
_STALL_EVALUATIONS = 4  # evaluations over which `_MAX_STALL_DECREASE` limits the decrease
_MAX_STALL_DECREASE = 30.0  # decrease, in tolerances, below which the iteration has stalled
# A stalled iteration continues while the predicted decrease exceeds this many tolerances and this
# share of the cost.
_MIN_PREDICTED_TOLERANCES, _MIN_PREDICTED_COST_SHARE = 1000.0, 0.2
# Evaluations without sufficient decrease after which the iteration ends in any case: the cost is
# discontinuous.
_MAX_STALL_EVALUATIONS = 12
# smallest ratio of actual to predicted decrease for which a step is accepted
_MIN_ACCEPTED_GAIN_RATIO = 1e-4
# Ratio of actual to predicted decrease above which a longer step is tried.
_MIN_LONGER_GAIN_RATIO = 1.5
# If the cost rises by more than this many predicted decreases, it is discontinuous at the scale of
# the step.
_MAX_RISE = 10.0
# Smallest damping, and smallest damping after a rejected step.
_MIN_DAMPING, _MIN_DAMPING_AFTER_REJECTION = 1e-9, 1e-3
# Factor on the damping, up to the largest, of a limited step that would increase the cost.
_DAMPING_GROWTH, _MAX_DAMPING = 4.0, 1.0
_STEP_REDUCTION = 0.3  # factor on the trusted step length after a rejected step
_MIN_SINGULAR_VALUE_RATIO = 1e-12  # relative singular value below which a direction is not used


@dataclass(frozen=True, slots=True)
class Linearised:
    """Cost at one point and its linearised least-squares problem."""

    cost: float
    factor: FloatArray  # (n + 1, n + 1) R of [J r]; its sum of squares approximates the cost


class Space(Protocol):
    """Domain of the unknowns: bounds, and the range in which the problem is nearly linear."""

    def move(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Point (n,) after a step from x; to first order x + step."""

    def at_bounds(self, x: FloatArray, gradient: FloatArray) -> BoolArray:
        """Which coordinates (n,) are at a bound that the negative gradient points beyond."""

    def limit_step(self, x: FloatArray, step: FloatArray, share: float) -> FloatArray:
        """Step (n,) limited to the bounds and to a share of the range in which it is linear."""


class Flat:
    """Domain without bounds or step limits."""

    def move(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Sum x + step."""
        return np.asarray(x + step)

    def at_bounds(self, x: FloatArray, gradient: FloatArray) -> BoolArray:
        """No coordinate is at a bound."""
        return np.zeros(len(x), dtype=bool)

    def limit_step(self, x: FloatArray, step: FloatArray, share: float) -> FloatArray:
        """The unchanged step."""
        return step


@dataclass(frozen=True, slots=True)
class Minimum:
    """Result of `minimise`."""

    x: FloatArray  # (n,)
    at: Linearised
    evaluations: int
    end: SearchEnd


def minimise(
    linearise: Callable[[FloatArray], Linearised | None],
    start: FloatArray,
    space: Space,
    *,
    tolerance: float,
    relative: float = 0.0,
    damping: float = 1e-3,
    near: bool = False,
    rough: bool = False,
    max_evaluations: int,
    cost: Callable[[FloatArray], float | None] | None = None,
) -> Minimum | None:
    """Minimise by the Levenberg-Marquardt method in scaled coordinates with limited steps.

    `linearise`: Cost and least-squares problem at a point (n,), or None if it is not defined there.
        `start` (n,).
    `tolerance`: The iteration has converged if the predicted decrease of the cost is below this
        value. If residuals are in standard deviations, 0.01 corresponds to a tenth of a parameter's
        standard deviation.
    `relative`: Tolerance as a share of the cost, added to `tolerance`.
    `damping`: Initial damping, relative to squared singular values of columns of unit length. Use a
        small value if the start is near the minimum.
    `near`: Whether the start is near the minimum, where whole steps may be too short.
    `rough`: Whether the iteration ends where the cost is discontinuous at the scale of a step.
    `max_evaluations`: Maximum number of calls of `linearise`.
    `cost`: Cost alone, where it takes far less time than `linearise`. After a rejected step, the
        next ones are often rejected, so this cost must decrease before they are linearised. Near
        the minimum, longer steps are tried by it after one that was too short.

    Returns None if the problem is not defined at the start.
    """
    x, first = start, linearise(start)
    if first is None:
        return None
    current = first
    growth, trusted_share = 2.0, 1.0
    evaluations, was_rejected, was_short = 1, False, False
    costs: list[float] = []
    while True:
        is_free = ~space.at_bounds(x, current.factor[:, :-1].T @ current.factor[:, -1])
        gain, _ = _step(current.factor, 0.0, is_free)
        costs.append(current.cost)
        gain_tolerance = tolerance + relative * current.cost
        stalled, is_discontinuous = (
            len(costs) > n and costs[-n - 1] - current.cost < _MAX_STALL_DECREASE * gain_tolerance
            for n in (_STALL_EVALUATIONS, _MAX_STALL_EVALUATIONS)
        )
        is_small_gain = gain < max(
            _MIN_PREDICTED_TOLERANCES * tolerance, _MIN_PREDICTED_COST_SHARE * current.cost
        )
        ends = (
            (gain < gain_tolerance, SearchEnd.CONVERGED),
            (is_discontinuous or (stalled and is_small_gain), SearchEnd.STALLED),
            (evaluations >= max_evaluations, SearchEnd.EVALUATION_LIMIT),
        )
        for is_reached, end in ends:
            if is_reached:
                return Minimum(x, current, evaluations, end)
        limit = partial(space.limit_step, x, share=trusted_share)
        damping, predicted, step = _descending_step(current.factor, damping, is_free, limit)
        if stalled and not was_rejected and predicted < gain_tolerance:  # of limited steps
            return Minimum(x, current, evaluations, SearchEnd.STALLED)
        candidate = None
        trial, plain_cost = space.move(x, step), -np.inf
        if cost and (was_rejected or (near and was_short)):
            least_cost = current.cost - _MIN_LONGER_GAIN_RATIO * predicted
            trial, plain_cost = _try_step(cost, partial(space.move, x), step, limit, least_cost)
        if plain_cost < current.cost:
            evaluations, candidate = evaluations + 1, linearise(trial)
            plain_cost = candidate.cost if candidate else np.inf
        decrease = current.cost - plain_cost
        gain_ratio = decrease / max(predicted, 1e-300)
        was_rejected = candidate is None or gain_ratio < _MIN_ACCEPTED_GAIN_RATIO
        if candidate is None or was_rejected:
            damping, growth = max(damping * growth, _MIN_DAMPING_AFTER_REJECTION), growth * 2.0
            trusted_share *= _STEP_REDUCTION
            rise = -decrease / max(abs(predicted), tolerance)
            is_rough = rough and is_small_gain and _MAX_RISE < rise < np.inf
            if is_rough or abs(predicted) < tolerance:  # no step decreases the cost
                end = SearchEnd.STALLED if is_small_gain else SearchEnd.NO_DESCENT
                return Minimum(x, current, evaluations, end)
            continue
        if gain_ratio > _MIN_GOOD_GAIN_RATIO:
            damping = max(damping / 5.0, _MIN_DAMPING)
        elif gain_ratio < _MAX_POOR_GAIN_RATIO:
            damping *= 2.0
        was_short = gain_ratio > _MIN_LONGER_GAIN_RATIO
        growth, trusted_share = 2.0, min(1.0, trusted_share / _STEP_REDUCTION)
        x, current = trial, candidate


def full_step(at: Linearised, x: FloatArray, space: Space) -> FloatArray:
    """Point (n,) after the Gauss-Newton step from x, limited to the range of the space."""
    is_free = ~space.at_bounds(x, at.factor[:, :-1].T @ at.factor[:, -1])
    _, step = _trusted_step(at.factor, 0.0, is_free, partial(space.limit_step, x, share=1.0))
    return space.move(x, step)


def _try_step(
    cost: Callable[[FloatArray], float | None],
    move: Callable[[FloatArray], FloatArray],
    step: FloatArray,
    limit: Callable[[FloatArray], FloatArray],
    least_cost: float,
) -> tuple[FloatArray, float]:
    """Point (n,) after a step, and its cost; infinite where it is not defined.

    A step to less than `least_cost` is doubled as long as the cost decreases: in some curved
    valleys all steps are too short.
    """
    trial = move(step)
    found = cost(trial)
    while found is not None and found < least_cost:
        step = 2.0 * step
        if not np.array_equal(limit(step), step):
            break
        longer = move(step)
        longer_cost = cost(longer)
        if longer_cost is None or longer_cost >= found:
            break
        trial, found = longer, longer_cost
    return trial, np.inf if found is None else found


def _descending_step(
    factor: FloatArray, damping: float, free: BoolArray, limit: Callable[[FloatArray], FloatArray]
) -> tuple[float, float, FloatArray]:
    """Damping, raised until a limited step should decrease the cost, with its gain and the step."""
    while True:
        predicted, step = _trusted_step(factor, damping, free, limit)
        if predicted > 0.0 or damping >= _MAX_DAMPING:
            return damping, predicted, step
        damping *= _DAMPING_GROWTH


def _trusted_step(
    factor: FloatArray, damping: float, free: BoolArray, limit: Callable[[FloatArray], FloatArray]
) -> tuple[float, FloatArray]:
    """Damped step with limited components held at their limits; the others are re-optimised.

    Truncating a step would leave a narrow valley, so the free components minimise the model given
    the held ones. The predicted gain of large steps may be negative.
    """
    fixed_step = np.zeros(len(free))
    while True:
        predicted, step = _step(factor, damping, free, fixed_step)
        limited = limit(step)
        is_limited = free & (limited != step)
        if not np.any(is_limited):
            return predicted, step
        fixed_step[is_limited] = limited[is_limited]
        free = free & ~is_limited


def _step(
    factor: FloatArray, damping: float, free: BoolArray, held: FloatArray | None = None
) -> tuple[float, FloatArray]:
    """Step that minimises |R (step, 1)|^2 + damping |D step|^2, and its predicted decrease.

    Coordinates that are not free move by `held`, or stay constant.
    """
    R, residual = factor[:, :-1], factor[:, -1]
    step = np.zeros(len(free)) if held is None else held.copy()
    if np.any(free):
        scale = np.linalg.norm(R[:, free], axis=0)
        scale[scale == 0.0] = 1.0
        U, s, Vt = singular_values(R[:, free] / scale)
        projection = U.T @ (residual + R @ step)
        is_usable = s > _MIN_SINGULAR_VALUE_RATIO * s[0]
        coefficients = -s[is_usable] * projection[is_usable] / (s[is_usable] ** 2 + damping)
        step[free] = Vt[is_usable].T @ coefficients / scale
    # |residual|^2 - |R step + residual|^2 without cancellation
    change = R @ step
    return float(-np.sum(change * (2.0 * residual + change))), step


_MAX_PASSES = 4  # over the coordinates; choices are stable after two or three

Choice = tuple[int, ...]
"""Number of the candidate, from 0, of each coordinate."""


class CoordinateSearch:
    """Choices of candidates and their costs, each computed once.

    `cost_of` returns the costs of several choices. `costs` has all that were computed.
    """

    def __init__(self, cost_of: Callable[[Sequence[Choice]], Iterable[float]]) -> None:
        self.costs: dict[Choice, float] = {}
        self._cost_of = cost_of

    def evaluate(self, choices: Sequence[Choice]) -> list[float]:
        """Costs of the choices."""
        new = [choice for choice in dict.fromkeys(choices) if choice not in self.costs]
        self.costs.update(zip(new, self._cost_of(new) if new else (), strict=True))
        return [self.costs[choice] for choice in choices]

    def least(self, choices: Sequence[Choice]) -> Choice:
        """The choice of least cost, the first of several."""
        costs = self.evaluate(choices)
        return choices[costs.index(min(costs))]

    def minimise(self, starts: Sequence[Choice], counts: Sequence[int]) -> Choice:
        """Choice that no change of one coordinate improves, from the best of `starts`.

        `counts` is the number of candidates of each coordinate. A pass over the coordinates takes
        at most as many evaluations as there are candidates of all coordinates.
        """
        best = self.least(starts)
        for _ in range(_MAX_PASSES):
            previous = best
            for i, count in enumerate(counts):
                best = self.least([replaced(best, {i: k}) for k in range(count)])
            if best == previous:
                break
        return best

    def pairs(self, best: Choice, candidates: Sequence[Sequence[int]]) -> list[list[Choice]]:
        """All candidates of each pair of neighbouring coordinates, with their costs computed.

        The other coordinates are at their best. A single coordinate gives its candidates.
        """
        n = len(candidates)
        grids = []
        for block in [range(i, min(i + 2, n)) for i in range(max(1, n - 1))]:
            combinations = product(*(candidates[i] for i in block))
            grids.append([replaced(best, dict(zip(block, ks, strict=True))) for ks in combinations])
            self.evaluate(grids[-1])
        return grids


def replaced(choice: Choice, candidates: Mapping[int, int]) -> Choice:
    """A choice with other candidates of some coordinates."""
    return tuple(candidates.get(i, k) for i, k in enumerate(choice))
