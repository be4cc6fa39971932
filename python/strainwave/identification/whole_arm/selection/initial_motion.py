"""Detection of records that begin in motion although the motor velocities are zero.

A motor at a reversal has zero velocity, so its angle does not show that the gears are loaded and
the links move. The fit distinguishes the two cases: a simulation from standstill fits such a record
much worse than one with estimated initial states.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.problem.objective import (
    ROUGH_INITIAL_STATE_TOLERANCE,
    Objective,
)
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import resumed_coarse_search
from strainwave.identification.whole_arm.selection.candidate import Selection
from strainwave.numerics.parallel import run_parallel

# minimum cost reduction: chi-square of 6 initial states, probability 1e-4
_MIN_COST_REDUCTION = 28.0
# minimum share of the record's cost that initial states explain; model errors persist
_MIN_EXPLAINED_SHARE = 0.5


def add_significant_initial_motion(fit: Fit, selection: Selection) -> Fit:
    """Continue a coarse fit with initial states for the records that begin in motion.

    Returns the fit itself if no such record exists or no evaluations are left.
    """
    if selection.has_ended(fit):
        return fit
    objective = add_initial_states(fit.objective, fit.z)
    if objective is fit.objective:
        return fit
    return resumed_coarse_search(replace(fit, objective=objective), selection.options)


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
