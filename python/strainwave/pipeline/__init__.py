"""The only file that knows the order: logs, consistency, rigid, decoupled, tuned, checks, report.

Each stage is one function from records to one record; this package calls them and decides what
happens when one cannot answer. `elastic_joints` holds what lies between logs and joint models,
`run` what accumulates, the time and the progress.
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
    Prediction,
    RecordModel,
    RigidModel,
    Signals,
    Study,
    Suspicion,
)
from strainwave.domain.combinations import is_uncoupled
from strainwave.domain.diagnostics import published_warnings
from strainwave.domain.progress import Progress, ProgressEvent, ignored
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.mounting import with_places
from strainwave.errors import InvalidInput, NotIdentifiable, nearest
from strainwave.identification import amplitude_sweep as sweep
from strainwave.identification import rigid, validation
from strainwave.identification import whole_arm as tuning
from strainwave.identification.motor_responses import motor_response
from strainwave.io import logs
from strainwave.io.atomic_files import write_whole
from strainwave.io.logs.in_memory import Data
from strainwave.io.results import to_document, to_json
from strainwave.io.study import read_study, with_options
from strainwave.numerics.parallel import both, limited, one_blas_thread, side_by_side
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
"""All stages, in order; a run takes a prefix of them."""


def check_stages(names: str | Sequence[str]) -> tuple[str, ...]:
    """The stages to run, checked to be a prefix of all.

    Raises `InvalidInput`: A stage that does not exist, or one whose predecessors are missing.
    """
    listed = names.split(",") if isinstance(names, str) else names
    stages = tuple(name.strip() for name in listed)
    if not stages or stages != STAGES[: len(stages)]:
        unknown = [name for name in stages if name not in STAGES]
        hint = nearest(unknown[0], STAGES) if unknown else ""
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
    progress: Progress = ignored,
    threads: int | None = None,
) -> Identification:
    """Logs to models: every stage on one study.

    `study`: Checked, or the study file.
    `data`: Experiment's name -> its log, a table in memory or a path, in place of the study's file.
    `stages`: A prefix of `STAGES`.
    `options`: In place of the study's [options]: all of them, those that change (stage -> key ->
        value), or "stage.key=value" as on the command line.
    `progress`: Gets a `ProgressEvent` at the start of each part and at each evaluation of the last
        fit.
    `threads`: That may work at a time; one per core without.

    Returns: Its `verdict` says what the data answered and what not.

    Raises `InvalidInput`: the study, a log or an argument is at fault.
    """
    with one_blas_thread(), limited(threads):  # once for all: threads must not set it for others
        run = Run(check_stages(stages), progress)
        with run.timed("read", "reading the logs"):
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
    all_logs, input_check = _usable(run, the_study, all_logs)
    elastic = "decoupled" in run.stages and any(j.elastic for j in run.arm.joints)
    model: RigidModel | None = None
    fitted: tuple[Prediction, ...] = ()
    checks: tuple[Prediction, ...] = ()
    if input_check.motors_agree:  # the rigid model asks nothing of link sensors
        model, fitted, checks = _rigid(run, the_study, all_logs)
        input_check = _with_torques(the_study, input_check, model)
    found = _Elastic()
    doubted = consistency.doubted_torques(input_check)
    if elastic and doubted is not None:
        found, input_check = _second_opinion(run, the_study, all_logs, model, doubted)
    elif elastic and not input_check.suspected:
        found = _elastic(run, the_study, all_logs, model)
    tuned = found.tuned
    motors: tuple[MotorResponse, ...] = ()
    if tuned is not None:
        checks = _with_elastic(run, all_logs, tuned, checks)
        motors = _motor_responses(run, all_logs, tuned, found.starts)
    made = Identification(
        study=the_study,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        stages=run.stages,
        rigid=model,
        fitted=fitted,
        checks=checks,
        warnings=tuple(dict.fromkeys(run.warnings)),
        timing_s=run.timing_s,
        records=found.records,
        joints=found.joints,
        responses=found.responses,
        links=run.links,
        sweeps=sweep.sweeps(found.records),
        tuned=tuned,
        suspected=input_check.suspected,
        motor_responses=motors,
        failures=tuple(run.failures),
        activity=activity_of(all_logs, run.arm),
        logs=raw_logs,
    )
    return replace(made, warnings=published_warnings(made))


@dataclass(frozen=True, slots=True)
class _Elastic:
    """What the stages that know gears found."""

    records: tuple[RecordModel, ...] = ()
    joints: tuple[JointModel, ...] = ()
    responses: Mapping[int, FrequencyResponse] = field(default_factory=dict)
    starts: tuple[JointModel, ...] = ()  # of the whole-arm fit
    tuned: ArmModel | None = None


def _second_opinion(
    run: Run,
    the_study: Study,
    all_logs: Sequence[Log],
    model: RigidModel | None,
    doubted: Suspicion,
) -> tuple[_Elastic, Consistency]:
    """The stages that know gears, where they explain a doubted torque constant; else none."""
    before = run.copied()
    found = _elastic(run, the_study, all_logs, model)
    if found.tuned is None or not tuning.blames_another(found.tuned, run.arm):
        run.forget(before)
        return _Elastic(), Consistency((doubted,))
    text = f"{doubted.message}; but the effect that is named explains all records better"
    run.warnings.append(Diagnostic("torques-contradict", doubted.where, text))
    if found.tuned.criticism is not None and found.tuned.criticism.causes:
        run.failures.append(text)  # until that effect is in the model
    return found, Consistency()


def _elastic(
    run: Run, the_study: Study, all_logs: Sequence[Log], model: RigidModel | None
) -> _Elastic:
    """Joint by joint, and then the whole arm, as far as stages are asked for and data allow."""
    if "tuned" in run.stages:  # which ends with simulations of these
        for log in (*_used_for(all_logs, "tuning"), *_used_for(all_logs, "check")):
            check_servo_clock(run.arm, log)
    stage = decoupled(run, the_study, all_logs, model)
    starts = stage.joints
    if "tuned" in run.stages and not any(
        log.experiment.use in ("frequency", "sweep") for log in all_logs
    ):
        starts = from_catalogue(run, the_study, all_logs, model)

    def whole_arm() -> ArmModel | None:
        if "tuned" not in run.stages or len(starts) != run.arm.n_joints:
            return None
        return _tuned(run, the_study, all_logs, model, starts)

    def record_models() -> tuple[RecordModel, ...]:
        with run.clocked("decoupled"):
            return stage.record_models()

    tuned, records = both(whole_arm, record_models)
    return _Elastic(records, stage.joints, stage.responses, starts, tuned)


def _usable(
    run: Run, the_study: Study, all_logs: Sequence[Log]
) -> tuple[tuple[Log, ...], Consistency]:
    """The records without what their sensors or the logger spoilt, and whether they agree."""
    with run.timed("consistency", "looking for defects, and comparing the channels"):
        kept, found = hygiene.without_defects(all_logs, run.arm)
        run.warnings.extend(found)
        return kept, consistency.check(kept, the_study)


def _with_torques(
    the_study: Study, input_check: Consistency, model: RigidModel | None
) -> Consistency:
    """What the rigid fit says of the joints' torques against each other, with the rest."""
    if model is None or model.torque_ratio is None:
        return input_check
    torques = consistency.torque_constants(*model.torque_ratio, the_study)
    return Consistency((*input_check.suspected, torques)) if torques else input_check


def _rigid(
    run: Run, the_study: Study, all_logs: Sequence[Log]
) -> tuple[RigidModel | None, tuple[Prediction, ...], tuple[Prediction, ...]]:
    """The rigid model, and its predictions of the fitted and of the check records."""
    with run.timed("rigid", "rigid joints: least squares"):
        seen = {use: _signals(run, all_logs, use) for use in ("motion", "check")}
        try:
            model = rigid.fit(seen["motion"], run.arm, the_study.options.rigid)
        except NotIdentifiable as failure:
            if _single_and_excited(run.arm, all_logs) and "decoupled" in run.stages:
                run.warnings.append(Diagnostic("no-rigid-model", str(the_study.path), str(failure)))
            else:
                run.failures.append(str(failure))
            return None, (), ()
        run.warnings.extend(model.warnings)
    if model.status == "not-identifiable":
        return model, (), ()
    with run.timed("checks", "predicting the check records"):
        predictions: dict[str, tuple[Prediction, ...]] = {}
        for use, chosen in seen.items():  # those of the fit first: they show what errors are usual
            own = predictions.get("motion", ())
            made = side_by_side([partial(_predicted, run, model, each, own) for each in chosen])
            predictions[use] = tuple(each for each in made if each is not None)
    run.warnings.extend(c for made in predictions.values() for p in made for c in p.warnings)
    return model, predictions["motion"], predictions["check"]


def _signals(run: Run, all_logs: Sequence[Log], use: str) -> list[Signals]:
    """Motor-side signals of the records of one use, which have them."""
    chosen = _used_for(all_logs, use)
    found = side_by_side([partial(signals.motor_side, log, run.arm) for log in chosen])
    run.warnings.extend(warning for each in found for warning in each.warnings)
    return found


def _predicted(
    run: Run, model: RigidModel, each: Signals, fitted: Sequence[Prediction]
) -> Prediction | None:
    """A record's torques by the rigid model; None, with a warning, of one that is too short."""
    try:
        return validation.predict_rigid(model, each, run.arm, fitted)
    except NotIdentifiable as failure:
        name = each.experiment.name
        run.warnings.append(Diagnostic("nothing-to-predict", name, f"{name} {failure}"))
        return None


def _tuned(
    run: Run,
    the_study: Study,
    all_logs: Sequence[Log],
    model: RigidModel | None,
    joints: Sequence[JointModel],
) -> ArmModel | None:
    """All parameters at once on all records; None, with a warning, without any."""
    what = "fitting the whole arm to all records at once"

    def count(evaluation: int, most: int) -> None:
        said = f"{what}: evaluation {evaluation} of at most {most}"
        run.report("tuned", said, evaluation / most)

    with run.timed("tuned", what):
        try:
            options = the_study.options.tuning
            start = run.sensors
            found = tuning.tune(
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
    # what an earlier stage said of the same sensor is said again, and better
    late = {w.where for w in found.warnings if w.code == "sensor-delay"}
    run.warnings = [w for w in run.warnings if w.code != "sensor-delay" or w.where not in late]
    run.warnings.extend(found.warnings)
    return found


def _with_elastic(
    run: Run,
    all_logs: Sequence[Log],
    tuned: ArmModel,
    checks: tuple[Prediction, ...],
) -> tuple[Prediction, ...]:
    """The check records' torques from the rigid model, and their motion from the tuned arm."""
    made = list(checks)
    with run.timed("checks", "simulating the check records"):
        identified = [
            log
            for log in _used_for(all_logs, "check")
            if missing_recorded_input(run.arm, log) is None
        ]
        placed = with_places(run.arm, tuned.values)
        found = side_by_side(
            [partial(validation.predict_elastic, tuned, log, placed) for log in identified]
        )
    run.warnings.extend(warning for each in found for warning in each.warnings)
    made.extend(found)
    return tuple(made)


def _motor_responses(
    run: Run,
    all_logs: Sequence[Log],
    tuned: ArmModel,
    joints: Sequence[JointModel],
) -> tuple[MotorResponse, ...]:
    """How each motor answers in the records at full amplitude, of rig and fitted arm."""
    with run.timed("checks", "comparing the motors' responses"):
        seen = [
            log
            for log in _used_for(all_logs, "frequency")
            if log.experiment.joint is not None and missing_motor_signal(run.arm, log) is None
        ]
        made = [partial(motor_response, log, tuned, joints, run.arm) for log in seen]
        return tuple(side_by_side(made))


def _used_for(all_logs: Sequence[Log], use: str) -> list[Log]:
    return [log for log in all_logs if log.experiment.use == use]


def _single_and_excited(arm: Arm, all_logs: Sequence[Log]) -> bool:
    """Whether a joint can be identified without a rigid model."""
    return is_uncoupled(arm) and any(log.experiment.use == "frequency" for log in all_logs)


def loading_report(progress: Progress) -> Progress:
    """The progress callback; when the whole-arm fit begins, a thread loads what `write` needs."""
    threads: list[Thread] = []

    def follow(event: ProgressEvent) -> None:
        if event.part == "tuned" and not threads:
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
    progress: Progress = ignored,
) -> None:
    """Result and report, and if wanted every figure as SVG and PNG: all whole or none.

    `folder`: Made where it does not exist; an earlier result in it is replaced.
    `figures`: Whether the report's figures go to `figures/` in the folder, too.
    `progress`: Gets a `ProgressEvent`.

    Raises `InvalidInput`: the folder cannot be written to, or there is no Matplotlib to draw the
    figures.
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
        for name, drawn in figures_of(identification).items():
            for ending, data in images(drawn).items():
                files[f"figures/{name}.{ending}"] = data
    write_whole(folder, files)
