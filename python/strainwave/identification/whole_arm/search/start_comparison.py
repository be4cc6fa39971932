"""Choose between several starts of the whole-arm fit by short searches.

Without link sensors the earlier stages may return several sets of gears, or typical gears. The
sets of lowest initial cost get a few evaluations each, in long integrator steps. Sets of much
larger cost are dropped, and the others continue until all searches have converged or one set
remains.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import JointModel, WholeArmOptions
from strainwave.domain.arm.gear_laws import STIFFNESS, gear_parameters, is_slope
from strainwave.domain.keys import Values
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import search_minimum
from strainwave.numerics.search import Choice, CoordinateSearch

MAX_SEARCHED_SETS = 4
EVALUATIONS_PER_ROUND = 3  # of the search from each set
MAX_ROUNDS = 11  # of these searches
# to the least cost; a set of larger cost is dropped. Standing motors add their noise to all costs
MAX_COST_RATIO = 1.5
# to the least cost if it is that of the first set, the best by the motor responses: other sets of
# larger cost are not searched
MAX_INITIAL_COST_RATIO = 2.0
LIMIT_SHARE = 1e-3  # of a range: distance within which a stiffness counts as at the limit
_NO_START = "the arm cannot be simulated with any start values of the earlier stages"


@dataclass(frozen=True, slots=True)
class SelectedCandidate:
    """A set of joints and the result of the search from it."""

    joints: Sequence[JointModel]
    end_values: Values | None  # (name, joint) -> value; None if there is only one set


def select_candidate(
    candidates: Sequence[Sequence[JointModel]],
    objective_of: Callable[[Sequence[JointModel]], Objective],
    options: WholeArmOptions,
) -> SelectedCandidate:
    """The set of joints from which a short search reaches the lowest cost.

    If a search drives a stiffness to the limit of its range, the range is centred there.
    `objective_of` returns the objective of a set of joints, whose start is at zero coordinates.
    Raises `NotIdentifiable` if no arm near any set can be simulated.
    """
    if len(candidates) == 1:
        return SelectedCandidate(candidates[0], None)
    searches = _best_starts(candidates, objective_of)
    for _ in range(MAX_ROUNDS):
        continued = [_continue_search(search, objective_of, options) for search in searches]
        searches = [search for search in continued if search is not None]
        if not searches:
            raise NotIdentifiable(
                "the arm cannot be simulated near any start values of the earlier stages"
            )
        min_cost = min(search.fit.cost for search in searches)
        searches = [s for s in searches if s.fit.cost <= MAX_COST_RATIO * min_cost]
        if all(search.is_finished for search in searches):
            break
        if len(searches) == 1 and not searches[0].is_limited:
            break
    best = min(searches, key=lambda search: search.fit.cost)
    return SelectedCandidate(best.joints, best.fit.values)


@dataclass(frozen=True, slots=True)
class _SearchState:
    """A set of joints and the state of the search from it."""

    joints: Sequence[JointModel]
    fit: Fit

    @property
    def is_limited(self) -> bool:
        """Whether a stiffness is at the limit of its range; for a curve, all of its slopes."""
        space, z = self.fit.space, self.fit.z
        is_near = np.minimum(z - space.lower, space.upper - z) < LIMIT_SHARE * (
            space.upper - space.lower
        )
        slopes_at_limit: dict[int | None, list[bool]] = {}
        for (name, joint), is_at_limit in zip(space.keys, is_near, strict=True):
            if is_slope(name):
                slopes_at_limit.setdefault(joint, []).append(bool(is_at_limit))
        return any(all(slopes) for slopes in slopes_at_limit.values())

    @property
    def is_finished(self) -> bool:
        """Whether the search has converged inside its ranges."""
        return self.fit.end.is_minimum and not self.is_limited


def _best_starts(
    candidates: Sequence[Sequence[JointModel]],
    objective_of: Callable[[Sequence[JointModel]], Objective],
) -> list[_SearchState]:
    """The sets of lowest initial cost, the best first.

    If the first set, the best by the motor responses, has the lowest cost by far, it is the only
    one.
    Typical gears, which no record supports, are also combined: one joint, then two neighbouring
    joints get the gears of other sets while the other joints keep theirs.
    """
    models = [
        list({id(joint): joint for joint in joints}.values())
        for joints in zip(*candidates, strict=True)
    ]
    searches: dict[Choice, _SearchState] = {}
    failures: list[NotIdentifiable] = []

    def cost_of(choice: Choice) -> float:
        joints = [each[k] for each, k in zip(models, choice, strict=True)]
        try:
            objective = objective_of(joints)
        except NotIdentifiable as failure:
            failures.append(failure)
            return np.inf
        space = objective.space
        plain = objective.replace_unknowns(space.fix_values(space.start_values))
        simulated = plain.linearise(np.zeros(0))
        if simulated is None:
            return np.inf
        start = np.zeros(len(space.unknowns))
        searches[choice] = _SearchState(joints, Fit(objective, start, simulated.cost, 0))
        return simulated.cost

    search = CoordinateSearch(lambda choices: map(cost_of, choices))
    numbers = [{id(joint): k for k, joint in enumerate(each)} for each in models]
    sets = [
        tuple(number[id(joint)] for number, joint in zip(numbers, joints, strict=True))
        for joints in candidates
    ]
    search.evaluate(sets)
    if not any(joint.experiments for each in models for joint in each):
        best = search.minimise(sets, [len(each) for each in models])
        search.pairs(best, [range(len(each)) for each in models])
    if not searches:
        raise (failures or [NotIdentifiable(_NO_START)])[-1]
    chosen = sorted(searches, key=search.costs.__getitem__)[:MAX_SEARCHED_SETS]
    if chosen[0] == sets[0] and any(joint.experiments for joint in candidates[0]):
        limit = MAX_INITIAL_COST_RATIO * search.costs[chosen[0]]
        chosen = [choice for choice in chosen if search.costs[choice] <= limit]
    return [searches[choice] for choice in chosen]


def _continue_search(
    search: _SearchState,
    objective_of: Callable[[Sequence[JointModel]], Objective],
    options: WholeArmOptions,
) -> _SearchState | None:
    """Continue a search for a few evaluations that do not count for the fit; None if it fails."""
    if search.is_finished:
        return search
    try:
        joints, fit = search.joints, search.fit
        if search.is_limited:
            joints = _recentre(search)
            objective = objective_of(joints)
            kept = {key: x for key, x in fit.values.items() if key[0] not in gear_parameters()}
            values = objective.space.start_values | kept  # the springs are at their starts
            fit = Fit.at(objective, objective.space.coordinates(values))
        fit = search_minimum(
            replace(fit, iterations=0), options, max_evaluations=EVALUATIONS_PER_ROUND
        )
    except NotIdentifiable:
        return None
    return _SearchState(joints, fit)


def _recentre(search: _SearchState) -> list[JointModel]:
    """The joints with the stiffnesses of the search, so that the ranges are centred there."""
    estimates = search.fit.values
    arm, recentred = search.fit.objective.records[0].arm, []
    for joint in search.joints:
        stiffness = arm.joints[joint.joint - 1].law.linearised_by
        values = {**joint.values, STIFFNESS: estimates[stiffness, joint.joint]}
        recentred.append(replace(joint, values=values))
    return recentred
