"""Gears whose curve is no more than a simpler law's, as far as the records show."""

from __future__ import annotations

import numpy as np

from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.parametrisation import Key
from strainwave.identification.whole_arm.selection import EVIDENT, Selection
from strainwave.identification.whole_arm.solver import fine_search


def without_idle_curves(fit: Fit, selection: Selection) -> Fit:
    """Again without what a law adds to its simpler one, in the gears that do not show it."""
    idle = _idle(fit, selection)
    if not idle:
        return fit
    values = fit.objective.space.values(fit.z)
    space = fit.objective.space.holding(dict.fromkeys(idle, 0.0))
    begin = space.coordinates(values)
    return fine_search(fit.objective.for_unknowns(space), begin, fit.iterations, selection.options)


def _idle(fit: Fit, selection: Selection) -> list[Key]:
    """Parameters that are nothing within their errors, those of each gear together."""
    keys, found = fit.objective.space.keys, list[Key]()
    for number, joint in enumerate(selection.arm.joints, start=1):
        names = joint.law.may_vanish
        own = [k for k, (name, of) in enumerate(keys) if of == number and name in names]
        if own:
            size = fit.objective.space.parameters(fit.z)[own]
            covariance = fit.confidence.cautious[np.ix_(own, own)]
            if size @ np.linalg.solve(covariance, size) < EVIDENT**2:
                found += [keys[k] for k in own]
    return found
