"""Records that begin in motion, though their motors seem to stand: found by what it explains.

A motor that turns back has no velocity: its angle begins like one from standstill, while gears are
under torque and the links move. Beside a fit the two are far apart: an arm from standstill never
gets near such a record, one that may begin as it likes does.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import ROUGH_BEGINNING, Objective
from strainwave.identification.whole_arm.selection import Selection
from strainwave.identification.whole_arm.solver import resumed_coarse_search
from strainwave.numerics.parallel import side_by_side

_EVIDENT = 28.0  # chi-square of six initial states that chance exceeds once in ten thousand
_SHARE = 0.5  # of the record's cost that they must take: model errors go on after the beginning


def with_evident_initial_motion(fit: Fit, selection: Selection) -> Fit:
    """A rough fit in which those records begin in motion that speak for it.

    Returns: Its objective's records say which begin in motion.
    """
    if fit.iterations >= selection.most:
        return fit
    objective = in_motion(fit.objective, fit.z)
    if objective is fit.objective:
        return fit
    return resumed_coarse_search(objective, fit.z, fit.iterations, selection.options)


def in_motion(objective: Objective, z: FloatArray) -> Objective:
    """The same with those records in motion at first that an arm from standstill fits far worse.

    `z` (n_unknowns,): Near the minimum.

    Returns: The very same where there is none.
    """
    at_standstill = [k for k, record in enumerate(objective.records) if not record.moving]
    rows = objective.rows(z)
    costs = [rows[k].cost(objective.weights[k]) for k in at_standstill]
    owns = side_by_side(
        [partial(_evident, objective, z, *each) for each in zip(at_standstill, costs, strict=True)]
    )
    for k, own in zip(at_standstill, owns, strict=True):
        objective = objective if own is None else objective.in_motion(k, own)
    return objective


def _evident(objective: Objective, z: FloatArray, k: int, rest: float) -> FloatArray | None:
    """A record's own unknowns where beginning in motion takes most of its cost: (n_own,)."""
    held = objective.space.holding(objective.space.values(z))  # only the beginning is looked for
    one = objective.in_motion(k).only(k).for_unknowns(held)
    rough = replace(one, beginning_tolerance=ROUGH_BEGINNING)
    try:
        (free,) = rough.rows(z[:0])
        if (1.0 - ROUGH_BEGINNING) * free.cost(objective.weights[k]) > _SHARE * rest:
            return None  # a better beginning cannot take so much, either
        (free,) = one.rows(z[:0])
    except (InvalidInput, NumericalFailure):
        return None  # no arm begins like that
    cost = free.cost(objective.weights[k])
    evident = rest - cost > _EVIDENT and cost < _SHARE * rest
    return free.evaluated.own + free.step if evident else None
