"""Restarts of stiffness curves that converged with fewer knees than their law has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from strainwave.domain import SearchEnd
from strainwave.domain.gear_laws import GearLaw
from strainwave.domain.keys import Values
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.records.gear_torques import gear_torques
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import fine_search
from strainwave.identification.whole_arm.selection.candidate import (
    MAX_CANDIDATE_EVALUATIONS,
    Selection,
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
            if fit.iterations >= selection.max_evaluations:
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
