"""Candidate models: test a further unknown, add it, fit, keep or drop it.

Scores of held-out folds compare models of different numbers of unknowns; see `numerics.statistics`.
The simplest candidates are here: settling times of friction, initial states of records that begin
in motion, and wider ranges of friction and damping, whose starting values may be far off.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, IntArray, LawChoice, WholeArmOptions
from strainwave.domain.arm.parameter_table import SETTLING
from strainwave.domain.results.estimates import physical_range
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.problem.objective import (
    BLOCKS_PER_RECORD,
    ROUGH_INITIAL_STATE_TOLERANCE,
    Objective,
)
from strainwave.identification.whole_arm.problem.starting_values import (
    SETTLING_START,
    add_settling_unknowns,
)
from strainwave.identification.whole_arm.problem.weighted_rows import Rows
from strainwave.identification.whole_arm.search import (
    COARSE_RELATIVE_TOLERANCE,
    Fit,
    fine_search,
    resumed_coarse_search,
    search_minimum,
)
from strainwave.numerics.linalg import triangular_factor
from strainwave.numerics.parallel import run_parallel
from strainwave.numerics.spectra import estimate_rows_per_error
from strainwave.numerics.statistics import (
    MIN_CORRELATION_TIMES,
    MIN_WEIGHT,
    log_density,
    weight_over,
)

MIN_SIGNIFICANCE_STDS = 3.0
"""Standard deviations from which a settling time, an effect or another curve is significant.

The minimum cost reduction is its square.
"""
MAX_CANDIDATE_EVALUATIONS = 10
"""Maximum evaluations of the trial fit of a candidate."""

# share of the lower bound of its logarithm from which a settling time is zero
_ZERO_BOUND_SHARE = 0.99
# minimum cost reduction: chi-square of 6 initial states, probability 1e-4
_MIN_COST_REDUCTION = 28.0
# minimum share of the record's cost that initial states explain; model errors persist
_MIN_EXPLAINED_SHARE = 0.5
# maximum share that remains after a linear step to them, which may explain less than a search
_MAX_REMAINING_SHARE = 0.75
_MIN_FOLDS = 2  # of a record; the other folds estimate the variance of a channel


@dataclass
class Selection:
    """Arm, options and evaluation budget of a model selection, and its choices of gear laws."""

    arm: Arm
    options: WholeArmOptions  # `max_iterations` grows when a candidate is granted evaluations
    budget: int = field(init=False)  # evaluations that the user allows for one fit
    # of the joints whose gear law the fit selects; `arm` has the laws
    law_choices: dict[int, LawChoice] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.budget = self.options.max_iterations

    def is_budget_exhausted(self, fit: Fit) -> bool:
        """Whether no evaluations are left after those of `fit`."""
        return fit.iterations >= self.options.max_iterations

    def allow(self, evaluations: int) -> None:
        """Raise the maximum total number of evaluations, if it is lower."""
        max_iterations = max(self.options.max_iterations, evaluations)
        self.options = replace(self.options, max_iterations=max_iterations)

    def renew(self, fit: Fit) -> None:
        """Allow the full budget again, counted from the evaluations of `fit`."""
        self.allow(fit.iterations + self.budget)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A change of the model: further unknowns, fewer ones, or other starting values.

    `change` tests a fit, by statistics or by short searches. It returns the start of a search with
    the changed model, or None if the data do not support a change.
    """

    change: Callable[[Fit, Selection], Fit | None]
    search: Callable[[Fit, WholeArmOptions], Fit]
    is_addition: bool = True  # is tried only while evaluations are left
    is_repeated: bool = False  # until the data support no further change

    def __call__(self, fit: Fit, selection: Selection) -> Fit:
        """The fit of the changed model if the data support it, otherwise the fit itself."""
        while not (self.is_addition and selection.is_budget_exhausted(fit)):
            start = self.change(fit, selection)
            if start is None:
                break
            fit = self.search(start, selection.options)
            if not self.is_repeated:
                break
        return fit


def run_trial(start: Fit, selection: Selection, max_evaluations: int | None) -> Fit:
    """Run a coarse search of another model.

    `max_evaluations` limits the evaluations of the trial; None allows all remaining ones. Raises
    `NotIdentifiable` if the arm cannot be simulated at `start`.
    """
    return search_minimum(
        start,
        selection.options,
        relative=COARSE_RELATIVE_TOLERANCE,
        max_evaluations=max_evaluations,
    )


def best_trial(starts: Iterable[Fit], search: Callable[[Fit], Fit]) -> Fit | None:
    """The search of least cost from several starts; None if the arm can be simulated at none."""
    trials = []
    for start in starts:
        with suppress(NotIdentifiable):
            trials.append(search(start))
    return min(trials, key=lambda trial: trial.cost, default=None)


def select_better(fit: Fit, other: Fit) -> Fit:
    """Return `other` if it reduces the cost significantly, otherwise `fit` with its evaluations."""
    is_significant = fit.cost - other.cost > MIN_SIGNIFICANCE_STDS**2
    return other if is_significant else replace(fit, iterations=other.iterations)


def held_out_scores(fits: Sequence[Fit]) -> FloatArray:
    """Log predictive densities of fits of the same records, (n_fits, n_folds).

    The density of `log_density` is summed over the channels of the fold; the number of independent
    errors is that of the rows over kappa, the rows per independent residual, the largest of the
    fits. The parameters without a fold are one Gauss-Newton step from the fit: the least squares
    solution of the factors of the other folds, stacked. Unknowns at a bound stay there.
    """
    errors = [[rows.errors for rows in fit.objective.rows(fit.z)] for fit in fits]
    # long integrator steps may end a row earlier
    n_rows = [min(map(len, of_record)) for of_record in zip(*errors, strict=True)]
    correlation = [
        np.max([[estimate_rows_per_error(e) for e in one.T] for one in of_record], axis=0)
        for of_record in zip(*errors, strict=True)
    ]
    folds = [_folds(n, float(np.max(kappa))) for n, kappa in zip(n_rows, correlation, strict=True)]
    return np.array([_scores(fit, folds, correlation) for fit in fits])


def simplest_model(fits: Sequence[Fit]) -> int:
    """Place of the fit with the fewest unknowns, unless one with more predicts better."""
    scores = held_out_scores(fits)
    chosen, *others = sorted(
        range(len(fits)), key=lambda k: (len(fits[k].z), -float(np.sum(scores[k])))
    )
    for k in others:
        if weight_over(scores[k], scores[chosen], np.random.default_rng(0)) > MIN_WEIGHT:
            chosen = k
    return chosen


def _folds(n_rows: int, rows_per_error: float) -> IntArray:
    """Number of the fold of each row of a record, (n_rows,)."""
    n_folds = int(n_rows / (MIN_CORRELATION_TIMES * rows_per_error))
    n_folds = min(max(n_folds, _MIN_FOLDS), BLOCKS_PER_RECORD)
    return np.arange(n_rows) * n_folds // n_rows


def _scores(fit: Fit, folds: Sequence[IntArray], correlation: Sequence[FloatArray]) -> FloatArray:
    """Log predictive densities of the folds of all records, (n_folds,)."""

    def fold_factors(k: int, rows: Rows) -> list[FloatArray]:
        table = np.concatenate(
            [rows.shared_columns, (rows.residual * rows.root)[..., None]], axis=2
        )
        # rows of a fold follow one another
        parts = np.split(table[: len(folds[k])], np.flatnonzero(np.diff(folds[k])) + 1)
        return [triangular_factor(part.reshape(-1, part.shape[2])) for part in parts]

    of_records = fit.objective.map_rows(fit.z, fold_factors)
    factors = [factor for own in of_records for factor in own]
    first = np.cumsum([0, *map(len, of_records)])  # number of the first fold of each record
    prior = np.column_stack(fit.space.linearise_prior(fit.z))
    free = np.flatnonzero(~(fit.at_bounds | fit.at_zero))
    steps = []
    for number in range(len(factors)):
        others = np.concatenate([prior, *factors[:number], *factors[number + 1 :]])
        step = np.zeros(others.shape[1] - 1)
        step[free] = np.linalg.lstsq(others[:, free], -others[:, -1])[0]
        steps.append(step)

    def scores(k: int, rows: Rows) -> list[float]:
        fold, own = folds[k], np.array(steps[first[k] : first[k + 1]])
        columns = rows.shared_columns[: len(fold)]
        change = np.stack([columns @ step for step in own], axis=0)[fold, np.arange(len(fold))]
        predicted = rows.residual[: len(fold)] + change / rows.root[: len(fold)]
        squares = (predicted * rows.stds) ** 2
        values = []
        for number in range(len(own)):
            held = fold == number
            held_out, variance = np.mean(squares[held], axis=0), np.mean(squares[~held], axis=0)
            count, others = np.sum(held) / correlation[k], np.sum(~held) / correlation[k]
            values.append(float(np.sum(log_density(held_out, variance, count, others))))
        return values

    return np.concatenate(fit.objective.map_rows(fit.z, scores))


def add_settling_times(fit: Fit, selection: Selection) -> Fit:
    """Add a friction settling time to each joint of a coarse fit.

    Keeps them if the options require them or the cost decreases significantly.
    """
    required = selection.options.settling
    if required is False or selection.is_budget_exhausted(fit):
        return fit
    space = add_settling_unknowns(fit.space)
    starts = {key: SETTLING_START for key in space.keys if key[0] == SETTLING}
    max_evaluations = None if required else MAX_CANDIDATE_EVALUATIONS
    extended = run_trial(fit.with_unknowns(space, starts), selection, max_evaluations)
    return select_better(fit, extended) if required is None else extended


def _without_insignificant_settling_times(fit: Fit, selection: Selection) -> Fit | None:
    """The fit without settling times that are not significant: friction acts instantly."""
    if selection.options.settling or all(name != SETTLING for name, _ in fit.space.keys):
        return None
    values = fit.values
    stds = np.sqrt(np.diag(confidence_of(fit).cautious))
    at_lower_bound = fit.z < _ZERO_BOUND_SHARE * fit.space.lower
    insignificant = {
        key: 0.0
        for key, std, is_at_bound in zip(fit.space.keys, stds, at_lower_bound, strict=True)
        if key[0] == SETTLING and (is_at_bound or values[key] < MIN_SIGNIFICANCE_STDS * std)
    }
    return fit.with_unknowns(fit.space.fix_values(insignificant)) if insignificant else None


remove_insignificant_settling_times = Candidate(
    _without_insignificant_settling_times, fine_search, is_addition=False
)


def _with_initial_motion(fit: Fit, _: Selection) -> Fit | None:
    objective = add_initial_states(fit.objective, fit.z)
    return None if objective is fit.objective else replace(fit, objective=objective)


add_significant_initial_motion = Candidate(_with_initial_motion, resumed_coarse_search)


def add_initial_states(objective: Objective, z: FloatArray) -> Objective:
    """Add initial states to the records that a simulation from standstill fits much worse.

    `z` (n_unknowns,) is near the minimum. Returns the same object if no such record exists.
    """
    at_standstill = [k for k, record in enumerate(objective.records) if not record.begins_in_motion]
    rows = objective.rows(z)
    costs = [rows[k].cost(objective.weights[k]) for k in at_standstill]
    estimates = run_parallel(
        [
            partial(_estimate_initial_motion, objective, z, *each)
            for each in zip(at_standstill, costs, strict=True)
        ]
    )
    for k, estimate in zip(at_standstill, estimates, strict=True):
        objective = objective if estimate is None else objective.add_initial_states(k, estimate)
    return objective


def _estimate_initial_motion(
    objective: Objective, z: FloatArray, k: int, rest: float
) -> FloatArray | None:
    """Initial states and sensor biases (n_own,) of a record that begins in motion.

    `rest` is the cost of the record from standstill. Returns None if initial states do not explain
    enough of it.
    """
    fixed_space = objective.space.fix_values(objective.space.values(z))
    free_start = objective.add_initial_states(k).select_records(k).replace_unknowns(fixed_space)
    rough_start = replace(free_start, initial_state_tolerance=ROUGH_INITIAL_STATE_TOLERANCE)
    weights = objective.weights[k]
    try:
        first = free_start.initial_state_problem(0, z[:0])
        remaining = first.factor[-1, -1] ** 2 / np.sum(first.factor[:, -1] ** 2)
        if remaining * first.cost > _MAX_REMAINING_SHARE * rest:
            return None
        (rows,) = rough_start.rows(z[:0])
        min_cost = (1.0 - ROUGH_INITIAL_STATE_TOLERANCE) * rows.cost(weights)
        if min_cost > _MIN_EXPLAINED_SHARE * rest:
            return None  # a more precise search cannot reach the required share
        (rows,) = free_start.rows(z[:0])
    except (InvalidInput, NumericalFailure):
        return None  # the arm cannot be simulated from such initial states
    cost = rows.cost(weights)
    is_evident = rest - cost > _MIN_COST_REDUCTION and cost < _MIN_EXPLAINED_SHARE * rest
    return rows.record_parameters if is_evident else None


def _with_extended_ranges(fit: Fit, selection: Selection) -> Fit | None:
    """The fit with parameters of one sign at the end of their range centred in a new one.

    The first range is around a typical value, if the joint's records did not determine one.
    """
    bounded = [
        k
        for k, (unknown, at) in enumerate(zip(fit.space.unknowns, fit.at_bounds, strict=True))
        if at
        and not unknown.signed
        and unknown.limits is None
        and physical_range(unknown.name) != "any"
    ]
    if not bounded or not fit.end.is_minimum:
        return None
    selection.renew(fit)
    return fit.with_unknowns(fit.space.recentre(fit.z, bounded))


extend_coarse_ranges = Candidate(_with_extended_ranges, resumed_coarse_search, is_addition=False)
extend_ranges = Candidate(_with_extended_ranges, fine_search, is_addition=False)
