"""Effects that the study names: in the model where the records show them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.effects import (
    NamedEffect,
    idle,
    named_effects,
    records_with,
    with_effects,
    without,
)
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.loads import loads_of
from strainwave.identification.whole_arm.objective import Objective
from strainwave.identification.whole_arm.parametrisation import ParameterSpace, Prior
from strainwave.identification.whole_arm.selection import Selection, better
from strainwave.identification.whole_arm.solver import COARSE_GAIN, fine_search, search_from

_TRIAL = 30  # evaluations in which the effects must show, with several parameters each


def with_named_effects(fit: Fit, selection: Selection) -> Fit:
    """A rough fit with the effects that the study names, or the one without if they gain little.

    `selection`: Its study has the effects that the joints may have.
    """
    arm = selection.arm
    if not named_effects(arm):
        return fit
    selection.grant(selection.budget)  # as many as the fit without them
    values = fit.objective.space.values(fit.z)
    loads = loads_of(fit.objective.records, values)
    space, begin = with_effects(
        fit.objective.space, named_effects(arm), arm, values, loads, fit.records
    )
    extended = search_from(
        _on(fit.objective, space, arm),
        begin,
        fit.iterations,
        selection.options,
        tolerance=COARSE_GAIN,
        most=_TRIAL,
    )
    return better(replace(fit, cost=fit.cost - _eased(fit, space)), extended)


def _eased(fit: Fit, space: ParameterSpace) -> float:
    """What the cost of a fit falls by as the rigid step is trusted less for effects' sake."""
    parameters = fit.objective.space.parameters(fit.z)

    def cost(prior: Prior) -> float:
        left = prior.rows[:, : len(parameters)] @ parameters - prior.target
        return float(np.sum(left**2))

    return cost(fit.objective.space.prior) - cost(space.prior)


def without_idle_effects(fit: Fit, selection: Selection) -> Fit:
    """Again without the effects that the records do not show, until all others are identified.

    `selection`: Its study has the effects that the joints may have.
    """
    arm = selection.arm
    if not named_effects(arm):
        return fit
    while gone := _idle(fit):
        values = fit.objective.space.values(fit.z)
        space = without(fit.objective.space, gone, arm)
        objective = _on(fit.objective, space, arm)
        fit = fine_search(objective, space.coordinates(values), fit.iterations, selection.options)
    return fit


def _idle(fit: Fit) -> set[NamedEffect]:
    """The effects among the unknowns that the records do not show."""
    covariance = fit.confidence.cautious
    return set(idle(fit.objective.space, fit.z, covariance))


def _on(objective: Objective, space: ParameterSpace, arm: Arm) -> Objective:
    """The same records and weights for other unknowns, the effects among them in the arm."""
    records = records_with(objective.records, arm, space.keys)
    return replace(objective.for_unknowns(space), records=records)
