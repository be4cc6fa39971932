"""Records that excite the gears -> models of each joint, and of each record alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from strainwave.domain import (
    Decoupled,
    Diagnostic,
    FrequencyOptions,
    FrequencyResponse,
    JointModel,
    LinkSignals,
    Log,
    Options,
    RecordModel,
    RigidModel,
    StateSpace,
    Study,
)
from strainwave.domain.combinations import is_uncoupled
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification import decoupling, frequency
from strainwave.identification import joint_model as physical
from strainwave.numerics.parallel import run_parallel
from strainwave.pipeline.run import Run
from strainwave.signals import link_motion as links
from strainwave.signals.mounting_start import substitute_equivalent_sensors

_DecoupledRecord = tuple[Log, LinkSignals, tuple[Decoupled, ...]]
"""A log, the signals of both sides of its gears, and the decoupled joints."""


@dataclass(frozen=True, slots=True)
class JointStage:
    """Models of single joints; members are empty if the records do not suffice."""

    joints: tuple[JointModel, ...] = ()  # one per joint, of all its records
    responses: Mapping[int, FrequencyResponse] = field(default_factory=dict)  # by joint, from 1
    # estimates the models of each excited record and joint, which no later stage uses
    record_models: Callable[[], tuple[RecordModel, ...]] = tuple


def decoupled(
    run: Run,
    the_study: Study,
    all_logs: Sequence[Log],
    model: RigidModel | None,
) -> JointStage:
    """Decouple the joints of each excited record and fit each joint to its full-amplitude records.

    Adds warnings, failures, sensor delays and further starts to the run.
    """
    excited = [log for log in all_logs if log.experiment.use in ("frequency", "sweep")]
    if not excited:
        text = 'the study has no record with use = "frequency" or "sweep": without one the gears'
        text += " start from typical values in the whole-arm fit, if there are step records; record"
        text += " a PRBS on each joint"
        run.warnings.append(Diagnostic("no-frequency-record", str(the_study.path), text))
        return JointStage()
    if model is None and not is_uncoupled(run.arm):
        return JointStage()  # the rigid stage gives the reason

    with run.time_part("decoupled", "decoupling the joints"):
        # a sensor of unknown mounting gets an approximate one until the whole-arm fit
        placed_logs, placed_arm = substitute_equivalent_sensors(excited, run.arm, all_logs)
        sides, delays = links.compute_link_signals(placed_logs, placed_arm, the_study.options.links)
        run.warnings.extend(links.build_delay_warnings(delays))
        run.sensors = links.list_removed_delays(sides, delays)
        if any("motor" in side.sources for side in sides):
            return JointStage(_from_motors(run, the_study, model, sides))
        try:
            joints = run_parallel(
                [partial(decoupling.decouple, side, model, placed_arm) for side in sides]
            )
        except NotIdentifiable as failure:
            run.failures.append(str(failure))
            return JointStage()
        decoupled_records = list(zip(excited, sides, joints, strict=True))
        for log, link_signals, parts in decoupled_records:
            run.warnings.extend(link_signals.warnings)
            run.warnings.extend(w for p in _excited_joints(parts, log) for w in p.warnings)
            run.links += link_signals.summaries
        stage = _fit_joints(run, the_study, model, decoupled_records)
    for joint in stage.joints:
        run.warnings.extend(joint.warnings)
    return stage


def from_catalogue(
    run: Run, the_study: Study, all_logs: Sequence[Log], model: RigidModel | None
) -> tuple[JointModel, ...]:
    """Typical gears to start from if only step records excite them.

    Adds warnings and further starts to the run. Empty without such records, or if the rigid model
    does not suffice.
    """
    if not any(log.experiment.use == "tuning" for log in all_logs):
        return ()
    try:
        joints, *run.others = physical.models_from_catalogue(model, run.arm)
    except NotIdentifiable as failure:
        run.warnings.append(Diagnostic("not-identifiable", str(the_study.path), str(failure)))
        return ()
    return joints


def _from_motors(
    run: Run, the_study: Study, model: RigidModel | None, sides: Sequence[LinkSignals]
) -> tuple[JointModel, ...]:
    """Models of the joints from motor signals, for links without sensors."""
    for side in sides:
        run.warnings.extend(side.warnings)
        run.links += side.summaries
    full = [side for side in sides if side.experiment.use == "frequency"]
    try:
        joints, *run.others = physical.models_from_motors(full or sides, model, run.arm)
    except NotIdentifiable as failure:
        run.warnings.append(Diagnostic("not-identifiable", str(the_study.path), str(failure)))
        return ()
    run.warnings.extend(w for joint in joints for w in joint.warnings)
    return joints


def _fit_joints(
    run: Run,
    the_study: Study,
    model: RigidModel | None,
    decoupled_records: Sequence[_DecoupledRecord],
) -> JointStage:
    """Fit each joint excited at full amplitude to all its records at once.

    Its nonparametric response is estimated too, where its inputs can be separated.
    """
    options = the_study.options
    record_options = physical.RecordOptions(options.physical, options.statespace)
    at_full = [parts for log, _, parts in decoupled_records if log.experiment.use == "frequency"]
    records_by_joint: dict[int, list[tuple[LinkSignals, Decoupled]]] = {}
    for log, link_signals, parts in decoupled_records:
        for part in _excited_joints(parts, log):
            if log.experiment.use == "frequency":
                records_by_joint.setdefault(part.joint, []).append((link_signals, part))

    def fit_joint(
        joint: int,
    ) -> tuple[physical.JointFit | JointModel | Diagnostic, FrequencyResponse | None]:
        response = _response([parts[joint - 1] for parts in at_full], options.responses)
        records = records_by_joint[joint]
        try:
            if options.physical.route == "equations":
                return physical.fit_joint(records, model, run.arm, options.physical), response
            return physical.joint_by_transfer(
                [d for _, d in records], model, run.arm, record_options
            ), response
        except (NotIdentifiable, np.linalg.LinAlgError) as failure:
            return Diagnostic("not-identifiable", f"joint {joint}", str(failure)), response

    numbers = sorted(records_by_joint)
    results = run_parallel([partial(fit_joint, n) for n in numbers])
    run.warnings.extend(result for result, _ in results if isinstance(result, Diagnostic))
    fits = {fit.model.joint: fit for fit, _ in results if isinstance(fit, physical.JointFit)}
    joints = [fit.model for fit in fits.values()]
    joints += [result for result, _ in results if isinstance(result, JointModel)]
    responses = {n: r for n, (_, r) in zip(numbers, results, strict=True) if r is not None}
    for joint in joints if model is None else ():
        # without a rigid model the inputs still contain dry friction, which the models do not have
        records = [
            decoupling.subtract_friction(s, d, joint) for s, d in records_by_joint[joint.joint]
        ]
        response = _response(records, options.responses)
        responses |= {} if response is None else {joint.joint: response}
    ratios = [each.gear_ratio for each in run.arm.joints]
    joints = [
        physical.compare_response(j, ratios[j.joint - 1], responses.get(j.joint)) for j in joints
    ]
    record_models = partial(
        _record_models, run.arm, the_study.options, model, decoupled_records, fits
    )
    return JointStage(tuple(joints), responses, record_models)


def _record_models(
    arm: Arm,
    options: Options,
    model: RigidModel | None,
    decoupled_records: Sequence[_DecoupledRecord],
    fits: Mapping[int, physical.JointFit],
) -> tuple[RecordModel, ...]:
    """Fit the excited joints to each record alone, with their frequency responses.

    The state-space model of a sweep starts from that of a record at full amplitude.
    """
    record_options = physical.RecordOptions(options.physical, options.statespace)
    starts: dict[int, StateSpace] = {}  # by joint

    def fit_record(log: Log, link_signals: LinkSignals, part: Decoupled) -> physical.RecordFit:
        own_options = replace(record_options, judged=log.experiment.use == "frequency")
        together, near = fits.get(part.joint), starts.get(part.joint)
        fit = physical.fit_record(link_signals, part, model, arm, own_options, together, near)
        record = replace(fit.record, response=_response([part], options.responses))
        return replace(fit, record=record)

    excited = [
        (log, both, part)
        for log, both, joints in decoupled_records
        for part in _excited_joints(joints, log)
    ]
    by_use: dict[str, Iterator[RecordModel]] = {}
    for use in ("frequency", "sweep"):
        jobs = [partial(fit_record, *each) for each in excited if each[0].experiment.use == use]
        record_fits = run_parallel(jobs)
        for fit in record_fits if use == "frequency" else ():
            if fit.linear is not None:
                joint = fit.record.signals.joint
                starts.setdefault(joint, fit.linear.of_physical_order())
        by_use[use] = iter([fit.record for fit in record_fits])
    return tuple(next(by_use[log.experiment.use]) for log, _, _ in excited)


def _response(records: Sequence[Decoupled], options: FrequencyOptions) -> FrequencyResponse | None:
    """The nonparametric frequency response; None if the inputs cannot be separated."""
    try:
        return frequency.respond(records, options)
    except (NotIdentifiable, InvalidInput):  # records of several sample times do not combine
        return None


def _excited_joints(parts: Sequence[Decoupled], log: Log) -> list[Decoupled]:
    """The joint that an experiment names, or all."""
    return [part for part in parts if log.experiment.joint in (None, part.joint)]
