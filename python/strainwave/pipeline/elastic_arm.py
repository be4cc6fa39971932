"""Records that excite the gears -> models of each joint and record, and of the whole arm."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from strainwave.domain import (
    ArmModel,
    Clause,
    Decoupled,
    Diagnostic,
    FrequencyOptions,
    FrequencyResponse,
    JointModel,
    LinkSignals,
    LinkSummary,
    Log,
    MotorResponse,
    Options,
    Place,
    Prediction,
    RecordModel,
    RigidModel,
    StateSpace,
)
from strainwave.domain.arm.combinations import is_uncoupled
from strainwave.domain.arm.link_sensors import with_estimates
from strainwave.domain.arm.parameter_table import COULOMB
from strainwave.domain.keys import Key
from strainwave.domain.results.stage_results import StageResults
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import mean_postures
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification import decoupling, frequency, validation, whole_arm
from strainwave.identification import joint_model as physical
from strainwave.identification.motor_responses import motor_responses
from strainwave.identification.torsion import fit_torsions
from strainwave.numerics.parallel import both, run_parallel
from strainwave.pipeline.inputs import Inputs, Reporter, attempt
from strainwave.signals import link_motion as links
from strainwave.signals.delays import build_delay_warnings, list_removed_delays
from strainwave.signals.link_readings import combine_axes
from strainwave.signals.recorded_input import (
    check_servo_clock,
    missing_motor_signal,
    missing_recorded_input,
)

_MIN_RELATIVE_STD = 1e-6  # of a joint's parameter; gears of recorded arms reach 1e-4

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


def fit_elastic_arm(inputs: Inputs, results: StageResults, reporter: Reporter) -> StageResults:
    """Identify each joint and then the whole arm, as far as requested and possible."""
    rigid_model = results.rigid
    is_requested = "tuned" in inputs.stages and not inputs.arm.rigid_joints
    if is_requested:  # the last stage simulates these records
        for log in inputs.logs_of("tuning", "check"):
            check_servo_clock(inputs.arm, log)
    stage = start = _without_failed_fits(fit_elastic_joints(inputs, rigid_model, reporter))
    warnings, rigid_joints = stage.warnings, inputs.arm.rigid_joints
    if rigid_joints:
        excited = inputs.logs_of("frequency", "sweep")
        unused = tuple(log.name for log in excited if log.experiment.joint in rigid_joints)
        place, variant = inputs.place, "unused" if unused else ""
        warning = Diagnostic("rigid-joints", place, variant, joints=rigid_joints, records=unused)
        warnings += (warning,)
    if is_requested and not inputs.logs_of("frequency", "sweep"):
        start = typical_joints(inputs, rigid_model)
        warnings += start.warnings

    def fit() -> ArmModel | Diagnostic | None:
        if not is_requested or len(start.joints) != inputs.arm.n_joints:
            return None
        return attempt(
            partial(_fit_whole_arm, inputs, rigid_model, start, reporter),
            lambda reason: Diagnostic("not-tuned", inputs.place, "computation", reason=reason),
        )

    def record_models() -> tuple[RecordModel, ...]:
        with reporter.measure_time("decoupled"):
            return stage.record_models()

    outcome, records = both(fit, record_models)
    results = replace(
        results,
        records=records,
        joints=stage.joints,
        responses=stage.responses,
        links=stage.links,
        failures=(*results.failures, *stage.failures),
    )
    if isinstance(outcome, ArmModel):
        # the whole-arm fit replaces the earlier estimates of the same delays
        places = {w.place for w in outcome.warnings if w.code == "sensor-delay"}
        kept = [w for w in warnings if w.code != "sensor-delay" or w.place not in places]
        inputs = replace(inputs, arm=inputs.arm.with_selected_laws(outcome.values))
        checks, not_simulated = predict_checks(inputs, outcome, reporter)
        results = replace(
            results,
            whole_arm=outcome,
            checks=(*results.checks, *checks),
            not_simulated=not_simulated,
            motor_responses=attempt(
                partial(_compare_motors, inputs, outcome, start.joints, reporter), lambda _: ()
            ),
        )
        return results.warn((*kept, *outcome.warnings))
    results = results.warn(warnings if outcome is None else (*warnings, outcome))
    # the torsion of a coupled link is that of several gears
    if rigid_model is None or inputs.arm.is_coupled or rigid_model.status == "not-identifiable":
        return results
    fitted = {joint.joint for joint in stage.joints}
    joints = enumerate(inputs.arm.joints, start=1)
    missing = [i for i, joint in joints if joint.elastic and i not in fitted]
    with reporter.measure_time("decoupled"):
        torsions, of_torsions = fit_torsions(
            inputs.logs_of("motion"), rigid_model, inputs.arm, missing
        )
    return replace(results, torsions=torsions).warn(of_torsions)


def _without_failed_fits(stage: JointStage) -> JointStage:
    """The stage without models of an impossible precision, which are replaced by warnings."""
    failed = {
        joint.joint: Clause("too-precise", label=p.label, value=p.value, std=p.std)
        for joint in stage.joints
        for p in joint.parameters
        if p.value and p.std and p.std < _MIN_RELATIVE_STD * abs(p.value)
    }
    warnings = tuple(
        Diagnostic("not-identifiable", Place(joint=number), "reason", reason=reason)
        for number, reason in failed.items()
    )
    kept = tuple(joint for joint in stage.joints if joint.joint not in failed)
    return replace(stage, joints=kept, warnings=stage.warnings + warnings)


def _fit_whole_arm(
    inputs: Inputs, rigid_model: RigidModel | None, start: JointStage, reporter: Reporter
) -> ArmModel | Diagnostic:
    """Fit all parameters to all records; a warning if that is impossible."""
    activity = "fitting the whole arm to all records at once"

    def count(evaluation: int, limit: int) -> None:
        text = f"{activity}: evaluation {evaluation} of at most {limit}"
        reporter.report("tuned", text, evaluation / limit)

    with reporter.time_part("tuned", activity):
        try:
            return whole_arm.fit_whole_arm(
                inputs.logs,
                rigid_model,
                start.joints,
                inputs.arm,
                inputs.study.options.tuning,
                start={**start.delays, **inputs.start},
                others=start.alternatives,
                progress=count,
            )
        except NotIdentifiable as failure:
            return Diagnostic("not-tuned", inputs.place, reason=str(failure))


def predict_checks(
    inputs: Inputs, arm_model: ArmModel, reporter: Reporter
) -> tuple[tuple[Prediction, ...], Mapping[str, str]]:
    """Simulations of the check records' motion, and why others cannot be simulated."""

    def predict(log: Log) -> Prediction | str:
        try:
            return missing_recorded_input(arm, log) or validation.predict_elastic(
                arm_model, log, arm
            )
        except NumericalFailure as error:
            return str(error)

    with reporter.time_part("checks", "simulating the check records"):
        joints = enumerate(inputs.arm.joints, start=1)
        arm = inputs.arm.with_joints(with_estimates(j, i, arm_model.values) for i, j in joints)
        logs = inputs.logs_of("check")
        outcomes = run_parallel([partial(predict, log) for log in logs])
    reasons = {log.name: each for log, each in zip(logs, outcomes, strict=True)}
    return (
        tuple(each for each in outcomes if isinstance(each, Prediction)),
        {name: reason for name, reason in reasons.items() if isinstance(reason, str)},
    )


def _compare_motors(
    inputs: Inputs, arm_model: ArmModel, joints: tuple[JointModel, ...], reporter: Reporter
) -> tuple[MotorResponse, ...]:
    """Responses of each motor at full amplitude, measured and simulated."""
    with reporter.time_part("checks", "comparing the motors' responses"):
        logs = [
            log
            for log in inputs.logs_of("frequency")
            if log.experiment.joint is not None and missing_motor_signal(inputs.arm, log) is None
        ]
        return tuple(motor_responses(logs, arm_model, joints, inputs.arm))


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
