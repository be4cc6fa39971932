"""Unknowns that a fit has if its data support them.

Effects that the study names, settling times of friction, initial states of records that begin in
motion, and wider ranges of friction and damping, whose starting values may be far off.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.arm.parameter_table import SETTLING
from strainwave.domain.results.ranges import physical_range
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    add_effects,
    insignificant_effects,
    named_effects,
    remove_effects,
    with_effects,
)
from strainwave.identification.whole_arm.problem.objective import (
    ROUGH_INITIAL_STATE_TOLERANCE,
    Objective,
)
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace
from strainwave.identification.whole_arm.problem.starting_values import (
    SETTLING_START,
    add_settling_unknowns,
    loads_of,
)
from strainwave.identification.whole_arm.search import (
    Fit,
    fine_search,
    resumed_coarse_search,
    search_minimum,
)
from strainwave.identification.whole_arm.selection.candidate import (
    MAX_CANDIDATE_EVALUATIONS,
    MIN_SIGNIFICANCE_STDS,
    Candidate,
    Selection,
    run_trial,
    select_better,
)
from strainwave.numerics.parallel import run_parallel

MAX_TRIAL_EVALUATIONS = 30  # effects have several parameters each

# share of the lower bound of its logarithm from which a settling time is zero
_ZERO_BOUND_SHARE = 0.99
# minimum cost reduction: chi-square of 6 initial states, probability 1e-4
_MIN_COST_REDUCTION = 28.0
# minimum share of the record's cost that initial states explain; model errors persist
_MIN_EXPLAINED_SHARE = 0.5


def add_named_effects(fit: Fit, selection: Selection) -> Fit:
    """The coarse fit with the effects that the study names, unless they gain too little."""
    arm = selection.arm
    if not named_effects(arm):
        return fit
    # as many as the fit without them
    selection.allow(selection.options.max_iterations + selection.budget)
    values = fit.values
    loads = loads_of(fit.objective.records, values)
    space, start = add_effects(fit.space, named_effects(arm), arm, values, loads, fit.records)
    extended = search_minimum(
        fit.restart(with_effects(fit.objective, space, arm), start),
        selection.options,
        max_evaluations=MAX_TRIAL_EVALUATIONS,
    )
    return select_better(replace(fit, cost=fit.cost - _prior_relief(fit, space)), extended)


def _prior_relief(fit: Fit, space: ParameterSpace) -> float:
    """Cost reduction due to the lower trust in the rigid step that the effects require."""
    parameters = fit.space.parameters(fit.z)

    before, after = (
        float(np.sum((prior.rows[:, : len(parameters)] @ parameters - prior.target) ** 2))
        for prior in (fit.space.prior, space.prior)
    )
    return before - after


def _without_insignificant_effects(fit: Fit, selection: Selection) -> Fit | None:
    arm = selection.arm
    if not named_effects(arm):
        return None
    effects = set(insignificant_effects(fit.space, fit.z, confidence_of(fit).cautious))
    space = remove_effects(fit.space, effects, arm)
    objective = with_effects(fit.objective, space, arm)
    return fit.restart(objective, space.coordinates(fit.values)) if effects else None


remove_insignificant_effects = Candidate(
    _without_insignificant_effects, fine_search, is_addition=False, is_repeated=True
)


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
    """The fit with frictions and dampings at the end of their range centred in a new one."""
    bounded = [
        k
        for k, (unknown, at) in enumerate(zip(fit.space.unknowns, fit.at_bounds, strict=True))
        if at
        and not unknown.signed
        and unknown.limits is None
        and physical_range(unknown.name) == "non-negative"
    ]
    if not bounded or not fit.end.is_minimum:
        return None
    selection.renew(fit)
    return fit.with_unknowns(fit.space.recentre(fit.z, bounded))


extend_ranges = Candidate(_with_extended_ranges, fine_search, is_addition=False)
