"""Which of several starts the whole-arm fit goes on from: the records decide.

Without link sensors the steps before may leave several gears in question, or know none at all. Each
set of joints gets a few steps of the search in long integrator steps; of many, those first whose
cost is least where they start. Those that are still in question go on until one is far ahead or
all have converged: what has only come closer may yet be overtaken.
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

_FEW = 4  # sets that are searched from
_STEPS, _ROUNDS = 8, 4  # evaluations of each such search at a time, and how often it goes on
_BEHIND = 3.0  # times the least cost, with which a set is out of question
_EDGE = 1e-3  # of a range, so near to whose end a stiffness is at its limit


@dataclass(frozen=True, slots=True)
class Chosen:
    """A set of joints, and where a search from it has come to."""

    joints: Sequence[JointModel]
    reached: Values | None  # (name, joint) -> value; None where there was no other set


def best_candidate(
    candidates: Sequence[Sequence[JointModel]],
    objective_of: Callable[[Sequence[JointModel]], Objective],
    options: TuningOptions,
) -> Chosen:
    """The set of joints from which a short search ends lowest.

    Where a search drives a stiffness to the limit of its range, the range is laid about that.

    `candidates`: Each with one model per joint.
    `objective_of`: What the records say against arms near such a set, whose start is at zero
        coordinates.

    Raises `NotIdentifiable`: there is no arm that can be simulated near any of them.
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
        _Racer(
            candidates[k], Fit(objective, np.zeros(len(objective.space.unknowns)), cost, 0, False)
        )
        for cost, k, objective in sorted(known, key=lambda each: each[:2])[:_FEW]
    ]
    for _ in range(_ROUNDS):
        further = [_further(racer, objective_of, options) for racer in racing]
        racing = [racer for racer in further if racer is not None]
        if not racing:
            raise NotIdentifiable("no arm near those that the steps before leave can be simulated")
        least = min(racer.fit.cost for racer in racing)
        racing = [racer for racer in racing if racer.fit.cost <= _BEHIND * least]
        if all(racer.done for racer in racing) or (len(racing) == 1 and not racing[0].limited):
            break
    best = min(racing, key=lambda racer: racer.fit.cost)
    return Chosen(best.joints, best.fit.objective.space.values(best.fit.z))


@dataclass(frozen=True, slots=True)
class _Racer:
    """A set of joints, and how far a search from it is."""

    joints: Sequence[JointModel]
    fit: Fit

    @property
    def limited(self) -> bool:
        """Whether a stiffness is at the end of its range, of a curve all its slopes."""
        space, z = self.fit.objective.space, self.fit.z
        near = np.minimum(z - space.lower, space.upper - z) < _EDGE * (space.upper - space.lower)
        ended: dict[int | None, list[bool]] = {}
        for (name, joint), at in zip(space.keys, near, strict=True):
            if is_slope(name):
                ended.setdefault(joint, []).append(bool(at))
        return any(all(slopes) for slopes in ended.values())

    @property
    def done(self) -> bool:
        """Whether a search has ended inside its ranges."""
        return self.fit.converged and not self.limited


def _further(
    racer: _Racer, objective_of: Callable[[Sequence[JointModel]], Objective], options: TuningOptions
) -> _Racer | None:
    """A few evaluations on, which do not count among the fit's own; None where that fails."""
    if racer.done:
        return racer
    try:
        joints, fit = racer.joints, racer.fit
        if racer.limited:
            joints = _moved(racer)
            objective = objective_of(joints)
            fit = replace(
                fit,
                objective=objective,
                z=objective.space.coordinates(_but_springs(fit, objective)),
            )
        found = search_from(fit.objective, fit.z, 0, options, tolerance=COARSE_GAIN, most=_STEPS)
    except NotIdentifiable:
        return None
    return _Racer(joints, replace(found, iterations=0))


def _moved(racer: _Racer) -> list[JointModel]:
    """Joints whose stiffness lies where the search has come to, so that ranges lie about that."""
    found = racer.fit.objective.space.values(racer.fit.z)
    arm, moved = racer.fit.objective.records[0].arm, []
    for joint in racer.joints:
        own = arm.joints[joint.joint - 1].law.linearised_by
        values = {**joint.values, STIFFNESS: found[own, joint.joint]}
        moved.append(replace(joint, values=values))
    return moved


def _but_springs(fit: Fit, objective: Objective) -> Values:
    """Where a search has come to, but for springs, which start anew."""
    space = objective.space
    anew = space.values(np.zeros(len(space.unknowns)))
    of_gears, found = gear_parameters(), fit.objective.space.values(fit.z)
    return {**anew, **{key: x for key, x in found.items() if key[0] not in of_gears}}
