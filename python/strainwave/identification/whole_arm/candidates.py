"""Choose between several starts of the whole-arm fit by short searches.

Without link sensors the earlier stages may leave several gears possible, or know none. Each set of
joints gets a few evaluations in long integrator steps, at most those sets whose cost is least at
the start. The remaining sets continue until one is far ahead or all have converged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import JointModel, TuningOptions
from strainwave.domain.gear_laws import STIFFNESS, gear_parameters, is_slope
from strainwave.domain.parameters import Values
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import Objective
from strainwave.identification.whole_arm.solver import COARSE_GAIN, search_from

MAX_SEARCHED_SETS = 4
EVALUATIONS_PER_ROUND = 8  # of the search from each set
MAX_ROUNDS = 4  # of these searches
MAX_COST_RATIO = 3.0  # to the least cost; a set of larger cost is dropped
LIMIT_SHARE = 1e-3  # of a range: distance within which a stiffness counts as at the limit


@dataclass(frozen=True, slots=True)
class Chosen:
    """A set of joints and the result of the search from it."""

    joints: Sequence[JointModel]
    reached: Values | None  # (name, joint) -> value; None where there was no other set


def best_candidate(
    candidates: Sequence[Sequence[JointModel]],
    objective_of: Callable[[Sequence[JointModel]], Objective],
    options: TuningOptions,
) -> Chosen:
    """The set of joints from which a short search reaches the lowest cost.

    If a search drives a stiffness to the limit of its range, the range is centred there.
    `objective_of` returns the objective of a set of joints, whose start is at zero coordinates.
    Raises `NotIdentifiable` if no arm near any set can be simulated.
    """
    if len(candidates) == 1:
        return Chosen(candidates[0], None)
    known: list[tuple[float, int, Objective]] = []
    why: NotIdentifiable | None = None
    for k, joints in enumerate(candidates):
        try:
            objective = objective_of(joints)
        except NotIdentifiable as failure:
            why = failure
            continue
        at_start = objective.linearise(np.zeros(len(objective.space.unknowns)))
        if at_start is not None:
            known.append((at_start.cost, k, objective))
    if not known:
        raise why or NotIdentifiable("no arm that the steps before leave can be simulated")
    racing = [
        _SearchState(
            candidates[k], Fit(objective, np.zeros(len(objective.space.unknowns)), cost, 0, False)
        )
        for cost, k, objective in sorted(known, key=lambda each: each[:2])[:MAX_SEARCHED_SETS]
    ]
    for _ in range(MAX_ROUNDS):
        further = [_continue_search(racer, objective_of, options) for racer in racing]
        racing = [racer for racer in further if racer is not None]
        if not racing:
            raise NotIdentifiable("no arm near those that the steps before leave can be simulated")
        least = min(racer.fit.cost for racer in racing)
        racing = [racer for racer in racing if racer.fit.cost <= MAX_COST_RATIO * least]
        if all(racer.done for racer in racing) or (len(racing) == 1 and not racing[0].limited):
            break
    best = min(racing, key=lambda racer: racer.fit.cost)
    return Chosen(best.joints, best.fit.objective.space.values(best.fit.z))


@dataclass(frozen=True, slots=True)
class _SearchState:
    """A set of joints and the state of the search from it."""

    joints: Sequence[JointModel]
    fit: Fit

    @property
    def limited(self) -> bool:
        """Whether a stiffness is at the limit of its range; for a curve, all of its slopes."""
        space, z = self.fit.objective.space, self.fit.z
        near = np.minimum(z - space.lower, space.upper - z) < LIMIT_SHARE * (
            space.upper - space.lower
        )
        ended: dict[int | None, list[bool]] = {}
        for (name, joint), at in zip(space.keys, near, strict=True):
            if is_slope(name):
                ended.setdefault(joint, []).append(bool(at))
        return any(all(slopes) for slopes in ended.values())

    @property
    def done(self) -> bool:
        """Whether the search has converged inside its ranges."""
        return self.fit.converged and not self.limited


def _continue_search(
    racer: _SearchState,
    objective_of: Callable[[Sequence[JointModel]], Objective],
    options: TuningOptions,
) -> _SearchState | None:
    """Continue a search for a few evaluations that do not count for the fit; None if it fails."""
    if racer.done:
        return racer
    try:
        joints, fit = racer.joints, racer.fit
        if racer.limited:
            joints = _recentre(racer)
            objective = objective_of(joints)
            fit = replace(
                fit,
                objective=objective,
                z=objective.space.coordinates(_values_with_start_springs(fit, objective)),
            )
        found = search_from(
            fit.objective, fit.z, 0, options, tolerance=COARSE_GAIN, most=EVALUATIONS_PER_ROUND
        )
    except NotIdentifiable:
        return None
    return _SearchState(joints, replace(found, iterations=0))


def _recentre(racer: _SearchState) -> list[JointModel]:
    """The joints with the stiffnesses of the search, so that the ranges are centred there."""
    found = racer.fit.objective.space.values(racer.fit.z)
    arm, moved = racer.fit.objective.records[0].arm, []
    for joint in racer.joints:
        own = arm.joints[joint.joint - 1].law.linearised_by
        values = {**joint.values, STIFFNESS: found[own, joint.joint]}
        moved.append(replace(joint, values=values))
    return moved


def _values_with_start_springs(fit: Fit, objective: Objective) -> Values:
    """The values of the search, with the springs at their starts."""
    space = objective.space
    anew = space.values(np.zeros(len(space.unknowns)))
    of_gears, found = gear_parameters(), fit.objective.space.values(fit.z)
    return {**anew, **{key: x for key, x in found.items() if key[0] not in of_gears}}
