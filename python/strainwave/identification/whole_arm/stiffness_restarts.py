"""Other starts for stiffness curves that ended with fewer bends than their law has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from strainwave.domain.gear_laws import GearLaw
from strainwave.domain.parameters import Values
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.gear_load import gear_torques
from strainwave.identification.whole_arm.selection import TRIAL, Selection, better, trial
from strainwave.identification.whole_arm.solver import fine_search


def with_stiffness_restarts(fit: Fit, selection: Selection) -> Fit:
    """The best of a fit and those from other curves, for each gear whose curve lost a bend."""
    for number, joint in enumerate(selection.arm.joints, start=1):
        law = joint.law
        if not law.is_curved or (law.names[0], number) not in fit.objective.space.keys:
            continue
        values = fit.objective.space.values(fit.z)
        largest = gear_torques(fit.objective.records, values)[number - 1]
        for start in other_starts(law, values, number, largest):
            if fit.iterations >= selection.most:
                return replace(fit, converged=False)
            z = fit.objective.space.coordinates(start)
            try:
                other = trial(fit, fit.objective, z, selection, TRIAL)
            except NotIdentifiable:
                continue  # such a curve cannot be simulated
            fit = better(fit, other)
            found = fit.objective.space.values(fit.z)
            if found != values and not any(other_starts(law, found, number, largest)):
                break  # it has all its bends again
    return fit


def with_fine_stiffness_restarts(fit: Fit, selection: Selection) -> Fit:
    """A fit again from other curves, where one lost a bend that does not show in long steps.

    These have evaluations of their own, as many as the fit without them.
    """
    before = selection.options
    selection.renew(fit)
    again = with_stiffness_restarts(fit, selection)
    if again.iterations == fit.iterations:
        selection.options = before
        return fit
    if again.cost < fit.cost:
        objective = again.objective.reweighted(again.z)
        return fine_search(objective, again.z, again.iterations, selection.options)
    return replace(again, converged=fit.converged)


def other_starts(
    law: GearLaw, values: Values, joint: int, largest_torque: float
) -> Iterator[Values]:
    """The whole arm with other curves of one gear.

    `values`: Of the whole arm, where a search ended.
    `joint`: From 1.
    `largest_torque` [N m]: That its gear carries in the records.

    Yields: Nothing if the curve has all its bends.
    """
    for start in law.restarts(law.of_joint(values, joint), largest_torque):
        yield {**values, **{(name, joint): value for name, value in start.items()}}
