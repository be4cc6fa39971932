"""Run the stages in order: logs, consistency, rigid, decoupled, whole arm, checks, report.

Each part is one function from `Inputs` to a frozen record with its warnings and failures; here
they are combined into an `Identification`. A `Reporter` has the times and the progress of the run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any

from strainwave.domain import (
    STAGES,
    Consistency,
    Diagnostic,
    DriveGains,
    Identification,
    Log,
    Options,
    Stage,
    Study,
    Suspicion,
)
from strainwave.domain.keys import Key, Values
from strainwave.domain.results.stage_results import StageResults
from strainwave.domain.study import Progress, ProgressEvent, ignore_progress
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, suggest_name
from strainwave.identification import amplitude_sweep as sweep
from strainwave.identification import whole_arm
from strainwave.identification.rigid.torque_constants import (
    find_doubtful_torque_constant,
    suspect_torque_constants,
)
from strainwave.io.atomic_files import write_whole
from strainwave.io.logs.arrays import Data
from strainwave.io.study import read_study, with_options
from strainwave.numerics.dask_cluster import distributed
from strainwave.numerics.parallel import limited, one_blas_thread
from strainwave.pipeline.elastic_arm import fit_elastic_arm
from strainwave.pipeline.inputs import (
    Reporter,
    attempt,
    check_input,
    check_inputs,
    read_records,
    read_start,
)
from strainwave.pipeline.position_servos import fit_servos
from strainwave.pipeline.rigid_joints import estimate_drives, fit_rigid_joints
from strainwave.report.matplotlib_backend import images
from strainwave.signals.motor import activity_of
from strainwave.version import __version__

__all__ = ["STAGES", "check_input", "check_stages", "identify", "with_output_loading", "write"]


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
    scheduler: str | None = None,
) -> Identification:
    """Identify an arm: run the stages on one study.

    `data` maps names of experiments to logs, tables in memory or paths that replace the study's
    files. `options` replaces the study's options: all of them (`Options`), those that differ
    (stage -> key -> value), or "stage.key=value" as on the command line. `start` has values, or a
    file with values, at which the whole-arm fit starts. `progress` is called with
    a `ProgressEvent` at the start of each part and at each evaluation of the whole-arm fit.
    `threads` is the number of threads at a time, one per core by default. `scheduler` is the
    address of a Dask scheduler, whose workers evaluate the records of a large whole-arm fit.

    Raises `InvalidInput` if the study, a log or an argument is invalid, or the cluster fails. Data
    that do not determine a parameter raise no error: the result has a `verdict`.
    """
    # set once: the limit is shared by all threads
    with one_blas_thread(), distributed(scheduler), limited(threads):
        chosen = check_stages(stages)
        reporter = Reporter(chosen, progress)
        with reporter.time_part("read", "reading the logs"):
            the_study = study if isinstance(study, Study) else read_study(study)
            if options is not None:
                the_study = with_options(the_study, options)
            starts = read_start(start, the_study)
            the_study, raw_logs = read_records(the_study, data=data)
        return _identify(the_study, raw_logs, chosen, reporter, starts)


def _identify(
    study: Study,
    raw_logs: Sequence[Log],
    stages: tuple[Stage, ...],
    reporter: Reporter,
    start: Values,
) -> Identification:
    results = StageResults(study=study, stages=stages, rigid=None, logs=tuple(raw_logs))
    gains: DriveGains | None = None
    if study.arm.unknown_drives:
        results, gains = estimate_drives(results, reporter)
    with reporter.time_part("consistency", "detecting defects, checking consistency"):
        inputs, consistency = check_inputs(results.study, raw_logs, stages)
    inputs, is_consistent = replace(inputs, start=start), not consistency.deciding
    results = replace(results, stage_warnings=(*consistency.warnings, *results.stage_warnings))
    has_scale = not results.failures
    if not has_scale:  # without the scale of the torques, no relation holds
        consistency = Consistency()
    elif study.arm.position_servo is not None:
        results = attempt(partial(fit_servos, inputs, results, reporter), results.fail)
    elif consistency.motors_agree:  # the rigid model does not use link sensors
        results = attempt(partial(fit_rigid_joints, inputs, results, reporter, gains), results.fail)
        consistency = _compare_torque_constants(consistency, results)
    is_fitted = study.arm.position_servo is None and has_scale
    if "decoupled" in stages and is_fitted and any(joint.elastic for joint in inputs.arm.joints):
        fit = partial(attempt, partial(fit_elastic_arm, inputs, results, reporter), results.fail)
        suspicion = find_doubtful_torque_constant(consistency)
        if is_consistent and suspicion is not None:  # the rigid fit alone doubts the constant
            results, consistency = _explain_suspicion(results, fit(), consistency, suspicion)
        elif not consistency.deciding:
            results = fit()
    known = results.whole_arm.values if results.whole_arm is not None else {}
    study = results.study
    results = replace(
        results,
        study=replace(study, arm=study.arm.with_selected_laws(known)),
        stage_warnings=tuple(dict.fromkeys(results.stage_warnings)),
        sweeps=sweep.compare_amplitudes(results.records),
        suspected=consistency.suspected,
        activity=results.activity or activity_of(inputs.logs, inputs.arm),
    )
    return Identification(
        **{each.name: getattr(results, each.name) for each in fields(results)},
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        timing_s=reporter.timing_s,
    )


def _compare_torque_constants(consistency: Consistency, results: StageResults) -> Consistency:
    """Add the ratios of torque constants that the rigid fit estimates to the consistency check."""
    ratios = results.rigid.torque_ratios if results.rigid is not None else {}
    torques = suspect_torque_constants(ratios, results.study)
    if torques is None or torques.code in {each.code for each in consistency.suspected}:
        return consistency
    return consistency.suspecting(torques, accept=results.study.options.accept)


def _explain_suspicion(
    results: StageResults, fit: StageResults, consistency: Consistency, suspicion: Suspicion
) -> tuple[StageResults, Consistency]:
    """Results of the elastic stages if they explain a suspected torque constant; else none."""
    arm_model, arm = fit.whole_arm, Arm.of(results.study.arm)
    if arm_model is None or not whole_arm.has_likelier_effect(arm_model, arm):
        return results, consistency
    places, contradiction = suspicion.places, suspicion.clause
    warning = Diagnostic("torques-contradict", places, contradiction=contradiction)
    accepted = tuple(each for each in consistency.suspected if each.accepted)
    return fit.warn([warning]), replace(consistency, suspected=accepted)


def with_output_loading(progress: Progress) -> Progress:
    """Wrap a progress callback: during the whole-arm fit, a thread loads the code of the output."""
    threads: list[Thread] = []

    def load_output() -> None:
        from strainwave.io import results  # noqa: F401
        from strainwave.report import terminal  # noqa: F401
        from strainwave.report.document.blocks import load_page

        load_page()

    def follow(event: ProgressEvent) -> None:
        if event.stage == "tuned" and not threads:
            threads.append(Thread(target=load_output))
            threads[0].start()
        progress(event)

    return follow


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
    from strainwave.io.results import to_document, to_json
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
