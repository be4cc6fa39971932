"""All records that excite the gears, RigidModel, JointModels -> ArmModel: every parameter at once.

Nonlinear least squares on simulations of the whole arm with exact sensitivities, started from what
the earlier stages found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from strainwave.closed_loop import predict_closed_loop, velocity_band
from strainwave.cores import side_by_side
from strainwave.errors import NotIdentifiable
from strainwave.records import ArmModel, FloatArray, JointModel, Log, RigidModel, Study
from strainwave.replay import missing_for_replay
from strainwave.tuning.confidence import confidence_of
from strainwave.tuning.misfit import Misfit
from strainwave.tuning.replayed import Replayed, coarser, replayed, usable
from strainwave.tuning.told import Fit, parameters_of, warnings_of
from strainwave.tuning.trust_region import minimise
from strainwave.tuning.unknowns import (
    SETTLING,
    SETTLING_START,
    Key,
    Search,
    search_of,
    with_curves,
    with_settling,
)

__all__ = ["TuningOptions", "tune"]

_BAND = 5.0  # times the highest resonance: beyond, little is left of what the gears do
_LEAST_BAND = 0.1  # of the sampling frequency, to which the low-pass may go up
_STEPS = 8.0  # in a period of the cut-off, of the first search; the fit itself takes more
_ROUNDS = 4  # of new weights; the third seldom moves anything
_SETTLED = 0.2  # relative change of the weights
_FINE, _SOON = 1e-2, 1.0  # gain still foretold, in units of the cost
_FARTHEST = 1.0  # step of a logarithm
_ROUGH, _ROUGHLY = 2e-2, 2e-3  # the same as a share of it: by guessed weights, in long steps
_NEAR = 1e-8  # damping of a search that is close
_EDGE = 0.01  # of its reach, so near to which a parameter counts as at its bound
_EVIDENT = 3.0  # deviations from zero that a settling time must have
_TRIAL = 10  # evaluations in which it must show


@dataclass(frozen=True, slots=True)
class TuningOptions:
    """What may be set by hand."""

    cutoff_hz: float | None = None  # of what is compared; None: from the resonances
    settling: bool | None = None  # whether friction takes its time; None: if the data say so
    start: Mapping[Key, float] | None = None  # values in place of those of the steps before
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
    if chosen.start is not None:
        start = search.coordinates({**search.values(start), **chosen.start})
    coarse = Misfit.of(search, [coarser(r, 1.0 / (_STEPS * cutoff)) for r in records])
    if coarse.linearise(start) is None:
        raise NotIdentifiable("tuning cannot simulate what the steps before found")
    before = coarse.fits(start)
    fit = _whole_fit(coarse, records, start, chosen)
    at_once = {(SETTLING, number): 0.0 for number in range(1, study.n_joints + 1)}
    values = at_once | fit.misfit.search.values(fit.z)
    confidence = confidence_of(fit.misfit, fit.z)
    largest = gear_torques(records, values).tolist()
    parameters, covariance = parameters_of(fit, confidence, study, largest)
    status: Literal["converged", "iteration-limit", "at-bounds"] = "converged"
    if np.any(at_bounds(fit)):
        status = "at-bounds"
    if not fit.converged:
        status = "iteration-limit"
    repeated = [
        log
        for log in used
        if log.experiment.use == "tuning" and missing_for_replay(study, log) is None
    ]
    return ArmModel(
        parameters=parameters,
        values=values,
        covariance=covariance,
        fit_percent=fit.misfit.fits(fit.z),
        initial_fit_percent=before,
        simulated=tuple(predict_closed_loop(values, log, study) for log in repeated),
        initial=tuple(predict_closed_loop(search.values(start), log, study) for log in repeated),
        iterations=fit.iterations,
        status=status,
        warnings=tuple(warnings_of(fit, confidence, at_bounds(fit), parameters)),
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
        search = with_curves(search, study, gear_torques(records, values).tolist())
    return search


def gear_torques(
    records: Sequence[Replayed], values: dict[tuple[str, int | None], float]
) -> FloatArray:
    """The largest torque that each gear carries, but for one sample in a thousand: (n_joints,)."""

    def largest(record: Replayed) -> FloatArray:
        torque = record.run(values, record.start(), ["gear_torque"])["gear_torque"]
        return np.asarray(np.quantile(np.abs(torque), 0.999, axis=0))

    return np.asarray(np.max(side_by_side([partial(largest, r) for r in records]), axis=0))


def _whole_fit(
    coarse: Misfit, records: Sequence[Replayed], start: FloatArray, options: TuningOptions
) -> Fit:
    """In long steps to near the minimum, and from there in short ones.

    With friction that takes its time, if that is asked for or explains much more.
    """
    rough = _rough(coarse, start, options)
    if options.settling is not False and rough.iterations < options.max_iterations:
        rough = _with_settling(rough, options)
    misfit = rough.misfit.seen_by(records).reweighted(rough.z)
    fine = _fine(misfit, rough.z, rough.iterations, options)
    return fine if options.settling else _without_idle(fine, options)


def _rough(misfit: Misfit, start: FloatArray, options: TuningOptions) -> Fit:
    """By weights that are guessed, and again by those that the first search shows."""
    first = _search_from(misfit, start, 0, options, tolerance=_SOON, relative=_ROUGH)
    if not first.converged or first.iterations >= options.max_iterations:
        return replace(first, converged=False)
    renewed = misfit.reweighted(first.z)
    return _search_from(
        renewed, first.z, first.iterations, options, tolerance=_SOON, relative=_ROUGHLY
    )


def _fine(misfit: Misfit, z: FloatArray, spent: int, options: TuningOptions) -> Fit:
    """Least squares and new weights in turn until the weights stay."""
    search = partial(_search_from, options=options, tolerance=_FINE)
    fit = Fit(misfit, z, spent, False)
    if spent < options.max_iterations:
        fit = search(misfit, z, spent, relative=_ROUGH)
        fit = replace(fit, misfit=fit.misfit.reweighted(fit.z))
    for _ in range(_ROUNDS):
        if fit.iterations >= options.max_iterations:
            return replace(fit, converged=False)
        fit = search(fit.misfit, fit.z, fit.iterations, damping=_NEAR)
        renewed = fit.misfit.reweighted(fit.z)
        if not fit.converged or _settled(fit.misfit, renewed):
            break
        fit = replace(fit, misfit=renewed)
    return fit


def _search_from(
    misfit: Misfit,
    z: FloatArray,
    spent: int,
    options: TuningOptions,
    *,
    tolerance: float,
    relative: float = 0.0,
    damping: float = 1e-3,
    most: int | None = None,
) -> Fit:
    """The minimum by given weights, in as many evaluations as are left, but `most` at most."""
    left = options.max_iterations - spent
    found = minimise(
        misfit.linearise,
        z,
        misfit.search.reach,
        tolerance=tolerance,
        relative=relative,
        farthest=_FARTHEST,
        damping=damping,
        max_evaluations=max(1, left if most is None else min(left, most)),
    )
    if found is None:
        raise NotIdentifiable("tuning cannot simulate what the steps before found")
    return Fit(misfit, found.x, spent + found.evaluations, found.converged)


def _settled(old: Misfit, new: Misfit) -> bool:
    pairs = zip(old.weights, new.weights, strict=True)
    return all(np.max(np.abs(np.log(b.deviation / a.deviation))) < _SETTLED for a, b in pairs)


def _with_settling(fit: Fit, options: TuningOptions) -> Fit:
    """A rough fit with settling times, or the one without where they explain nothing."""
    values = fit.misfit.search.values(fit.z)
    search = with_settling(fit.misfit.search)
    begin = search.coordinates(dict.fromkeys(search.keys, SETTLING_START) | values)
    misfit = fit.misfit.for_unknowns(search)
    most = None if options.settling else _TRIAL
    richer = _search_from(
        misfit,
        begin,
        fit.iterations,
        options,
        tolerance=_SOON,
        relative=_ROUGHLY,
        most=most,
    )
    if options.settling is None and fit.cost() - richer.cost() < _EVIDENT**2:
        return replace(fit, iterations=richer.iterations)
    return richer


def _without_idle(fit: Fit, options: TuningOptions) -> Fit:
    """Again with friction that acts at once in the joints where nothing speaks for a delay."""
    values = fit.misfit.search.values(fit.z)
    deviation = np.sqrt(np.diag(confidence_of(fit.misfit, fit.z).local))
    idle = {
        key: 0.0
        for key, std in zip(fit.misfit.search.keys, deviation, strict=True)
        if key[0] == SETTLING and values[key] < _EVIDENT * std
    }
    if not idle:
        return fit
    search = fit.misfit.search.holding(idle)
    begin = search.coordinates(values)
    return _fine(fit.misfit.for_unknowns(search), begin, fit.iterations, options)
