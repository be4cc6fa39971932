"""What a fit may have more or less of, chosen by evidence: bends, settling times, effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, Study, TuningOptions
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.effects import (
    NamedEffect,
    idle,
    records_with,
    with_effects,
    without,
)
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.gear_load import gear_torques
from strainwave.identification.whole_arm.objective import Objective
from strainwave.identification.whole_arm.parametrisation import (
    CURVE,
    SETTLING,
    SETTLING_START,
    ParameterSpace,
    with_settling,
)
from strainwave.identification.whole_arm.solver import (
    COARSE_GAIN,
    COARSE_SHARE,
    fine_search,
    search_from,
)
from strainwave.identification.whole_arm.stiffness_restarts import other_starts

_EVIDENT = 3.0  # deviations that speak for a settling time, an effect, or another curve
_NOTHING = 0.99  # share of its reach from which a settling time's logarithm counts as endless
_TRIAL = 10  # evaluations in which it must show
_TRIAL_OF_EFFECTS = 30  # and in which the effects must, with several parameters each


def with_stiffness_restarts(fit: Fit, options: TuningOptions) -> Fit:
    """The best of a fit and those from other curves, for each gear whose curve lost a bend.

    Parameters
    ----------
    fit : Fit
    options : TuningOptions

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
            if fit.iterations >= options.max_iterations:
                return replace(fit, converged=False)
            z = fit.objective.space.coordinates(start)
            try:
                other = _tried(fit, fit.objective, z, options, _TRIAL)
            except NotIdentifiable:
                continue  # such a curve cannot be simulated
            fit = _better(fit, other)
            found = fit.objective.space.values(fit.z)
            if found != values and not any(other_starts(found, unknown.joint, largest)):
                break  # it bends twice again
    return fit


def _tried(
    fit: Fit, objective: Objective, z: FloatArray, options: TuningOptions, most: int | None
) -> Fit:
    """A rough search from elsewhere, in a few evaluations."""
    return search_from(
        objective,
        z,
        fit.iterations,
        options,
        tolerance=COARSE_GAIN,
        relative=COARSE_SHARE,
        most=most,
    )


def _better(fit: Fit, other: Fit) -> Fit:
    """The other one where its gain is evident; its evaluations count in any case."""
    evident = fit.cost - other.cost > _EVIDENT**2
    return other if evident else replace(fit, iterations=other.iterations)


def with_settling_times(fit: Fit, options: TuningOptions) -> Fit:
    """A rough fit with settling times, or the one without where they explain nothing.

    Parameters
    ----------
    fit : Fit
    options : TuningOptions

    Returns
    -------
    Fit
    """
    values = fit.objective.space.values(fit.z)
    space = with_settling(fit.objective.space)
    begin = space.coordinates(dict.fromkeys(space.keys, SETTLING_START) | values)
    objective = fit.objective.for_unknowns(space)
    most = None if options.settling else _TRIAL
    extended = _tried(fit, objective, begin, options, most)
    return _better(fit, extended) if options.settling is None else extended


def without_idle_settling(fit: Fit, options: TuningOptions) -> Fit:
    """Again with friction that acts at once in the joints where nothing speaks for a delay.

    Parameters
    ----------
    fit : Fit
    options : TuningOptions

    Returns
    -------
    Fit
    """
    if all(name != SETTLING for name, _ in fit.objective.space.keys):
        return fit
    values = fit.objective.space.values(fit.z)
    deviation = np.sqrt(np.diag(fit.confidence.cautious))
    lowest = fit.z < _NOTHING * fit.objective.space.lower
    idle = {
        key: 0.0
        for key, std, least in zip(fit.objective.space.keys, deviation, lowest, strict=True)
        if key[0] == SETTLING and (least or values[key] < _EVIDENT * std)
    }
    if not idle:
        return fit
    space = fit.objective.space.holding(idle)
    begin = space.coordinates(values)
    return fine_search(fit.objective.for_unknowns(space), begin, fit.iterations, options)


def with_named_effects(fit: Fit, study: Study, options: TuningOptions) -> Fit:
    """A rough fit with the effects that the study names, or the one without if they gain little.

    Parameters
    ----------
    fit : Fit
    study : Study
        With the effects that its joints may have.
    options : TuningOptions

    Returns
    -------
    Fit
    """
    values = fit.objective.space.values(fit.z)
    largest = gear_torques(fit.objective.records, values).tolist()
    space, begin = with_effects(fit.objective.space, study, values, largest)
    extended = search_from(
        _on(fit.objective, space, study),
        begin,
        fit.iterations,
        options,
        tolerance=COARSE_GAIN,
        most=_TRIAL_OF_EFFECTS,
    )
    return _better(fit, extended)


def without_idle_effects(fit: Fit, study: Study, options: TuningOptions) -> Fit:
    """Again without the effects that the records do not show, until all others are identified.

    Parameters
    ----------
    fit : Fit
    study : Study
    options : TuningOptions

    Returns
    -------
    Fit
    """
    while gone := _idle(fit):
        values = fit.objective.space.values(fit.z)
        space = without(fit.objective.space, gone)
        objective = _on(fit.objective, space, study)
        fit = fine_search(objective, space.coordinates(values), fit.iterations, options)
    return fit


def _idle(fit: Fit) -> set[NamedEffect]:
    """The effects among the unknowns that the records do not show."""
    covariance = fit.confidence.cautious
    return set(idle(fit.objective.space, fit.z, covariance))


def _on(objective: Objective, space: ParameterSpace, study: Study) -> Objective:
    """The same records and weights for other unknowns, the effects among them in the arm."""
    records = records_with(objective.records, study, space.keys)
    return replace(objective.for_unknowns(space), records=records)
