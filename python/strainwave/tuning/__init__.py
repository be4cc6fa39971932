"""All records that excite the gears, RigidModel, JointModels -> ArmModel: every parameter at once.

Nonlinear least squares on simulations of the whole arm with exact sensitivities, started from what
the earlier stages found.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from strainwave.closed_loop import predict_closed_loop, velocity_band, with_known_effects
from strainwave.errors import NotIdentifiable
from strainwave.link_sensors import is_sensor_constant, nominal
from strainwave.parallel import one_blas_thread, side_by_side
from strainwave.recorded_input import missing_for_replay
from strainwave.records import (
    ArmModel,
    Criticism,
    Diagnostic,
    FloatArray,
    JointModel,
    Log,
    RigidModel,
    Study,
    TuningOptions,
)
from strainwave.tuning.agreement import agreement_tests, disagreement, stage_differences
from strainwave.tuning.beginnings import with_evident_beginnings
from strainwave.tuning.dataset import Replayed, coarser, replayed, usable
from strainwave.tuning.effects import left_out, records_with, tried
from strainwave.tuning.estimates import Fit, parameters_of, warnings_of
from strainwave.tuning.gear_load import carried_torques, gear_torques, histograms_of, largest_of
from strainwave.tuning.model_selection import (
    bent,
    with_named_effects,
    with_settling_times,
    without_idle_effects,
    without_idle_settling,
)
from strainwave.tuning.objective import Misfit
from strainwave.tuning.parametrisation import (
    CURVE,
    LINEAR,
    SETTLING,
    Key,
    Search,
    link_inertia,
    rigid_inertia,
    search_of,
    with_curves,
)
from strainwave.tuning.residuals import residual_cautions, residual_tests
from strainwave.tuning.restricted import as_published, published_records, restricted
from strainwave.tuning.score_tests import effect_cautions, score_tests_of
from strainwave.tuning.sensors import (
    sensor_cautions,
    with_evident_sensors,
    with_sensors,
    without_idle_sensors,
)
from strainwave.tuning.solver import Progress, finely, reported, roughly
from strainwave.tuning.starts import rejected_starts, starts_of

__all__ = ["Fit", "TuningOptions", "fitted", "tune"]

_BAND = 5.0  # times the highest resonance: beyond, little is left of what the gears do
_LEAST_BAND = 0.1  # of the sampling frequency, to which the low-pass may go up
_STEPS = 8.0  # in a period of the cut-off, of the first search; the fit itself takes more
_LOOKS = 31  # along a stiffness of which nothing is known, over a factor of nine
_EDGE = 0.01  # of half its range, so near to which a parameter counts as at its bound


def tune(
    logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    study: Study,
    options: TuningOptions | None = None,
    *,
    start: Mapping[Key, float] | None = None,
    progress: Progress | None = None,
) -> ArmModel:
    """Every parameter of the arm from all `frequency`, `sweep` and `tuning` records at once.

    The recorded voltages drive the simulated arm. Differences of motor velocities and link
    accelerations, through one low-pass, count in robust deviations that the records show.
    The rigid model joins as rows of its own: motion has most information on friction and gravity.
    Sensors' constants, and how a record began that begins in motion, are unknowns of that record.

    The effects that the study names are left out at first, then fitted with the rest; those stay
    that the records show, and a warning names the others.

    Parameters
    ----------
    logs : sequence of Log
        Those of other uses are left out.
    model : RigidModel or None
        None will do for a single joint without gravity.
    joints : sequence of JointModel
        One per joint, to start from.
    study : Study
    options : TuningOptions, optional
    start : dict, optional
        (name, joint) -> value, in place of those of the stages before; delays and scales of link
        sensors among them are fitted from the beginning.
    progress : callable, optional
        Called with the number of each evaluation, and the most there may be.

    Returns
    -------
    ArmModel
        `values` has every parameter; in `parameters` what the data hardly identify has the value
        None, and a warning says why. A parameter at the end of its range gives status "at-bounds".

    Raises
    ------
    NotIdentifiable
        There is no record to fit, or a start is missing or impossible.
    InvalidInput
        A record lacks something that going through it again needs.
    """
    with one_blas_thread(), reported(progress):  # thousands of small factorisations
        chosen = as_published(options or TuningOptions())
        return _tuned(_begun(logs, model, joints, study, chosen, start), study, chosen)


def fitted(
    logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    study: Study,
    options: TuningOptions | None = None,
    *,
    start: Mapping[Key, float] | None = None,
) -> Fit:
    """The fit behind `tune`, for those who want its rows; arguments and errors are the same.

    Returns
    -------
    Fit
    """
    chosen = as_published(options or TuningOptions())
    with one_blas_thread():
        return _whole_fit(_begun(logs, model, joints, study, chosen, start), study, chosen)


@dataclass(frozen=True, slots=True)
class _Begun:
    """All that a fit starts from."""

    logs: list[Log]
    records: tuple[Replayed, ...]
    coarse: Misfit  # the same records in long steps
    start: FloatArray  # (n_unknowns,)
    rejected: tuple[Diagnostic, ...]  # starts that were impossible


def _begun(
    logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    study: Study,
    chosen: TuningOptions,
    given: Mapping[Key, float] | None,
) -> _Begun:
    used = usable(logs, study)
    if chosen.as_published:
        used = published_records(used, study)
    if not used:
        raise NotIdentifiable(
            'the whole-arm fit needs records with use = "frequency", "sweep" or "tuning", with the'
            " angle and the voltage of every motor"
        )
    cutoff = chosen.cutoff_hz or _cutoff(used, joints, study)
    plain = with_known_effects(study, ())
    records = tuple(replayed(log, plain, cutoff, closed_loop=chosen.closed_loop) for log in used)
    search = _search(records, model, joints, study, chosen)
    given = {} if given is None else dict(given)
    own = {key for record in records for key in record.sensor_constants()}
    search = with_sensors(search, [key for key in given if key in own])
    nothing = {key: nominal(key) for key in search.keys if is_sensor_constant(key)}
    start = search.coordinates(search.values(np.zeros(len(search.unknowns))) | nothing | given)
    keys = search.keys
    search = restricted(search, chosen, start)
    start = start[[key in search.keys for key in keys]]
    coarse = Misfit.of(search, [coarser(r, 1.0 / (_STEPS * cutoff)) for r in records])
    if coarse.linearise(start) is None:
        raise NotIdentifiable(
            "the arm that the steps before found cannot be simulated. Check the signs, units and"
            " assignment of the channels, gear_ratio and torque_per_volt"
        )
    starts = starts_of(model, joints, study)
    for name, joint in starts.rejected:
        if name in LINEAR:
            start = _best_along(coarse, start, joint)
    return _Begun(used, records, coarse, start, tuple(rejected_starts(starts, study)))


def _best_along(coarse: Misfit, start: FloatArray, joint: int | None) -> FloatArray:
    """Where the cost is least along the range of a stiffness of which nothing is known.

    A resonance is a tenth wide, and from further off a search ends beside it.
    """
    names = {(name, joint) for name in (*LINEAR, *CURVE)}
    own = [k for k, key in enumerate(coarse.search.keys) if key in names]
    low, high = coarse.search.lower[own], coarse.search.upper[own]
    best, least = start, np.inf
    for share in np.linspace(0.0, 1.0, _LOOKS):
        z = start.copy()
        z[own] = low + share * (high - low)
        found = coarse.linearise(z)
        if found is not None and found.cost < least:
            best, least = z, found.cost
    return best


def _tuned(begun: _Begun, study: Study, chosen: TuningOptions) -> ArmModel:
    """What `tune` promises, however many threads BLAS may have."""
    before = begun.coarse.fits(begun.start)
    first = begun.coarse.search.values(begun.start)
    fit = _whole_fit(begun, study, chosen)
    at_once = {(SETTLING, number): 0.0 for number in range(1, study.n_joints + 1)}
    values = at_once | fit.misfit.search.values(fit.z)
    carried = carried_torques(fit.misfit.records, values)
    largest = largest_of(carried).tolist()
    parameters, covariance = parameters_of(fit, study, largest)
    status: Literal["converged", "iteration-limit", "at-bounds"] = "converged"
    if np.any(at_bounds(fit)):
        status = "at-bounds"
    if not fit.converged:
        status = "iteration-limit"
    differences, agreement = stage_differences(fit, study), agreement_tests(fit)
    criticism = Criticism(residual_tests(fit.misfit, fit.z), tuple(score_tests_of(fit, study)))
    repeated = [
        log
        for log in begun.logs
        if log.experiment.use == "tuning" and missing_for_replay(study, log) is None
    ]
    arms = (values, first)
    repeats = side_by_side(
        [partial(predict_closed_loop, arm, log, study) for arm in arms for log in repeated]
    )
    return ArmModel(
        parameters=parameters,
        values=values,
        covariance=covariance,
        fit_percent=fit.misfit.fits(fit.z),
        initial_fit_percent=before,
        simulated=tuple(repeats[: len(repeated)]),
        initial=tuple(repeats[len(repeated) :]),
        iterations=fit.iterations,
        status=status,
        warnings=(
            *begun.rejected,
            *warnings_of(fit, at_bounds(fit), parameters),
            *disagreement(differences, agreement),
            *left_out(fit.misfit.search, study),
            *sensor_cautions(parameters),
            *residual_cautions(criticism.residuals),
            *effect_cautions(criticism.score_tests, study),
        ),
        criticism=criticism,
        carried=histograms_of(carried),
        at_bounds=tuple(_bounded(fit, study)),
        differences=differences,
        agreement=agreement,
    )


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


def _whole_fit(begun: _Begun, study: Study, options: TuningOptions) -> Fit:
    """In long steps to near the minimum, and from there in short ones.

    With friction that takes its time, if that is asked for or explains much more, and with those
    effects that the study names and the records show.
    """
    rough = with_evident_beginnings(roughly(begun.coarse, begun.start, options), options)
    rough = bent(rough, options)
    rough = with_evident_sensors(rough, options, rough=True)
    if options.settling is not False and rough.iterations < options.max_iterations:
        rough = with_settling_times(rough, options)
    if tried(study):
        # the effects have evaluations of their own, as many as the fit without them
        options = replace(options, max_iterations=2 * options.max_iterations)
        rough = with_named_effects(rough, study, options)
    pairs = zip(begun.records, rough.misfit.records, strict=True)
    records = [replace(record, moving=coarse.moving) for record, coarse in pairs]
    misfit = rough.misfit.seen_by(records_with(records, study, rough.misfit.search.keys))
    fine = finely(misfit.reweighted(rough.z), rough.z, rough.iterations, options)
    if tried(study):
        fine = without_idle_effects(fine, study, options)
    fine = with_evident_sensors(fine, options, rough=False)
    fine = without_idle_sensors(fine, options)
    return fine if options.settling else without_idle_settling(fine, options)


def _bounded(fit: Fit, study: Study) -> Iterator[Key]:
    """Parameters that ended at the end of their range, and inertias that such ones are part of.

    A joint's total viscous friction is known where its split is not, and is spared.
    """
    keys = fit.misfit.search.keys
    ended = [key for key, at in zip(keys, at_bounds(fit), strict=True) if at and key[0] != SETTLING]
    yield from ended
    derived: dict[Key, Mapping[Key, float]] = {
        (name, 1): parts for name, parts in rigid_inertia(study).items()
    }
    for number in range(1, study.n_joints + 1):
        derived["link_inertia", number] = link_inertia(study, number)
    for key, parts in derived.items():
        if key not in ended and any(part in ended for part in parts):
            yield key


def at_bounds(fit: Fit) -> list[bool]:
    """Which unknowns ended at the end of their range."""
    search = fit.misfit.search
    edge = 0.5 * _EDGE * (search.upper - search.lower)
    near: list[bool] = ((fit.z < search.lower + edge) | (fit.z > search.upper - edge)).tolist()
    return near
