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

from strainwave.domain import (
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
from strainwave.dynamics.link_sensors import is_optional, nominal
from strainwave.dynamics.mounting import START, is_hidden
from strainwave.errors import NotIdentifiable, NumericalFailure
from strainwave.identification.closed_loop import (
    predict_closed_loop,
    velocity_band,
    with_known_effects,
)
from strainwave.identification.whole_arm.agreement import (
    agreement_tests,
    disagreement,
    stage_differences,
)
from strainwave.identification.whole_arm.candidates import best_candidate
from strainwave.identification.whole_arm.dataset import Dataset, coarsened, dataset_of, usable
from strainwave.identification.whole_arm.effects import left_out, records_with, tried
from strainwave.identification.whole_arm.estimates import Fit, parameters_of, warnings_of
from strainwave.identification.whole_arm.gear_load import (
    gear_torque_samples,
    gear_torques,
    histograms_of,
    largest_of,
)
from strainwave.identification.whole_arm.initial_motion import with_evident_initial_motion
from strainwave.identification.whole_arm.model_selection import (
    with_named_effects,
    with_settling_times,
    with_stiffness_restarts,
    without_idle_effects,
    without_idle_settling,
)
from strainwave.identification.whole_arm.motor_side_limits import motor_side_limits
from strainwave.identification.whole_arm.mountings import (
    best_placed,
    placed_again,
    with_evident_tilts,
)
from strainwave.identification.whole_arm.objective import Objective
from strainwave.identification.whole_arm.parametrisation import (
    CURVE,
    LINEAR,
    SETTLING,
    Key,
    ParameterSpace,
    link_inertia,
    rigid_inertia,
    space_of,
    with_curves,
)
from strainwave.identification.whole_arm.predicted import BAND, LEAST_BAND, predicted_parameters
from strainwave.identification.whole_arm.residual_analysis import residual_tests, residual_warnings
from strainwave.identification.whole_arm.restricted import (
    as_published,
    published_records,
    restricted,
)
from strainwave.identification.whole_arm.score_tests import effect_warnings, score_tests_of
from strainwave.identification.whole_arm.sensor_gains import sensor_gains
from strainwave.identification.whole_arm.sensors import (
    sensor_warnings,
    with_bandwidths_apart,
    with_evident_sensors,
    with_sensors,
    without_idle_sensors,
)
from strainwave.identification.whole_arm.solver import (
    Progress,
    coarse_search,
    fine_search,
    reported,
)
from strainwave.identification.whole_arm.starts import rejected_starts, starts_of
from strainwave.numerics.parallel import one_blas_thread, side_by_side
from strainwave.signals.mounting_start import mounting_starts
from strainwave.signals.recorded_input import missing_for_replay

__all__ = ["Fit", "TuningOptions", "fitted", "predicted_parameters", "tune"]


_STEPS = 8.0  # in a period of the cut-off, of the first search; the fit itself takes more
_LOOKS = 31  # along a stiffness of which nothing is known, over a factor of nine
_UNLIKELY = (
    "the arm that the steps before found cannot be simulated. Check the signs, units and assignment"
    " of the channels, gear_ratio and torque_per_volt"
)
_EDGE = 0.01  # of half its range, so near to which a parameter counts as at its bound


def tune(
    logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    study: Study,
    options: TuningOptions | None = None,
    *,
    start: Mapping[Key, float] | None = None,
    others: Sequence[Sequence[JointModel]] = (),
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
    others : sequence of sequence of JointModel
        More sets of joints to start from: the records decide.
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
        return _tuned(_begun(logs, model, (joints, *others), study, chosen, start), study, chosen)


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
        return _whole_fit(_begun(logs, model, (joints,), study, chosen, start), study, chosen)


@dataclass(frozen=True, slots=True)
class _Begun:
    """All that a fit starts from."""

    logs: list[Log]
    records: tuple[Dataset, ...]
    coarse: Objective  # the same records in long steps
    initial: FloatArray  # (n_unknowns,) by the steps before
    start: FloatArray  # (n_unknowns,) the same, or where it led to while starts were compared
    rejected: tuple[Diagnostic, ...]  # starts that were impossible


def _begun(
    logs: Sequence[Log],
    model: RigidModel | None,
    candidates: Sequence[Sequence[JointModel]],
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
    every = [joint for joints in candidates for joint in joints]
    records, long_steps = _records(used, every, study, chosen)

    placed = mounting_starts(logs, study, used)
    given = placed | ({} if given is None else dict(given))

    def search_by(joints: Sequence[JointModel]) -> ParameterSpace:
        found = _search(records, model, joints, study, chosen)
        return with_sensors(found, [key for key in placed if key[0] not in START], given)

    def objective_of(joints: Sequence[JointModel]) -> Objective:
        return Objective.of(search_by(joints), long_steps)

    best = best_candidate(candidates, objective_of, chosen)
    joints = best.joints
    if len(candidates) > 1:  # the band is now known better
        records, long_steps = _records(used, joints, study, chosen)
    space = search_by(joints)
    own = {key for record in records for key in record.sensor_constants()}
    space = with_sensors(space, [key for key in given if key in own])
    nothing = {key: nominal(key) for key in space.keys if is_optional(key)}
    start = space.coordinates(space.values(np.zeros(len(space.unknowns))) | nothing | given)
    initial = start
    if best.reached is not None:
        start = space.coordinates(space.values(start) | best.reached | given)
    keys = space.keys
    space = restricted(space, chosen, start)
    kept = [key in space.keys for key in keys]
    start, initial = start[kept], initial[kept]
    coarse = Objective.of(space, long_steps)
    if coarse.linearise(start) is None:
        raise NotIdentifiable(_UNLIKELY)
    if placed:
        coarse, start = best_placed(coarse, start, study, chosen)
    starts = starts_of(model, joints, study)
    for name, joint in starts.rejected:
        if name in LINEAR:
            start = _best_along(coarse, start, joint)
    if best.reached is None or placed:
        initial = start
    return _Begun(used, records, coarse, initial, start, tuple(rejected_starts(starts, study)))


def _records(
    used: Sequence[Log], joints: Sequence[JointModel], study: Study, chosen: TuningOptions
) -> tuple[tuple[Dataset, ...], list[Dataset]]:
    """Records in a band that such joints need, and the same in long steps."""
    cutoff = chosen.cutoff_hz or _cutoff(used, joints, study)
    plain = with_known_effects(study, ())
    records = tuple(dataset_of(log, plain, cutoff, closed_loop=chosen.closed_loop) for log in used)
    return records, [coarsened(r, 1.0 / (_STEPS * cutoff)) for r in records]


def _best_along(coarse: Objective, start: FloatArray, joint: int | None) -> FloatArray:
    """Where the cost is least along the range of a stiffness of which nothing is known.

    A resonance is a tenth wide, and from further off a search ends beside it.
    """
    names = {(name, joint) for name in (*LINEAR, *CURVE)}
    own = [k for k, key in enumerate(coarse.space.keys) if key in names]
    low, high = coarse.space.lower[own], coarse.space.upper[own]
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
    before = begun.coarse.fits(begun.initial)
    first = begun.coarse.space.values(begun.initial)
    fit = _whole_fit(begun, study, chosen)
    at_once = {(SETTLING, number): 0.0 for number in range(1, study.arm.n_joints + 1)}
    values = at_once | fit.objective.space.values(fit.z)
    carried = gear_torque_samples(fit.objective.records, values)
    largest = largest_of(carried).tolist()
    parameters, covariance = parameters_of(fit, study, largest)
    status: Literal["converged", "iteration-limit", "at-bounds"] = "converged"
    if np.any(at_bounds(fit)):
        status = "at-bounds"
    if not fit.converged:
        status = "iteration-limit"
    ended = tuple(_bounded(fit, study))
    differences, agreement = stage_differences(fit, study), agreement_tests(fit)
    criticism = Criticism(residual_tests(fit.objective, fit.z), tuple(score_tests_of(fit, study)))
    repeated = [
        log
        for log in begun.logs
        if log.experiment.use == "tuning" and missing_for_replay(study, log) is None
    ]
    arms = (values, first)
    repeats = side_by_side(
        [partial(predict_closed_loop, arm, log, study) for arm in arms for log in repeated]
    )
    public = [k for k, p in enumerate(parameters) if not is_hidden((p.name, p.joint))]
    return ArmModel(
        parameters=tuple(parameters[k] for k in public),
        values=values,
        covariance=covariance[np.ix_(public, public)],
        fit_percent=fit.objective.fits(fit.z),
        initial_fit_percent=before,
        simulated=tuple(repeats[: len(repeated)]),
        initial=tuple(repeats[len(repeated) :]),
        iterations=fit.iterations,
        status=status,
        warnings=(
            *begun.rejected,
            *warnings_of(fit, at_bounds(fit), parameters),
            *motor_side_limits(fit, study, parameters, ended),
            *disagreement(differences, agreement),
            *left_out(fit.objective.space, study),
            *sensor_warnings(parameters),
            *residual_warnings(criticism.residuals),
            *effect_warnings(criticism.score_tests, study),
        ),
        criticism=criticism,
        carried=histograms_of(carried),
        at_bounds=ended,
        differences=differences,
        agreement=agreement,
        sensor_gains=tuple(sensor_gains(fit, study, parameters)) if fit.converged else (),
    )


def _cutoff(used: Sequence[Log], joints: Sequence[JointModel], study: Study) -> float:
    """Some way above the highest resonance, but no higher than the motors show motion."""
    shown = min(velocity_band(log, study) for log in used)
    resonances = [joint.resonance.frequency_hz for joint in joints if joint.resonance]
    limit = LEAST_BAND / max(log.sample_time for log in used)
    return min([shown, limit] + ([BAND * max(resonances)] if resonances else []))


def _search(
    records: Sequence[Dataset],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    study: Study,
    options: TuningOptions,
) -> ParameterSpace:
    voltage = np.max([np.max(np.abs(r.drive.voltage), axis=0) for r in records], axis=0)
    space = space_of(
        model, joints, study, largest_voltage=voltage.tolist(), floor=options.least_deviation
    )
    if any(joint.spring == "three-slope" for joint in study.arm.joints):
        values = space.values(np.zeros(len(space.unknowns)))
        try:
            space = with_curves(space, study, gear_torques(records, values).tolist())
        except NumericalFailure as failure:
            raise NotIdentifiable(_UNLIKELY) from failure
    return space


def _whole_fit(begun: _Begun, study: Study, options: TuningOptions) -> Fit:
    """In long steps to near the minimum, and from there in short ones.

    With friction that takes its time, if that is asked for or explains much more, and with those
    effects that the study names and the records show.
    """
    rough = with_evident_initial_motion(coarse_search(begun.coarse, begun.start, options), options)
    rough = placed_again(rough, study, options)
    rough = with_stiffness_restarts(rough, options)
    rough = with_evident_sensors(rough, options, rough=True)
    rough = with_bandwidths_apart(rough, study, options, rough=True)
    if options.settling is not False and rough.iterations < options.max_iterations:
        rough = with_settling_times(rough, options)
    if tried(study):
        # the effects have evaluations of their own, as many as the fit without them
        options = replace(options, max_iterations=2 * options.max_iterations)
        rough = with_named_effects(rough, study, options)
    pairs = zip(begun.records, rough.objective.records, strict=True)
    records = [replace(record, moving=coarse.moving) for record, coarse in pairs]
    objective = rough.objective.seen_by(records_with(records, study, rough.objective.space.keys))
    fine = fine_search(objective.reweighted(rough.z), rough.z, rough.iterations, options)
    fine, options = _with_restarts(fine, options)
    if tried(study):
        fine = without_idle_effects(fine, study, options)
    fine = with_evident_sensors(fine, options, rough=False)
    fine = with_bandwidths_apart(fine, study, options, rough=False)
    fine = with_evident_tilts(fine, study, options)
    fine = without_idle_sensors(fine, options)
    return fine if options.settling else without_idle_settling(fine, options)


def _with_restarts(fine: Fit, options: TuningOptions) -> tuple[Fit, TuningOptions]:
    """Again from other curves, where one lost a bend that does not show in long steps.

    These have evaluations of their own, as many as the fit without them.
    """
    more = replace(options, max_iterations=fine.iterations + options.max_iterations)
    again = with_stiffness_restarts(fine, more)
    if again.iterations == fine.iterations:
        return fine, options
    if again.cost < fine.cost:
        return fine_search(
            again.objective.reweighted(again.z), again.z, again.iterations, more
        ), more
    return replace(again, converged=fine.converged), more


def _bounded(fit: Fit, study: Study) -> Iterator[Key]:
    """Parameters that ended at the end of their range, and inertias that such ones are part of.

    A joint's total viscous friction is known where its split is not, and is spared.
    """
    keys = fit.objective.space.keys
    ended = [key for key, at in zip(keys, at_bounds(fit), strict=True) if at and key[0] != SETTLING]
    yield from ended
    derived: dict[Key, Mapping[Key, float]] = {
        (name, 1): parts for name, parts in rigid_inertia(study).items()
    }
    for number in range(1, study.arm.n_joints + 1):
        derived["link_inertia", number] = link_inertia(study, number)
    for key, parts in derived.items():
        if key not in ended and any(part in ended for part in parts):
            yield key


def at_bounds(fit: Fit) -> list[bool]:
    """Which unknowns ended at the end of their range."""
    space = fit.objective.space
    edge = 0.5 * _EDGE * (space.upper - space.lower)
    near: list[bool] = ((fit.z < space.lower + edge) | (fit.z > space.upper - edge)).tolist()
    return near
