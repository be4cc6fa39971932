"""Other starts for stiffness curves that ended as fewer slopes than they have.

A knee beyond the largest torque, one near zero, and one between equal slopes bend nothing: no
derivative would ever bring them back. Two knees close together are as good as one: the slope
between them is hardly felt, and a search that came there from far seldom gets them apart again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from strainwave.domain.parameters import Values
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.gear_load import gear_torques
from strainwave.identification.whole_arm.parametrisation import CURVE, KNEES
from strainwave.identification.whole_arm.selection import TRIAL, Selection, better, trial
from strainwave.identification.whole_arm.solver import fine_search

_SAME = 0.01  # relative difference below which two slopes are one
_NOTHING = 0.02  # share of the largest torque below which a knee is at zero
_CLOSE = 0.3  # relative distance below which two knees are one
_FEW = ((0.1, 0.3), (0.3, 0.7))  # of the largest torque: knees where no bend was found
_RISE = 1.05  # of slopes to start from that are one


def with_stiffness_restarts(fit: Fit, selection: Selection) -> Fit:
    """The best of a fit and those from other curves, for each gear whose curve lost a bend.

    Parameters
    ----------
    fit : Fit
    selection : Selection

    Returns
    -------
    Fit
    """
    for unknown in fit.objective.space.unknowns:
        if unknown.name != CURVE[0] or unknown.joint is None:
            continue
        values = fit.objective.space.values(fit.z)
        largest = gear_torques(fit.objective.records, values)[unknown.joint - 1]
        for start in other_starts(values, unknown.joint, largest):
            if fit.iterations >= selection.most:
                return replace(fit, converged=False)
            z = fit.objective.space.coordinates(start)
            try:
                other = trial(fit, fit.objective, z, selection, TRIAL)
            except NotIdentifiable:
                continue  # such a curve cannot be simulated
            fit = better(fit, other)
            found = fit.objective.space.values(fit.z)
            if found != values and not any(other_starts(found, unknown.joint, largest)):
                break  # it bends twice again
    return fit


def with_fine_stiffness_restarts(fit: Fit, selection: Selection) -> Fit:
    """A fit again from other curves, where one lost a bend that does not show in long steps.

    These have evaluations of their own, as many as the fit without them.

    Parameters
    ----------
    fit : Fit
    selection : Selection

    Returns
    -------
    Fit
    """
    before = selection.options
    selection.options = replace(before, max_iterations=fit.iterations + before.max_iterations)
    again = with_stiffness_restarts(fit, selection)
    if again.iterations == fit.iterations:
        selection.options = before
        return fit
    if again.cost < fit.cost:
        objective = again.objective.reweighted(again.z)
        return fine_search(objective, again.z, again.iterations, selection.options)
    return replace(again, converged=fit.converged)


def other_starts(values: Values, joint: int, largest_torque: float) -> Iterator[Values]:
    """Curves of three slopes near one that bends only once, or not at all.

    Parameters
    ----------
    values : dict
        Of the whole arm, where a search ended.
    joint : int
        Of a three-slope gear, from 1.
    largest_torque : float [N m]
        That it carries in the records.

    Yields
    ------
    dict
        The values with another curve; nothing if the curve bends twice.
    """
    slopes, knees = _bends(values, joint, largest_torque)
    if len(knees) == 2:
        return
    found: list[tuple[list[float], list[float]]] = []
    if knees:
        (low, high), (knee,) = slopes, knees
        between, beyond = float(np.sqrt(low * high)), 0.5 * (knee + largest_torque)
        found.append(([low, between, high], [0.75 * knee, min(1.5 * knee, beyond)]))
        found.append(([low, high, _RISE * high], [knee, beyond]))
        found.append(([low / _RISE, low, high], [0.5 * knee, knee]))
    else:
        spread = [slopes[0] / _RISE, slopes[0], slopes[0] * _RISE]
        found += [(spread, [share * largest_torque for share in shares]) for shares in _FEW]
    for curve, bends in found:
        named = dict(zip((*CURVE, *KNEES), (*curve, *bends), strict=True))
        yield {**values, **{(name, joint): value for name, value in named.items()}}


def _bends(values: Values, joint: int, largest: float) -> tuple[list[float], list[float]]:
    """The slopes that differ and lie within reach, and the knees between them."""
    slopes, knees = [values[CURVE[0], joint]], list[float]()
    for name, knee in zip(CURVE[1:], KNEES, strict=True):
        slope, torque = values[name, joint], values[knee, joint]
        if torque < _NOTHING * largest:
            slopes[-1] = slope
        elif torque < largest and abs(slope / slopes[-1] - 1.0) > _SAME:
            slopes.append(slope)
            knees.append(torque)
    if len(knees) == 2 and knees[1] < (1.0 + _CLOSE) * knees[0]:
        return [slopes[0], slopes[2]], [float(np.sqrt(knees[0] * knees[1]))]
    return slopes, knees
