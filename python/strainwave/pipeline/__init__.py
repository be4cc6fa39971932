"""Run the stages in order: logs, consistency, rigid, decoupled, tuned, checks, report.

Each stage is one function from records to one record. This package calls the stages and decides
the consequence if a stage has no result. `elastic_joints` computes joint models from logs; `run`
holds the state of a run, its times and its progress.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any

from strainwave import __version__
from strainwave.domain import (
    ArmModel,
    Consistency,
    Diagnostic,
    FrequencyResponse,
    Identification,
    JointModel,
    Log,
    MotorResponse,
    Options,
    Place,
    Prediction,
    RecordModel,
    RigidModel,
    Signals,
    Study,
    Suspicion,
)
from strainwave.domain.combinations import is_uncoupled
from strainwave.domain.diagnostics import published_warnings
from strainwave.domain.progress import Progress, ProgressEvent, ignore_progress
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.mounting import with_sensor_positions
from strainwave.errors import InvalidInput, NotIdentifiable, suggest_name
from strainwave.identification import amplitude_sweep as sweep
from strainwave.identification import rigid, validation, whole_arm
from strainwave.identification.motor_responses import motor_response
from strainwave.io import logs
from strainwave.io.atomic_files import write_whole
from strainwave.io.logs.in_memory import Data
from strainwave.io.results import to_document, to_json
from strainwave.io.study import read_study, with_options
from strainwave.numerics.parallel import both, limited, one_blas_thread, run_parallel
from strainwave.pipeline.elastic_joints import decoupled, from_catalogue
from strainwave.pipeline.run import Run, planned_parts
from strainwave.presentation.matplotlib_backend import images
from strainwave.signals import consistency, hygiene
from strainwave.signals import motor as signals
from strainwave.signals.activity import activity_of
from strainwave.signals.recorded_input import (
    check_servo_clock,
    missing_motor_signal,
    missing_recorded_input,
)

STAGES = ("rigid", "decoupled", "tuned")
"""All stages in order; a run executes a prefix of them."""


def check_stages(names: str | Sequence[str]) -> tuple[str, ...]:
    """The stages to run. Raises `InvalidInput` unless they are a prefix of `STAGES`."""
    listed = names.split(",") if isinstance(names, str) else names
    stages = tuple(name.strip() for name in listed)
    if not stages or stages != STAGES[: len(stages)]:
        unknown = [name for name in stages if name not in STAGES]
        hint = suggest_name(unknown[0], STAGES) if unknown else ""
        raise InvalidInput(
            f"cannot run the stages {', '.join(stages) or '(none)'}",
            where="--stages",
            remedy=f"give the first of {', '.join(STAGES)}, in this order{hint}",
        )
    return stages


def identify(
    study: Study | Path,
    *,
    data: Data | None = None,
    stages: Sequence[str] = STAGES,
    options: Options | Mapping[str, Mapping[str, Any]] | Sequence[str] | None = None,
    progress: Progress = ignore_progress,
    threads: int | None = None,
) -> Identification:
    """Identify an arm: run the stages on one study.

    `data` maps names of experiments to logs, tables in memory or paths that replace the study's
    files. `options` replaces the study's options: all of them (`Options`), those that differ
    (stage -> key -> value), or "stage.key=value" as on the command line. `progress` is called with
    a `ProgressEvent` at the start of each part and at each evaluation of the whole-arm fit.
    `threads` is the number of threads at a time, one per core by default.

    Raises `InvalidInput` if the study, a log or an argument is invalid. Data that do not determine
    a parameter raise no error: the result has a `verdict`.
    """
    with one_blas_thread(), limited(threads):  # set once: the limit is shared by all threads
        run = Run(check_stages(stages), progress)
        with run.time_part("read", "reading the logs"):
            the_study = study if isinstance(study, Study) else read_study(study)
            if options is not None:
                the_study = with_options(the_study, options)
            all_logs = logs.read_logs(the_study, data=data)
        return _identify(the_study, all_logs, run)


def _identify(the_study: Study, all_logs: Sequence[Log], run: Run) -> Identification:
    run.arm = Arm.of(the_study.arm)
    raw_logs = tuple(all_logs)
    for log in all_logs:
        run.warnings.extend(log.warnings)
    all_logs, input_check = _check_logs(run, the_study, all_logs)
    elastic = "decoupled" in run.stages and any(j.elastic for j in run.arm.joints)
    model: RigidModel | None = None
    fitted: tuple[Prediction, ...] = ()
    checks: tuple[Prediction, ...] = ()
    if input_check.motors_agree:  # the rigid model does not use link sensors
        model, fitted, checks = _fit_rigid(run, the_study, all_logs)
        input_check = _add_torque_constants(the_study, input_check, model)
    result = _ElasticResult()
    suspicion = consistency.find_doubtful_torque_constant(input_check)
    if elastic and suspicion is not None:
        result, input_check = _explain_suspicion(run, the_study, all_logs, model, suspicion)
    elif elastic and not input_check.suspected:
        result = _fit_elastic(run, the_study, all_logs, model)
    arm_model = result.whole_arm
    motors: tuple[MotorResponse, ...] = ()
    if arm_model is not None:
        checks = _add_elastic_predictions(run, all_logs, arm_model, checks)
        motors = _motor_responses(run, all_logs, arm_model, result.starts)
    identification = Identification(
        study=the_study,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        stages=run.stages,
        rigid=model,
        fitted=fitted,
        checks=checks,
        warnings=tuple(dict.fromkeys(run.warnings)),
        timing_s=run.timing_s,
        records=result.records,
        joints=result.joints,
        responses=result.responses,
        links=run.links,
        sweeps=sweep.sweeps(result.records),
        whole_arm=arm_model,
        suspected=input_check.suspected,
        motor_responses=motors,
        failures=tuple(run.failures),
        activity=activity_of(all_logs, run.arm),
        logs=raw_logs,
    )
    return replace(identification, warnings=published_warnings(identification))


@dataclass(frozen=True, slots=True)
class _ElasticResult:
    """Results of the stages that model elastic gears."""

    records: tuple[RecordModel, ...] = ()
    joints: tuple[JointModel, ...] = ()
    responses: Mapping[int, FrequencyResponse] = field(default_factory=dict)
    starts: tuple[JointModel, ...] = ()  # of the whole-arm fit
    whole_arm: ArmModel | None = None


def _explain_suspicion(
    run: Run,
    the_study: Study,
    all_logs: Sequence[Log],
    model: RigidModel | None,
    suspicion: Suspicion,
) -> tuple[_ElasticResult, Consistency]:
    """Results of the elastic stages if they explain a suspected torque constant; else none."""
    before = run.copy_state()
    result = _fit_elastic(run, the_study, all_logs, model)
    if result.whole_arm is None or not whole_arm.has_likelier_effect(result.whole_arm, run.arm):
        run.restore(before)
        return _ElasticResult(), Consistency((suspicion,))
    text = f"{suspicion.message}; the effect named in the warnings explains all records better"
    run.warnings.append(Diagnostic("torques-contradict", suspicion.where, text))
    if result.whole_arm.criticism is not None and result.whole_arm.criticism.causes:
        run.failures.append(text)  # until that effect is in the model
    return result, Consistency()


def _fit_elastic(
    run: Run, the_study: Study, all_logs: Sequence[Log], model: RigidModel | None
) -> _ElasticResult:
    """Identify each joint and then the whole arm, as far as requested and possible."""
    if "tuned" in run.stages:  # the last stage simulates these records
        for log in (*_logs_of_use(all_logs, "tuning"), *_logs_of_use(all_logs, "check")):
            check_servo_clock(run.arm, log)
    stage = decoupled(run, the_study, all_logs, model)
    starts = stage.joints
    if "tuned" in run.stages and not any(
        log.experiment.use in ("frequency", "sweep") for log in all_logs
    ):
        starts = from_catalogue(run, the_study, all_logs, model)

    def fit() -> ArmModel | None:
        if "tuned" not in run.stages or len(starts) != run.arm.n_joints:
            return None
        return _fit_whole_arm(run, the_study, all_logs, model, starts)

    def record_models() -> tuple[RecordModel, ...]:
        with run.measure_time("decoupled"):
            return stage.record_models()

    arm_model, records = both(fit, record_models)
    return _ElasticResult(records, stage.joints, stage.responses, starts, arm_model)


def _check_logs(
    run: Run, the_study: Study, all_logs: Sequence[Log]
) -> tuple[tuple[Log, ...], Consistency]:
    """Mask defects of sensors and loggers, and check the consistency of the channels."""
    with run.time_part("consistency", "detecting defects, checking consistency"):
        usable, warnings = hygiene.repair_records(all_logs, run.arm)
        run.warnings.extend(warnings)
        return usable, consistency.check(usable, the_study)


def _add_torque_constants(
    the_study: Study, input_check: Consistency, model: RigidModel | None
) -> Consistency:
    """Add to the consistency check the ratio of torque constants that the rigid fit estimates."""
    ratio = model.torque_ratios.get(2) if model is not None else None
    if ratio is None:
        return input_check
    torques = consistency.suspect_torque_constants(*ratio, the_study)
    return Consistency((*input_check.suspected, torques)) if torques else input_check


def _fit_rigid(
    run: Run, the_study: Study, all_logs: Sequence[Log]
) -> tuple[RigidModel | None, tuple[Prediction, ...], tuple[Prediction, ...]]:
    """The rigid model with its predictions of the fitted records and of the check records."""
    with run.time_part("rigid", "rigid joints: least squares"):
        records = {use: _motor_signals(run, all_logs, use) for use in ("motion", "check")}
        try:
            model = rigid.fit(records["motion"], run.arm, the_study.options.rigid)
        except NotIdentifiable as failure:
            if _single_and_excited(run.arm, all_logs) and "decoupled" in run.stages:
                run.warnings.append(Diagnostic("no-rigid-model", str(the_study.path), str(failure)))
            else:
                run.failures.append(str(failure))
            return None, (), ()
        run.warnings.extend(model.warnings)
    if model.status == "not-identifiable":
        return model, (), ()
    with run.time_part("checks", "predicting the check records"):
        predictions: dict[str, tuple[Prediction, ...]] = {}
        for (
            use,
            of_use,
        ) in records.items():  # fitted records first: they determine the expected errors
            fitted = predictions.get("motion", ())
            predicted = run_parallel(
                [partial(_predict, run, model, record, fitted) for record in of_use]
            )
            predictions[use] = tuple(p for p in predicted if p is not None)
    run.warnings.extend(w for group in predictions.values() for p in group for w in p.warnings)
    return model, predictions["motion"], predictions["check"]


def _motor_signals(run: Run, all_logs: Sequence[Log], use: str) -> list[Signals]:
    """Motor-side signals of the records of one use."""
    used = _logs_of_use(all_logs, use)
    motor_sides = run_parallel(
        [partial(signals.prepare_motor_signals, log, run.arm) for log in used]
    )
    run.warnings.extend(warning for each in motor_sides for warning in each.warnings)
    return motor_sides


def _predict(
    run: Run, model: RigidModel, record: Signals, fitted: Sequence[Prediction]
) -> Prediction | None:
    """Predict the torques of a record; None, with a warning, if the record is too short."""
    try:
        return validation.predict_rigid(model, record, run.arm, fitted)
    except NotIdentifiable as failure:
        name = record.experiment.name
        run.warnings.append(
            Diagnostic.at("nothing-to-predict", Place.in_records(name), f"{name} {failure}")
        )
        return None


def _fit_whole_arm(
    run: Run,
    the_study: Study,
    all_logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
) -> ArmModel | None:
    """Fit all parameters to all records; None, with a warning, if that is impossible."""
    activity = "fitting the whole arm to all records at once"

    def count(evaluation: int, limit: int) -> None:
        text = f"{activity}: evaluation {evaluation} of at most {limit}"
        run.report("tuned", text, evaluation / limit)

    with run.time_part("tuned", activity):
        try:
            options = the_study.options.tuning
            start = run.sensors
            arm_model = whole_arm.fit_whole_arm(
                all_logs,
                model,
                joints,
                run.arm,
                options,
                start=start,
                others=run.others,
                progress=count,
            )
        except NotIdentifiable as failure:
            run.warnings.append(Diagnostic("not-tuned", str(the_study.path), str(failure)))
            return None
    # the whole-arm fit replaces the earlier estimates of the same delays
    places = {w.place for w in arm_model.warnings if w.code == "sensor-delay"}
    run.warnings = [w for w in run.warnings if w.code != "sensor-delay" or w.place not in places]
    run.warnings.extend(arm_model.warnings)
    return arm_model


def _add_elastic_predictions(
    run: Run,
    all_logs: Sequence[Log],
    arm_model: ArmModel,
    checks: tuple[Prediction, ...],
) -> tuple[Prediction, ...]:
    """Add simulations of the check records' motion to the predictions of their torques."""
    with run.time_part("checks", "simulating the check records"):
        simulated = [
            log
            for log in _logs_of_use(all_logs, "check")
            if missing_recorded_input(run.arm, log) is None
        ]
        arm = with_sensor_positions(run.arm, arm_model.values)
        predictions = run_parallel(
            [partial(validation.predict_elastic, arm_model, log, arm) for log in simulated]
        )
    run.warnings.extend(warning for each in predictions for warning in each.warnings)
    return (*checks, *predictions)


def _motor_responses(
    run: Run,
    all_logs: Sequence[Log],
    arm_model: ArmModel,
    joints: Sequence[JointModel],
) -> tuple[MotorResponse, ...]:
    """Responses of each motor at full amplitude, measured and simulated."""
    with run.time_part("checks", "comparing the motors' responses"):
        used = [
            log
            for log in _logs_of_use(all_logs, "frequency")
            if log.experiment.joint is not None and missing_motor_signal(run.arm, log) is None
        ]
        jobs = [partial(motor_response, log, arm_model, joints, run.arm) for log in used]
        return tuple(run_parallel(jobs))


def _logs_of_use(all_logs: Sequence[Log], use: str) -> list[Log]:
    return [log for log in all_logs if log.experiment.use == use]


def _single_and_excited(arm: Arm, all_logs: Sequence[Log]) -> bool:
    """Whether the joints can be identified without a rigid model."""
    return is_uncoupled(arm) and any(log.experiment.use == "frequency" for log in all_logs)


def with_report_loading(progress: Progress) -> Progress:
    """Wrap a progress callback: a thread loads the report's code during the whole-arm fit."""
    threads: list[Thread] = []

    def follow(event: ProgressEvent) -> None:
        if event.stage == "tuned" and not threads:
            threads.append(Thread(target=_load_report))
            threads[0].start()
        progress(event)

    return follow


def _load_report() -> None:
    from strainwave.presentation import report  # noqa: F401
    from strainwave.presentation.html import load_template

    load_template("report/page")


def write(
    identification: Identification,
    folder: Path,
    *,
    figures: bool = False,
    progress: Progress = ignore_progress,
) -> None:
    """Write result.json and report.html, and with `figures` every figure as SVG and PNG.

    The files appear all at once or not at all, and replace an earlier result in the folder. Raises
    `InvalidInput` if the folder cannot be written to or Matplotlib is missing.
    """
    from strainwave.presentation.report import figures_of, render

    parts = len(planned_parts(identification.stages))
    progress(ProgressEvent("report", (parts - 1) / parts, "writing the report", parts, parts))
    begin = time.perf_counter()
    page = render(identification).encode()
    timing = {**identification.timing_s, "report": time.perf_counter() - begin}
    document = to_json(to_document(replace(identification, timing_s=timing)))
    files = {"report.html": page, "result.json": document}
    if figures:
        for name, figure in figures_of(identification).items():
            for ending, data in images(figure).items():
                files[f"figures/{name}.{ending}"] = data
    write_whole(folder, files)
