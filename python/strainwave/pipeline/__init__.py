"""Run the stages in order: logs, consistency, rigid, decoupled, whole arm, checks, report.

Each part is one function from `Inputs` to a frozen record with its warnings and failures; here
they are combined into an `Identification`. A `Reporter` has the times and the progress of the run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any

from strainwave.domain import (
    STAGES,
    Consistency,
    Diagnostic,
    Identification,
    Log,
    Options,
    RigidModel,
    Stage,
    Study,
    Suspicion,
)
from strainwave.domain.keys import Key, Values
from strainwave.domain.options import Progress, ProgressEvent, ignore_progress
from strainwave.errors import InvalidInput, suggest_name
from strainwave.identification import amplitude_sweep as sweep
from strainwave.identification import whole_arm
from strainwave.io import logs
from strainwave.io.atomic_files import write_whole
from strainwave.io.logs.arrow import Data
from strainwave.io.results import to_document, to_json
from strainwave.io.study import read_study, with_options
from strainwave.numerics.parallel import limited, one_blas_thread
from strainwave.pipeline.elastic_arm import ElasticStages, fit_elastic_arm
from strainwave.pipeline.inputs import (
    CheckedInputs,
    Inputs,
    check_input,
    check_inputs,
    read_start,
    with_sensed_torques,
)
from strainwave.pipeline.reporter import Reporter, attempt
from strainwave.pipeline.rigid_joints import (
    DriveStage,
    RigidStage,
    estimate_drives,
    fit_rigid_joints,
)
from strainwave.report.matplotlib_backend import images
from strainwave.signals.motor import activity_of
from strainwave.signals.torque_constants import (
    find_doubtful_torque_constant,
    suspect_torque_constants,
)
from strainwave.version import __version__

__all__ = ["STAGES", "check_input", "check_stages", "identify", "with_report_loading", "write"]


def check_stages(names: str | Sequence[str]) -> tuple[Stage, ...]:
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
    return STAGES[: len(stages)]


def identify(
    study: Study | Path,
    *,
    data: Data | None = None,
    stages: Sequence[str] = STAGES,
    options: Options | Mapping[str, Mapping[str, Any]] | Sequence[str] | str | None = None,
    start: Path | Mapping[Key, float] | None = None,
    progress: Progress = ignore_progress,
    threads: int | None = None,
) -> Identification:
    """Identify an arm: run the stages on one study.

    `data` maps names of experiments to logs, tables in memory or paths that replace the study's
    files. `options` replaces the study's options: all of them (`Options`), those that differ
    (stage -> key -> value), or "stage.key=value" as on the command line. `start` has values, or a
    file with values, at which the whole-arm fit starts. `progress` is called with
    a `ProgressEvent` at the start of each part and at each evaluation of the whole-arm fit.
    `threads` is the number of threads at a time, one per core by default.

    Raises `InvalidInput` if the study, a log or an argument is invalid. Data that do not determine
    a parameter raise no error: the result has a `verdict`.
    """
    with one_blas_thread(), limited(threads):  # set once: the limit is shared by all threads
        chosen = check_stages(stages)
        reporter = Reporter(chosen, progress)
        with reporter.time_part("read", "reading the logs"):
            the_study = study if isinstance(study, Study) else read_study(study)
            if options is not None:
                the_study = with_options(the_study, options)
            starts = read_start(start, the_study)
            the_study, raw_logs = with_sensed_torques(
                the_study, logs.read_logs(the_study, data=data)
            )
        the_study = the_study.with_segments(log.experiment for log in raw_logs)
        return _identify(the_study, raw_logs, chosen, reporter, starts)


def _identify(
    study: Study,
    raw_logs: Sequence[Log],
    stages: tuple[Stage, ...],
    reporter: Reporter,
    start: Values,
) -> Identification:
    drives = DriveStage(study)
    if study.arm.unknown_drives:
        drives = estimate_drives(study, raw_logs, reporter)
        study = drives.study
    with reporter.time_part("consistency", "detecting defects, checking consistency"):
        check = check_inputs(study, raw_logs, stages)
    check = replace(check, inputs=replace(check.inputs, start=start))
    inputs, is_consistent = check.inputs, not check.consistency.deciding
    rigid = RigidStage()
    if drives.failures:  # without the scale of the torques, no relation holds
        check = replace(check, consistency=Consistency())
    elif check.consistency.motors_agree:  # the rigid model does not use link sensors
        rigid = attempt(
            partial(fit_rigid_joints, inputs, reporter, drives.gains),
            lambda reason: RigidStage(failures=(reason,)),
        )
        check = _compare_torque_constants(check, rigid.model)
    elastic = ElasticStages()
    is_elastic = any(joint.elastic for joint in inputs.arm.joints)
    if "decoupled" in stages and is_elastic and not drives.failures:
        suspicion = find_doubtful_torque_constant(check.consistency)
        if is_consistent and suspicion is not None:  # the rigid fit alone doubts the constant
            elastic, check = _explain_suspicion(check, rigid.model, suspicion, reporter)
        elif not check.consistency.deciding:
            elastic = _fit_elastic_arm(inputs, rigid.model, reporter)
    known = elastic.whole_arm.values if elastic.whole_arm is not None else {}
    study = replace(study, arm=study.arm.with_selected_laws(known))
    warnings = (*check.warnings, *drives.warnings, *rigid.warnings, *elastic.warnings)
    return Identification(
        study=study,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        stages=stages,
        rigid=rigid.model,
        drive_gains=drives.gains.parameters if drives.gains else (),
        fitted=rigid.fitted,
        checks=(*rigid.checks, *elastic.checks),
        not_simulated=elastic.not_simulated,
        stage_warnings=tuple(dict.fromkeys(warnings)),
        timing_s=reporter.timing_s,
        records=elastic.records,
        joints=elastic.joints,
        torsions=elastic.torsions,
        responses=elastic.responses,
        links=elastic.links,
        sweeps=sweep.compare_amplitudes(elastic.records),
        whole_arm=elastic.whole_arm,
        suspected=check.consistency.suspected,
        motor_responses=elastic.motor_responses,
        failures=(*drives.failures, *rigid.failures, *elastic.failures),
        activity=activity_of(inputs.logs, inputs.arm),
        logs=tuple(raw_logs),
    )


def _fit_elastic_arm(inputs: Inputs, model: RigidModel | None, reporter: Reporter) -> ElasticStages:
    """Results of the elastic stages; the reason if none can be computed."""
    return attempt(
        partial(fit_elastic_arm, inputs, model, reporter),
        lambda reason: ElasticStages(failures=(reason,)),
    )


def _compare_torque_constants(check: CheckedInputs, model: RigidModel | None) -> CheckedInputs:
    """Add the ratios of torque constants that the rigid fit estimates to the consistency check."""
    ratios = model.torque_ratios if model is not None else {}
    torques = suspect_torque_constants(ratios, check.inputs.study)
    if torques is None or torques.code in {each.code for each in check.consistency.suspected}:
        return check
    accept = check.inputs.study.options.accept
    return replace(check, consistency=check.consistency.suspecting(torques, accept=accept))


def _explain_suspicion(
    check: CheckedInputs, model: RigidModel | None, suspicion: Suspicion, reporter: Reporter
) -> tuple[ElasticStages, CheckedInputs]:
    """Results of the elastic stages if they explain a suspected torque constant; else none."""
    result = _fit_elastic_arm(check.inputs, model, reporter)
    arm_model = result.whole_arm
    if arm_model is None or not whole_arm.has_likelier_effect(arm_model, check.inputs.arm):
        return ElasticStages(), check
    places, contradiction = suspicion.places, suspicion.clause
    warning = Diagnostic("torques-contradict", places, contradiction=contradiction)
    result = replace(result, warnings=(*result.warnings, warning))
    accepted = tuple(each for each in check.consistency.suspected if each.accepted)
    return result, replace(check, consistency=replace(check.consistency, suspected=accepted))


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
    from strainwave.report import document  # noqa: F401
    from strainwave.report.html import load_template

    load_template("document/page")


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
    from strainwave.report.document import figures_of, render

    reporter = Reporter(identification.stages, progress)
    with reporter.time_part("report", "writing the report"):
        page = render(identification).encode()
    document = to_document(identification)
    document["timing_s"] |= reporter.timing_s
    files = {"report.html": page, "result.json": to_json(document)}
    if figures:
        for name, figure in figures_of(identification).items():
            for ending, data in images(figure).items():
                files[f"figures/{name}.{ending}"] = data
    write_whole(folder, files)
