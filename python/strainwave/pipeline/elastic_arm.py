"""Records that excite the gears -> models of the joints and of the whole arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from strainwave.domain import (
    ArmModel,
    Clause,
    Diagnostic,
    JointModel,
    Log,
    MotorResponse,
    Place,
    Prediction,
    RecordModel,
    RigidModel,
)
from strainwave.domain.arm.link_sensors import with_estimates
from strainwave.domain.results.stage_results import StageResults
from strainwave.errors import NotIdentifiable, NumericalFailure
from strainwave.identification import validation, whole_arm
from strainwave.identification.motor_responses import motor_response
from strainwave.identification.torsion import fit_torsions
from strainwave.numerics.parallel import both, run_parallel
from strainwave.pipeline.elastic_joints import JointStage, fit_elastic_joints, typical_joints
from strainwave.pipeline.inputs import Inputs
from strainwave.pipeline.reporter import Reporter, attempt
from strainwave.signals.recorded_input import (
    check_servo_clock,
    missing_motor_signal,
    missing_recorded_input,
)

_MIN_RELATIVE_STD = 1e-6  # of a joint's parameter; gears of recorded arms reach 1e-4


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
        jobs = [
            partial(motor_response, log, arm_model, joints, inputs.arm)
            for log in inputs.logs_of("frequency")
            if log.experiment.joint is not None and missing_motor_signal(inputs.arm, log) is None
        ]
        return tuple(run_parallel(jobs))
