"""Records that excite the gears -> models of each joint, and of each record alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from strainwave.domain import (
    Clause,
    Decoupled,
    Diagnostic,
    FrequencyOptions,
    FrequencyResponse,
    JointModel,
    LinkSignals,
    LinkSummary,
    Log,
    Options,
    Place,
    RecordModel,
    RigidModel,
    StateSpace,
)
from strainwave.domain.arm.combinations import is_uncoupled
from strainwave.domain.arm.parameter_table import COULOMB
from strainwave.domain.keys import Key
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import mean_postures
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification import decoupling, frequency
from strainwave.identification import joint_model as physical
from strainwave.numerics.parallel import run_parallel
from strainwave.pipeline.inputs import Inputs
from strainwave.pipeline.reporter import Reporter
from strainwave.signals import link_motion as links
from strainwave.signals.delays import build_delay_warnings, list_removed_delays
from strainwave.signals.link_readings import combine_axes

_DecoupledRecord = tuple[Log, LinkSignals, tuple[Decoupled, ...]]
"""A log, the signals of both sides of its gears, and the decoupled joints."""


@dataclass(frozen=True, slots=True)
class JointStage:
    """Models of single joints; members are empty if the records do not suffice."""

    joints: tuple[JointModel, ...] = ()  # one per joint, of all its records
    alternatives: tuple[tuple[JointModel, ...], ...] = ()  # further models to start from
    responses: Mapping[int, FrequencyResponse] = field(default_factory=dict)  # by joint, from 1
    delays: Mapping[Key, float] = field(default_factory=dict)  # of sensors, removed here
    links: tuple[LinkSummary, ...] = ()
    # estimates the models of each excited record and joint, which no later stage uses
    record_models: Callable[[], tuple[RecordModel, ...]] = tuple
    warnings: tuple[Diagnostic, ...] = ()
    failures: tuple[Clause, ...] = ()


def fit_elastic_joints(
    inputs: Inputs, rigid_model: RigidModel | None, reporter: Reporter
) -> JointStage:
    """Decouple the joints of each excited record and fit each joint to its full-amplitude records.

    Without excited records, there are no models.
    """
    # a model of one joint has one link inertia, that of the arm without payload
    excited = [
        log
        for log in inputs.logs_of("frequency", "sweep")
        if not log.experiment.payload and log.experiment.joint not in inputs.arm.rigid_joints
    ]
    if not excited:
        return JointStage(warnings=(Diagnostic("no-frequency-record", inputs.place),))
    if rigid_model is None and not is_uncoupled(inputs.arm):
        return JointStage()  # the rigid stage gives the reason
    with reporter.time_part("decoupled", "decoupling the joints"):
        arm, options = inputs.arm, inputs.study.options
        # a sensor of unknown mounting has an approximate one until the whole-arm fit
        combined = combine_axes(excited, arm, inputs.logs)
        sides, delays = links.compute_link_signals(excited, arm, options.links, combined)
        removed = list_removed_delays(sides, delays)
        warnings = list(build_delay_warnings(delays))
        # the motion of a coupled link follows several motors: no joint has a model of its own
        if inputs.arm.is_coupled or any("motor" in side.sources for side in sides):
            warnings += [warning for side in sides for warning in side.warnings]
            full = [side for side in sides if side.experiment.use == "frequency"]
            fit = partial(physical.models_from_motors, full or sides)
            stage = _fit_alternatives(inputs, fit, rigid_model)
        else:
            try:
                postures = mean_postures(sides)
                decouple = partial(
                    decoupling.decouple, model=rigid_model, arm=arm, postures=postures
                )
                joints = run_parallel([partial(decouple, side) for side in sides])
            except NotIdentifiable as failure:
                failures = (Clause("text", text=str(failure)),)
                return JointStage(delays=removed, warnings=tuple(warnings), failures=failures)
            decoupled_records = list(zip(excited, sides, joints, strict=True))
            for log, side, parts in decoupled_records:
                warnings += side.warnings
                warnings += [
                    w for part in _excited_joints(parts, log, inputs.arm) for w in part.warnings
                ]
            stage = _fit_joints(inputs, rigid_model, decoupled_records)
    warnings += [*stage.warnings, *(w for joint in stage.joints for w in joint.warnings)]
    summaries = tuple(summary for side in sides for summary in side.links)
    return replace(stage, delays=removed, links=summaries, warnings=tuple(warnings))


def typical_joints(inputs: Inputs, rigid_model: RigidModel | None) -> JointStage:
    """Typical gears to start from if only step records excite them."""
    if not inputs.logs_of("tuning"):
        return JointStage()
    return _fit_alternatives(inputs, physical.models_from_catalogue, rigid_model)


def _fit_alternatives(
    inputs: Inputs,
    fit: Callable[[RigidModel | None, Arm], Sequence[tuple[JointModel, ...]]],
    rigid_model: RigidModel | None,
) -> JointStage:
    """The best of several sets of joint models, and the others."""
    try:
        joints, *others = fit(rigid_model, inputs.arm)
    except NotIdentifiable as failure:
        place, reason = inputs.place, str(failure)
        warning = Diagnostic("not-identifiable", place, "reason", reason=reason)
        return JointStage(warnings=(warning,))
    return JointStage(joints, tuple(others))


def _fit_joints(
    inputs: Inputs, model: RigidModel | None, decoupled_records: Sequence[_DecoupledRecord]
) -> JointStage:
    """Fit each joint excited at full amplitude to all its records at once.

    Its nonparametric response is estimated too, where its inputs can be separated.
    """
    options, arm = inputs.study.options, inputs.arm
    record_options = physical.RecordOptions(options.physical, options.statespace)
    at_full = [parts for log, _, parts in decoupled_records if log.experiment.use == "frequency"]
    records_by_joint: dict[int, list[tuple[LinkSignals, Decoupled]]] = {}
    for log, link_signals, parts in decoupled_records:
        for part in _excited_joints(parts, log, arm):
            if log.experiment.use == "frequency":
                records_by_joint.setdefault(part.joint, []).append((link_signals, part))

    def fit_joint(
        joint: int,
    ) -> tuple[physical.JointFit | JointModel | Diagnostic, FrequencyResponse | None]:
        response = _response([parts[joint - 1] for parts in at_full], options.responses)
        records = records_by_joint[joint]
        decoupled = [d for _, d in records]
        try:
            if options.physical.route == "equations":
                return physical.fit_joint(records, model, arm, options.physical), response
            return physical.joint_by_transfer(decoupled, model, arm, record_options), response
        except (NotIdentifiable, np.linalg.LinAlgError) as failure:
            place, reason = Place(joint=joint), str(failure)
            return Diagnostic("not-identifiable", place, "reason", reason=reason), response

    numbers = sorted(records_by_joint)
    results = run_parallel([partial(fit_joint, n) for n in numbers])
    warnings = tuple(result for result, _ in results if isinstance(result, Diagnostic))
    fits = {fit.model.joint: fit for fit, _ in results if isinstance(fit, physical.JointFit)}
    joints = [fit.model for fit in fits.values()]
    joints += [result for result, _ in results if isinstance(result, JointModel)]
    responses = {n: r for n, (_, r) in zip(numbers, results, strict=True) if r is not None}
    for joint in joints:
        if model is not None and model.value(COULOMB, joint.joint) is not None:
            continue
        # the inputs still contain dry friction, which the models do not have
        records = [
            decoupling.subtract_friction(s, d, joint) for s, d in records_by_joint[joint.joint]
        ]
        response = _response(records, options.responses)
        responses |= {} if response is None else {joint.joint: response}
    ratios = arm.gear_ratios.tolist()
    joints = [
        physical.compare_response(j, ratios[j.joint - 1], responses.get(j.joint)) for j in joints
    ]
    record_models = partial(_record_models, arm, options, model, decoupled_records, fits)
    return JointStage(
        tuple(joints), responses=responses, record_models=record_models, warnings=warnings
    )


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
        for part in _excited_joints(joints, log, arm)
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
        return frequency.estimate_response(records, options)
    except (NotIdentifiable, InvalidInput):  # records of several sample times do not combine
        return None


def _excited_joints(parts: Sequence[Decoupled], log: Log, arm: Arm) -> list[Decoupled]:
    """The elastic joint that an experiment names, or all of them."""
    elastic = [part for part in parts if part.joint not in arm.rigid_joints]
    return [part for part in elastic if log.experiment.joint in (None, part.joint)]
