"""Effects that the study names, kept in the model if they are significant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    add_effects,
    insignificant_effects,
    named_effects,
    remove_effects,
    with_effects,
)
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace
from strainwave.identification.whole_arm.problem.prior import Prior
from strainwave.identification.whole_arm.records.loads import loads_of
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import fine_search, search_minimum
from strainwave.identification.whole_arm.selection.candidate import Selection, select_better

MAX_TRIAL_EVALUATIONS = 30  # effects have several parameters each


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

    def cost(prior: Prior) -> float:
        residual = prior.rows[:, : len(parameters)] @ parameters - prior.target
        return float(np.sum(residual**2))

    return cost(fit.space.prior) - cost(space.prior)


def remove_insignificant_effects(fit: Fit, selection: Selection) -> Fit:
    """Remove effects that are not significant and refit, until all are significant."""
    arm = selection.arm
    if not named_effects(arm):
        return fit
    while effects := set(insignificant_effects(fit.space, fit.z, confidence_of(fit).cautious)):
        space = remove_effects(fit.space, effects, arm)
        objective = with_effects(fit.objective, space, arm)
        start = fit.restart(objective, space.coordinates(fit.values))
        fit = fine_search(start, selection.options)
    return fit
