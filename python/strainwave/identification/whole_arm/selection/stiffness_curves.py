"""Stiffness curves: restarts of those that lost a knee, removal of insignificant terms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from strainwave.domain import LawChoice, SearchEnd
from strainwave.domain.gear_laws import AUTO, STIFFNESS, GearLaw, stated_law
from strainwave.domain.keys import Key, Values
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.inference.held_out import simplest_model
from strainwave.identification.whole_arm.inference.parameter_estimates import identified_curves
from strainwave.identification.whole_arm.problem.effect_unknowns import with_effects
from strainwave.identification.whole_arm.records.loads import gear_torques
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import fine_search
from strainwave.identification.whole_arm.selection.candidate import (
    MAX_CANDIDATE_EVALUATIONS,
    MIN_SIGNIFICANCE_STDS,
    Selection,
    refit_without,
    run_trial,
    select_better,
)


def restart_coarse_fit(fit: Fit, selection: Selection) -> Fit:
    """Restart the search from other curves for each gear whose curve lost a knee.

    Returns the fit of least cost.
    """
    for number, joint in enumerate(selection.arm.joints, start=1):
        law = joint.law
        if not law.is_curved or (law.names[0], number) not in fit.space.keys:
            continue
        values = fit.values
        largest = gear_torques(fit.objective.records, values)[number - 1]
        for start in alternative_curves(law, values, number, largest):
            if selection.has_ended(fit):
                return replace(fit, end=SearchEnd.EVALUATION_LIMIT)
            z = fit.space.coordinates(start)
            try:
                restarted = run_trial(replace(fit, z=z), selection, MAX_CANDIDATE_EVALUATIONS)
            except NotIdentifiable:
                continue  # the arm cannot be simulated with this curve
            fit = select_better(fit, restarted)
            new_values = fit.values
            if new_values != values and not any(
                alternative_curves(law, new_values, number, largest)
            ):
                break  # the curve has all its knees
    return fit


def restart_fine_fit(fit: Fit, selection: Selection) -> Fit:
    """Restart a fine fit from other curves if a curve lost a knee.

    Long integrator steps may hide the loss in the coarse fit. The restarts have their own budget of
    evaluations, equal to that of the fit.
    """
    options = selection.options
    selection.renew(fit)
    restarted = restart_coarse_fit(fit, selection)
    if restarted.iterations == fit.iterations:
        selection.options = options
        return fit
    if restarted.cost < fit.cost:
        objective = restarted.objective.update_weights(restarted.z)
        return fine_search(replace(restarted, objective=objective), selection.options)
    return replace(restarted, end=fit.end)


def alternative_curves(
    law: GearLaw, values: Values, joint: int, largest_torque: float
) -> Iterator[Values]:
    """Values of the arm with alternative curves of one gear.

    `values` are those at the end of a search, `joint` counts from 1, and `largest_torque` [N m] is
    that of the gear in the records. Yields nothing if the curve has all its knees.
    """
    for start in law.restarts(law.of_joint(values, joint), largest_torque):
        yield {**values, **{(name, joint): value for name, value in start.items()}}


def remove_insignificant_stiffness_terms(fit: Fit, selection: Selection) -> Fit:
    """Repeat the fit without the optional terms of gear laws that are zero within their errors.

    A chi-square distance tests all optional parameters of a gear together. Returns the fit itself
    if all terms are significant. A gear whose law the fit selects becomes linear.
    """
    keys, insignificant = fit.space.keys, dict[Key, float]()
    for number, joint in enumerate(selection.arm.joints, start=1):
        names = joint.law.may_vanish
        places = [k for k, (name, of) in enumerate(keys) if of == number and name in names]
        if places:
            estimate = fit.space.parameters(fit.z)[places]
            covariance = confidence_of(fit).cautious[np.ix_(places, places)]
            if estimate @ np.linalg.solve(covariance, estimate) < MIN_SIGNIFICANCE_STDS**2:
                insignificant |= {keys[k]: 0.0 for k in places}
    fit = refit_without(insignificant, fit, selection)
    straight = selection.law_choices.keys() & {number for _, number in insignificant}
    if not straight:
        return fit
    for number in straight:
        _select_line(number, selection)
    removed = {key for key in insignificant if key[1] in straight}
    fixed = {key: value for key, value in fit.space.fixed.items() if key not in removed}
    space = replace(fit.space, fixed=fixed)
    return replace(fit, objective=with_effects(fit.objective, space, selection.arm))


def straighten_curves(fit: Fit, selection: Selection) -> Fit:
    """Make gears linear whose curve has one identified slope and does not predict better."""
    largest = gear_torques(fit.objective.records, fit.values).tolist()
    for number in selection.law_choices:
        law, keys = selection.arm.joints[number - 1].law, fit.space.keys
        known = identified_curves(fit, confidence_of(fit).combined, selection.arm, largest)
        slopes = {known.get((name, number), (name, number)) for name in law.names} - {None}
        if not law.is_curved or len(slopes) > 1:
            continue
        kept = [
            k
            for k, key in enumerate(keys)
            if key in slopes or key not in {(name, number) for name in law.names}
        ]
        space = fit.space.select(kept)
        unknowns = (replace(u, name=STIFFNESS) if u.key in slopes else u for u in space.unknowns)
        space, line = replace(space, unknowns=tuple(unknowns)), replace(selection)
        _select_line(number, line)
        start = fit.restart(with_effects(fit.objective, space, line.arm), fit.z[kept])
        straight = fine_search(start, selection.options)
        if simplest_model([straight, fit]) == 0:
            fit = straight
            _select_line(number, selection)
    return fit


def _select_line(number: int, selection: Selection) -> None:
    linear = stated_law(AUTO).name
    selection.arm = selection.arm.with_joint(number, spring=linear)
    selection.law_choices = selection.law_choices | {number: LawChoice(number, linear)}
