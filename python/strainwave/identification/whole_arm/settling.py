"""Friction that takes its time to act: settling times in the model, where the records show them."""

from __future__ import annotations

import numpy as np

from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.parametrisation import (
    SETTLING,
    SETTLING_START,
    with_settling,
)
from strainwave.identification.whole_arm.selection import EVIDENT, TRIAL, Selection, better, trial
from strainwave.identification.whole_arm.solver import fine_search

_NOTHING = 0.99  # share of its reach from which a settling time's logarithm counts as endless


def with_settling_times(fit: Fit, selection: Selection) -> Fit:
    """A rough fit with settling times, or the one without where they explain nothing."""
    asked = selection.options.settling
    if asked is False or fit.iterations >= selection.most:
        return fit
    values = fit.objective.space.values(fit.z)
    space = with_settling(fit.objective.space)
    begin = space.coordinates(dict.fromkeys(space.keys, SETTLING_START) | values)
    objective = fit.objective.for_unknowns(space)
    most = None if asked else TRIAL
    extended = trial(fit, objective, begin, selection, most)
    return better(fit, extended) if asked is None else extended


def without_idle_settling(fit: Fit, selection: Selection) -> Fit:
    """Again with friction that acts at once in the joints where nothing speaks for a delay."""
    if selection.options.settling or all(name != SETTLING for name, _ in fit.objective.space.keys):
        return fit
    values = fit.objective.space.values(fit.z)
    deviation = np.sqrt(np.diag(fit.confidence.cautious))
    lowest = fit.z < _NOTHING * fit.objective.space.lower
    idle = {
        key: 0.0
        for key, std, least in zip(fit.objective.space.keys, deviation, lowest, strict=True)
        if key[0] == SETTLING and (least or values[key] < EVIDENT * std)
    }
    if not idle:
        return fit
    space = fit.objective.space.holding(idle)
    begin = space.coordinates(values)
    return fine_search(fit.objective.for_unknowns(space), begin, fit.iterations, selection.options)
