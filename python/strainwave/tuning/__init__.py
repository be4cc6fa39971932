"""All records that excite the gears, RigidModel, JointModels -> ArmModel: every parameter at once.

Nonlinear least squares on simulations of the whole arm with exact sensitivities, started from what
the earlier stages found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from strainwave.closed_loop import predict_closed_loop, velocity_band
from strainwave.errors import NotIdentifiable
from strainwave.records import ArmModel, FloatArray, JointModel, Log, RigidModel, Study
from strainwave.simulation import simulate_arms
from strainwave.tuning.confidence import confidence_of
from strainwave.tuning.misfit import Misfit
from strainwave.tuning.replayed import Replayed, replayed, usable
from strainwave.tuning.told import Fit, parameters_of, warnings_of
from strainwave.tuning.trust_region import minimise
from strainwave.tuning.unknowns import (
    SETTLING,
    SETTLING_START,
    Search,
    search_of,
    with_curves,
    with_settling,
)

__all__ = ["TuningOptions", "tune"]

_BAND = 5.0  # times the highest resonance: beyond, little is left of what the gears do
_LEAST_BAND = 0.1  # of the sampling frequency, to which the low-pass may go up
_ROUNDS = 4  # of new weights; the third seldom moves anything
_SETTLED = 0.2  # relative change of the weights
_FINE, _SOON = 1e-2, 1.0  # gain still foretold, in units of the cost
_FARTHEST = 1.0  # step of a logarithm
_ROUGH = 0.02  # the same as a share of it, as long as the weights are guesses
_EDGE = 0.01  # of its reach, so near to which a parameter counts as at its bound
_EVIDENT = 3.0  # deviations from zero that a settling time must have
_TRIAL = 10  # evaluations in which it must show


@dataclass(frozen=True, slots=True)
class TuningOptions:
    """What may be set by hand."""

    cutoff_hz: float | None = None  # of what is compared; None: from the resonances
    settling: bool | None = None  # whether friction takes its time; None: if the data say so
    least_deviation: float = 0.002  # of what the rigid step knows, as a share of each value
    max_iterations: int = 60


def tune(
    logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    study: Study,
    options: TuningOptions | None = None,
) -> ArmModel:
    """Every parameter of the arm from all `frequency`, `sweep` and `tuning` records at once.

    The recorded voltages drive the simulated arm. Differences of motor velocities and link
    accelerations, through one low-pass, count in robust deviations that the records show.
    The rigid model joins as rows of its own: motion tells most of friction and gravity. Sensors'
    constants, and how a record began that begins in motion, are unknowns of that record.

    Parameters
    ----------
    logs : sequence of Log
        Those of other uses are left out.
    model : RigidModel or None
        None will do for a single joint without gravity.
    joints : sequence of JointModel
        One a joint, to start from.
    study : Study
    options : TuningOptions, optional

    Returns
    -------
    ArmModel
        `values` has every parameter; in `parameters` what the data hardly tell has the value None,
        and a warning says why. A parameter at the end of its range gives the status "at-bounds".

    Raises
    ------
    NotIdentifiable
        There is no record to fit, or a start is missing or impossible.
    InvalidInput
        A record lacks something that going through it again needs.
    """
    chosen = options or TuningOptions()
    used = usable(logs, study)
    if not used:
        raise NotIdentifiable(
            'the whole-arm fit needs records with use = "frequency", "sweep" or "tuning", with the'
            " angle and the voltage of every motor"
        )
    cutoff = chosen.cutoff_hz or _cutoff(used, joints, study)
    records = tuple(replayed(log, study, cutoff) for log in used)
    search = _search(records, model, joints, study, chosen)
    start = np.zeros(len(search.unknowns))
    misfit = Misfit.of(search, records)
    if misfit.linearise(start) is None:
        raise NotIdentifiable("tuning cannot simulate what the steps before found")
    before = misfit.fits(start)
    fit = _whole_fit(misfit, start, chosen)
    at_once = {(SETTLING, number): 0.0 for number in range(1, study.n_joints + 1)}
    values = at_once | fit.misfit.search.values(fit.z)
    tuning_logs = [log for log in used if log.experiment.use == "tuning"]
    largest = gear_torques(records, values, study).tolist()
    parameters, covariance = parameters_of(fit, study, largest)
    status: Literal["converged", "iteration-limit", "at-bounds"] = "converged"
    if np.any(at_bounds(fit)):
        status = "at-bounds"
    if not fit.converged:
        status = "iteration-limit"
    return ArmModel(
        parameters=parameters,
        values=values,
        covariance=covariance,
        fit_percent=fit.misfit.fits(fit.z),
        initial_fit_percent=before,
        simulated=tuple(predict_closed_loop(values, log, study) for log in tuning_logs),
        initial=tuple(predict_closed_loop(search.values(start), log, study) for log in tuning_logs),
        iterations=fit.iterations,
        status=status,
        warnings=tuple(warnings_of(fit, at_bounds(fit), parameters, study)),
    )


def at_bounds(fit: Fit) -> list[bool]:
    """Which unknowns ended at the end of their range."""
    near: list[bool] = (np.abs(fit.z) > (1.0 - _EDGE) * fit.misfit.search.reach).tolist()
    return near


def _cutoff(used: Sequence[Log], joints: Sequence[JointModel], study: Study) -> float:
    """Some way above the highest resonance, but no higher than the motors show motion."""
    shown = min(velocity_band(log, study) for log in used)
    resonances = [joint.resonance.frequency_hz for joint in joints if joint.resonance]
    limit = _LEAST_BAND / max(log.sample_time for log in used)
    return min([shown, limit] + ([_BAND * max(resonances)] if resonances else []))


def _search(
    records: Sequence[Replayed],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    study: Study,
    options: TuningOptions,
) -> Search:
    voltage = np.max([np.max(np.abs(r.drive.voltage), axis=0) for r in records], axis=0)
    search = search_of(
        model, joints, study, largest_voltage=voltage.tolist(), floor=options.least_deviation
    )
    if any(joint.spring == "three-slope" for joint in study.joints):
        values = search.values(np.zeros(len(search.unknowns)))
        search = with_curves(search, study, gear_torques(records, values, study).tolist())
    return search


def gear_torques(
    records: Sequence[Replayed], values: dict[tuple[str, int | None], float], study: Study
) -> FloatArray:
    """The largest torque that each gear carries, but for one sample in a thousand: (n_joints,)."""
    largest = []
    for record in records:
        run = simulate_arms(
            study,
            [values],
            record.drive,
            sample_time=record.log.sample_time,
            samples=len(record.log),
            record=["gear_torque"],
        )
        largest.append(np.quantile(np.abs(run["gear_torque"][0]), 0.999, axis=0))
    return np.asarray(np.max(largest, axis=0))


def _whole_fit(misfit: Misfit, start: FloatArray, options: TuningOptions) -> Fit:
    """With friction that takes its time, if that is asked for or explains much more."""
    if options.settling is False:
        return _fit(misfit, start, options.max_iterations, _FINE)
    plain = _fit(misfit, start, options.max_iterations, _SOON)
    if plain.iterations >= options.max_iterations:
        return replace(plain, converged=False)
    return _settling(plain, options)


def _fit(misfit: Misfit, z: FloatArray, allowed: int, tolerance: float) -> Fit:
    """Least squares and new weights in turn until the weights stay."""
    reach = misfit.search.reach
    iterations, converged = 0, False
    for number in range(_ROUNDS + 1):
        found = minimise(
            misfit.linearise,
            z,
            reach,
            tolerance=tolerance,
            relative=_ROUGH if number == 0 else 0.0,
            farthest=_FARTHEST,
            max_evaluations=allowed - iterations,
        )
        if found is None:
            raise NotIdentifiable("tuning cannot simulate what the steps before found")
        z, iterations, converged = found.x, iterations + found.evaluations, found.converged
        if any(record.moving for record in misfit.records):
            misfit.settle_own(z)
        renewed = misfit.reweighted(z)
        if iterations >= allowed or (number > 0 and not converged):
            converged = converged and number > 0
            break
        if number > 0 and _settled(misfit, renewed):
            break
        misfit = renewed
    return Fit(misfit, z, confidence_of(misfit, z), iterations, converged)


def _settled(old: Misfit, new: Misfit) -> bool:
    pairs = zip(old.weights, new.weights, strict=True)
    return all(np.max(np.abs(np.log(b.deviation / a.deviation))) < _SETTLED for a, b in pairs)


def _settling(fit: Fit, options: TuningOptions) -> Fit:
    """From a rough fit without to the final one, with or without a settling time."""
    values = fit.misfit.search.values(fit.z)
    search = with_settling(fit.misfit.search)
    begin = search.coordinates(dict.fromkeys(search.keys, SETTLING_START) | values)
    misfit = fit.misfit.for_unknowns(search)
    left = options.max_iterations - fit.iterations
    found = minimise(
        misfit.linearise,
        begin,
        search.reach,
        tolerance=_SOON,
        farthest=_FARTHEST,
        max_evaluations=max(1, left if options.settling else min(left, _TRIAL)),
    )
    before = fit.misfit.linearise(fit.z)
    if found is None or before is None:
        raise NotIdentifiable("tuning cannot simulate what the steps before found")
    spent = fit.iterations + found.evaluations
    if options.settling is None and before.cost - found.at.cost < _EVIDENT**2:
        return _last(fit.misfit, fit.z, spent, options)
    richer = _last(misfit, found.x, spent, options)
    return richer if options.settling else _without_idle(richer, options)


def _last(misfit: Misfit, z: FloatArray, spent: int, options: TuningOptions) -> Fit:
    """A fine fit after as many evaluations."""
    left = options.max_iterations - spent
    if left < 1:
        return Fit(misfit, z, confidence_of(misfit, z), spent, False)
    fit = _fit(misfit, z, left, _FINE)
    return replace(fit, iterations=spent + fit.iterations)


def _without_idle(fit: Fit, options: TuningOptions) -> Fit:
    """Again with friction that acts at once in the joints where nothing speaks for a delay."""
    values = fit.misfit.search.values(fit.z)
    deviation = np.sqrt(np.diag(fit.confidence.local))
    idle = {
        key: 0.0
        for key, std in zip(fit.misfit.search.keys, deviation, strict=True)
        if key[0] == SETTLING and values[key] < _EVIDENT * std
    }
    if not idle:
        return fit
    search = fit.misfit.search.holding(idle)
    begin = search.coordinates(values)
    return _last(fit.misfit.for_unknowns(search), begin, fit.iterations, options)
