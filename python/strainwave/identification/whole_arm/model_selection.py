"""What a fit may have more or less of, chosen by evidence: bends, settling times, effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, Study, TuningOptions
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.effects import (
    Tried,
    idle,
    records_with,
    with_effects,
    without,
)
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.gear_load import gear_torques
from strainwave.identification.whole_arm.objective import Misfit
from strainwave.identification.whole_arm.parametrisation import (
    CURVE,
    SETTLING,
    SETTLING_START,
    Search,
    with_settling,
)
from strainwave.identification.whole_arm.solver import ROUGHLY, SOON, finely, search_from
from strainwave.identification.whole_arm.stiffness_restarts import other_starts

_EVIDENT = 3.0  # deviations that speak for a settling time, an effect, or another curve
_NOTHING = 0.99  # share of its reach from which a settling time's logarithm counts as endless
_TRIAL = 10  # evaluations in which it must show
_TRIAL_OF_EFFECTS = 30  # and in which the effects must, with several parameters each


def bent(fit: Fit, options: TuningOptions) -> Fit:
    """The best of a fit and those from other curves, for each gear whose curve lost a bend.

    Parameters
    ----------
    fit : Fit
    options : TuningOptions

    Returns
    -------
    Fit
    """
    for unknown in fit.misfit.search.unknowns:
        if unknown.name != CURVE[0] or unknown.joint is None:
            continue
        values = fit.misfit.search.values(fit.z)
        largest = gear_torques(fit.misfit.records, values)[unknown.joint - 1]
        for start in other_starts(values, unknown.joint, largest):
            if fit.iterations >= options.max_iterations:
                return replace(fit, converged=False)
            z = fit.misfit.search.coordinates(start)
            try:
                other = _tried(fit, fit.misfit, z, options, _TRIAL)
            except NotIdentifiable:
                continue  # such a curve cannot be simulated
            fit = _better(fit, other)
            found = fit.misfit.search.values(fit.z)
            if found != values and not any(other_starts(found, unknown.joint, largest)):
                break  # it bends twice again
    return fit


def _tried(
    fit: Fit, misfit: Misfit, z: FloatArray, options: TuningOptions, most: int | None
) -> Fit:
    """A rough search from elsewhere, in a few evaluations."""
    return search_from(
        misfit, z, fit.iterations, options, tolerance=SOON, relative=ROUGHLY, most=most
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
    values = fit.misfit.search.values(fit.z)
    search = with_settling(fit.misfit.search)
    begin = search.coordinates(dict.fromkeys(search.keys, SETTLING_START) | values)
    misfit = fit.misfit.for_unknowns(search)
    most = None if options.settling else _TRIAL
    extended = _tried(fit, misfit, begin, options, most)
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
    if all(name != SETTLING for name, _ in fit.misfit.search.keys):
        return fit
    values = fit.misfit.search.values(fit.z)
    deviation = np.sqrt(np.diag(fit.confidence.cautious))
    lowest = fit.z < _NOTHING * fit.misfit.search.lower
    idle = {
        key: 0.0
        for key, std, least in zip(fit.misfit.search.keys, deviation, lowest, strict=True)
        if key[0] == SETTLING and (least or values[key] < _EVIDENT * std)
    }
    if not idle:
        return fit
    search = fit.misfit.search.holding(idle)
    begin = search.coordinates(values)
    return finely(fit.misfit.for_unknowns(search), begin, fit.iterations, options)


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
    values = fit.misfit.search.values(fit.z)
    largest = gear_torques(fit.misfit.records, values).tolist()
    search, begin = with_effects(fit.misfit.search, study, values, largest)
    extended = search_from(
        _on(fit.misfit, search, study),
        begin,
        fit.iterations,
        options,
        tolerance=SOON,
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
        values = fit.misfit.search.values(fit.z)
        search = without(fit.misfit.search, gone)
        misfit = _on(fit.misfit, search, study)
        fit = finely(misfit, search.coordinates(values), fit.iterations, options)
    return fit


def _idle(fit: Fit) -> set[Tried]:
    """The effects among the unknowns that the records do not show."""
    covariance = fit.confidence.cautious
    return set(idle(fit.misfit.search, fit.z, covariance))


def _on(misfit: Misfit, search: Search, study: Study) -> Misfit:
    """The same records and weights for other unknowns, the effects among them in the arm."""
    records = records_with(misfit.records, study, search.keys)
    return replace(misfit.for_unknowns(search), records=records)
