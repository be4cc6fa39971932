"""The command line: arguments, progress, exit codes.

Exit codes: 0 done; 1 a bug; 2 the input is at fault; 3 the verdict is not "determined"
(docs/result.md); 4 the compared results differ, or an arm changes; 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from textwrap import shorten
from typing import Annotated, Any, Literal

import typer

from strainwave.commands import command_texts
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.version import __version__

app = typer.Typer(
    name="strainwave",
    help="Identify the physical model of a robot arm with elastic joints from its logs.",
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _option(name: str, *flags: str, **limits: Any) -> Any:
    """An option with the texts of `commands.toml` under its command and name."""
    command, _, option = name.partition(".")
    texts = command_texts()[command][option]
    shown = texts.get("default", True)
    return typer.Option(
        *flags, help=texts["help"], metavar=texts.get("metavar"), show_default=shown, **limits
    )


def _argument(name: str) -> Any:
    command, _, argument = name.partition(".")
    return typer.Argument(**command_texts()[command][argument])


Out = Annotated[Path, _option("shared.out")]
Quiet = Annotated[bool, _option("shared.quiet", "--quiet", "-q")]
StudyFile = Annotated[Path, _argument("shared.study")]
ResultFile = Annotated[Path, _argument("shared.result")]
ChangedStudy = Annotated[Path | None, _option("shared.changed-study")]
Figures = Annotated[bool, _option("shared.figures", "--figures")]
Stages = Annotated[str | None, _option("shared.stages")]
Overrides = Annotated[list[str] | None, _option("shared.set", "--set")]
Accepted = Annotated[list[str] | None, _option("shared.accept", "--accept")]
Seed = Annotated[int, _option("shared.seed")]

DONE, INPUT_AT_FAULT, NOT_DETERMINED, CHANGED = 0, 2, 3, 4

_prints_progress_as_json = ContextVar("prints_progress_as_json", default=False)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, _option("strainwave.version", "--version")] = False,
    progress_json: Annotated[bool, _option("strainwave.progress-json", "--progress-json")] = False,
) -> None:
    _prints_progress_as_json.set(progress_json)
    if version:
        typer.echo(f"strainwave {__version__}")
        raise typer.Exit


@app.command(epilog="Example: strainwave init --urdf robot.urdf run1.csv run2.csv --out study.toml")
def init(
    logs: Annotated[list[Path], _argument("init.logs")],
    out: Annotated[Path, _option("init.out")] = Path("study.toml"),
    urdf: Annotated[Path | None, _option("init.urdf")] = None,
    quiet: Quiet = False,
) -> None:
    """Write a draft of a study file from logs. Guesses have reasons; unknown values are TODO."""
    from strainwave.init import start_study

    with _progress(quiet) as report:
        report("inspecting the logs")
        draft = start_study(logs, out, urdf)
    if not quiet and draft.limit:
        typer.echo(f"limit: {draft.limit}")
    if not quiet:
        typer.echo(
            f"{draft.path}: {draft.joints} joint(s), {draft.experiments} record(s), "
            f"{len(draft.channels)} channel(s) guessed; {draft.n_todos} value(s) are TODO"
        )
        for guess in draft.guesses:
            certainty = "TODO" if guess.todo else guess.sure
            scale = "" if guess.scale in (1.0, None) else f" times {guess.scale:.6g}"
            text = shorten(
                f"{guess.column!r}{scale}: {guess.todo or guess.reason}", 100, placeholder=" ..."
            )
            typer.echo(f"  {guess.channel:12} {certainty:7} {text}")
        for todo in draft.todos:
            typer.echo(f"fill in: {todo}")
        if not draft.n_todos:
            typer.echo(_verdict_of_check(out))
        for warning in draft.warnings:
            typer.echo(f"warning: {warning}")


def _verdict_of_check(study: Path) -> str:
    """The verdict of the consistency check in one line; a draft with a fault remains a draft."""
    from strainwave import pipeline

    try:
        result = pipeline.check_input(study)
    except InvalidInput as error:
        return f"check: {error}"
    faults = ", ".join(f"{fault.code} at {fault.where}" for fault in result.suspected)
    return f"check: {result.status}" + (f": {faults}" if faults else "")


@app.command(epilog="Example: strainwave identify study.toml --out results")
def identify(
    study: StudyFile,
    out: Out,
    stages: Stages = None,
    options: Overrides = None,
    accept: Accepted = None,
    as_published: Annotated[bool, _option("identify.as-published", "--as-published")] = False,
    start: Annotated[Path | None, _option("identify.start")] = None,
    scheduler: Annotated[str | None, _option("identify.scheduler")] = None,
    figures: Figures = False,
    quiet: Quiet = False,
) -> None:
    """Identify an arm from its logs. Writes DIR/result.json and DIR/report.html.

    The exit code is 0 if the verdict is "determined", else 3.
    """
    from strainwave import pipeline
    from strainwave.io.study import AS_PUBLISHED
    from strainwave.report.matplotlib_backend import require_matplotlib

    if figures:
        require_matplotlib()  # before the long run
    chosen = pipeline.check_stages(stages or pipeline.STAGES)
    with _progress(quiet) as report:
        identification = pipeline.identify(
            study,
            stages=chosen,
            options=[
                *([AS_PUBLISHED] if as_published else ()),
                *(options or ()),
                *_accepted(accept),
            ]
            or None,
            start=start,
            progress=pipeline.with_output_loading(report),
            scheduler=scheduler,
        )
        pipeline.write(identification, out, figures=figures, progress=report)
    if not quiet:
        from strainwave.report.terminal import print_summary

        print_summary(identification, out, figures=figures)
    raise typer.Exit(identification.verdict.exit_code)


def _accepted(codes: list[str] | None) -> list[str]:
    """The codes of --accept as an option of the study."""
    return [f"accept={','.join(codes)}"] if codes else []


@app.command(epilog="Example: strainwave check study.toml")
def check(
    study: StudyFile,
    accept: Accepted = None,
    as_json: Annotated[bool, _option("check.as-json", "--json")] = False,
    quiet: Quiet = False,
) -> None:
    """Check whether logs and study agree. The exit code is 3 if a fault is suspected, else 0."""
    from strainwave import pipeline

    with _progress(quiet or as_json) as report:
        report("checking the input")
        result = pipeline.check_input(study, options=_accepted(accept) or None)
    if as_json:
        from strainwave.io.results import check_document, to_json

        typer.echo(to_json(check_document(result)), nl=False)  # UTF-8 on any console
    elif not quiet:
        from strainwave.report.terminal import print_check

        print_check(result)
    raise typer.Exit(result.exit_code)


@app.command(epilog="Example: strainwave simulate study.toml --parameters arm.json --out virtual")
def simulate(
    study: StudyFile,
    parameters: Annotated[Path, _option("simulate.parameters")],
    out: Out,
    seed: Seed = 0,
    ideal: Annotated[bool, _option("simulate.ideal", "--ideal")] = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a study on a virtual arm. Writes its logs and a study.toml."""
    from strainwave.virtual.experiments import simulate_study_file

    with _progress(quiet) as report:
        written = simulate_study_file(
            study, parameters, out, seed=seed, ideal=ideal, progress=report
        )
    if not quiet:
        typer.echo(f"{written} logs and study.toml are in {out}")


@app.command(epilog="Example: strainwave export results/result.json --out arm.xml")
def export(
    result: ResultFile,
    out: Annotated[Path, _option("export.out")],
    form: Annotated[str | None, _option("export.form", "--format")] = None,
    randomise: Annotated[int, _option("export.randomise")] = 0,
    seed: Annotated[int, _option("export.seed")] = 0,
    mujoco: Annotated[str | None, _option("export.mujoco")] = None,
    study: ChangedStudy = None,
    quiet: Quiet = False,
) -> None:
    """Export an arm to simulators, URDF, MATLAB, C or JSON."""
    from strainwave.export import export_file

    written = export_file(
        result, out, form=form, study=study, randomise=randomise, seed=seed, mujoco=mujoco
    )
    if not quiet:
        typer.echo(f"the arm is in {out}")
        if written.read_back:
            typer.echo(written.read_back.text)
        for warning in written.warnings:
            typer.echo(f"warning: {warning.where}: {warning.message}")
        for note in written.notes:
            typer.echo(f"note: {note}")
    for each in written.losses_of_version:
        message = f"MuJoCo {mujoco} lacks an element for {each.message}; give that version"
        typer.echo(f"strainwave: {each.where}: {message}", err=True)
    if written.losses_of_version:
        raise typer.Exit(3)


@app.command(
    epilog="Example: strainwave tune results/result.json --posture 0,1.2 --payload 2,0.1,0,0 "
    "--out tuned"
)
def tune(
    result: ResultFile,
    out: Out,
    posture: Annotated[list[str] | None, _option("tune.posture")] = None,
    payload: Annotated[list[str] | None, _option("tune.payload")] = None,
    draws: Annotated[int, _option("tune.draws")] = 1000,
    seed: Annotated[int, _option("tune.seed")] = 0,
    period: Annotated[float | None, _option("tune.period")] = None,
    delay: Annotated[float | None, _option("tune.delay")] = None,
    bandwidth: Annotated[float | None, _option("tune.bandwidth")] = None,
    gain_margin: Annotated[float, _option("tune.gain-margin")] = 6.0,
    phase_margin: Annotated[float, _option("tune.phase-margin")] = 30.0,
    modulus_margin: Annotated[float, _option("tune.modulus-margin")] = 0.5,
    study: ChangedStudy = None,
    quiet: Quiet = False,
) -> None:
    """Design the servos of an arm. Writes DIR/tune.html and servo.*, with input shapers."""
    from strainwave.export import arm_of
    from strainwave.io.results import read_document, result_path
    from strainwave.tune import PAGE, read_payloads, read_postures, tune_document
    from strainwave.tune.design import ServoOptions
    from strainwave.tune.margins import Requirements
    from strainwave.tune.report.words import print_design

    options = ServoOptions(
        postures=read_postures(posture or ()),
        payloads=read_payloads(payload or ()),
        draws=draws,
        seed=seed,
        period=period,
        delay=delay,
        bandwidth_hz=bandwidth,
        required=Requirements(gain_margin, phase_margin, modulus_margin),
    )
    with _progress(quiet) as report:
        path = result_path(result)
        document = read_document(path)
        design = tune_document(document, arm_of(document, path, study), options, out, report)
    if not quiet:
        print_design(design, out / PAGE)


@app.command(epilog="Example: strainwave payload results payload.toml --out load")
def payload(result: ResultFile, study: StudyFile, out: Out, quiet: Quiet = False) -> None:
    """Estimate the load that records of an identified arm carry. Writes DIR/payload.json."""
    from strainwave.export.payload import FILE_NAME, payload_document, payload_exports
    from strainwave.io.atomic_files import write_whole
    from strainwave.io.results import read_document, result_path, to_json
    from strainwave.io.study import read_study
    from strainwave.pipeline.payload import estimate_payload
    from strainwave.report.terminal import print_payload

    with _progress(quiet) as report:
        path = result_path(result)
        of_load = read_study(study, of_load=True)
        estimate = estimate_payload(read_document(path), path, of_load, progress=report)
        write_whole(out, {FILE_NAME: to_json(payload_document(estimate))})
    if not quiet:
        print_payload(estimate, payload_exports(estimate), out / FILE_NAME)


@app.command(
    epilog="Example: strainwave excite study.toml --parameters arm.json --out designed "
    "--limit-angle 1.2 --limit-velocity 180"
)
def excite(
    study: StudyFile,
    out: Out,
    limit_angle: Annotated[str | None, _option("excite.limit-angle")] = None,
    limit_velocity: Annotated[str | None, _option("excite.limit-velocity")] = None,
    parameters: Annotated[Path | None, _option("excite.parameters")] = None,
    limit_voltage: Annotated[str | None, _option("excite.limit-voltage")] = None,
    limit_torque: Annotated[str | None, _option("excite.limit-torque")] = None,
    limit_distance: Annotated[str | None, _option("excite.limit-distance")] = None,
    kind: Annotated[str, _option("excite.kind")] = "prbs",
    minutes: Annotated[float | None, _option("excite.minutes")] = None,
    seed: Annotated[int, _option("excite.seed")] = 0,
    quiet: Quiet = False,
) -> None:
    """Design the experiments to record. Writes signals, durations and the expected motion."""
    from strainwave import excite as design

    with _progress(quiet) as report:
        planned = design.excite_study_file(
            study,
            parameters,
            out,
            limit_angle=limit_angle,
            limit_velocity=limit_velocity,
            limit_voltage=limit_voltage,
            limit_torque=limit_torque,
            limit_distance=limit_distance,
            kind=kind,
            minutes=minutes,
            seed=seed,
            progress=report,
        )
    if not quiet:
        from strainwave.excite.files import print_design

        print_design(planned, out)


@app.command(
    epilog="Example: strainwave compare january/result.json june/result.json --out compared"
)
def compare(
    results: Annotated[list[Path], _argument("compare.results")],
    out: Annotated[Path | None, _option("compare.out")] = None,
    level: Annotated[float, _option("compare.level")] = 0.05,
    quiet: Quiet = False,
) -> None:
    """Compare results of one arm. The exit code is 0 if they agree and 4 if they differ."""
    from strainwave.fleet.monitoring import comparison, comparison_output

    result = comparison.compare(comparison.read_estimates(results), level)
    if out is not None:
        comparison_output.write(result, out)
    if not quiet:
        comparison.print_comparison(result, out)
    raise typer.Exit(CHANGED if result.differs else DONE)


@app.command(epilog="Example: strainwave trend store --arm 'fleet/([^/]+)/' --out trend")
def trend(
    store: Annotated[str, _argument("trend.store")],
    out: Annotated[Path | None, _option("trend.out")] = None,
    arm: Annotated[str | None, _option("trend.arm")] = None,
    covariates: Annotated[Path | None, _option("trend.covariates")] = None,
    level: Annotated[float, _option("trend.level")] = 0.01,
    quiet: Quiet = False,
) -> None:
    """Detect changes of arms over their visits. The exit code is 4 if an arm changes, else 0."""
    from strainwave.fleet.monitoring import trend as trends
    from strainwave.fleet.monitoring.visits import read_histories

    with _progress(quiet) as report:
        report("reading the store")
        histories = read_histories(store, arm=arm, covariates=covariates)
        report("testing for changes")
        result = trends.trend(histories, level)
        if out is not None:
            trends.write(result, out)
    if not quiet:
        trends.print_trend(result, out)
    raise typer.Exit(CHANGED if result.concern else DONE)


@app.command(epilog="Example: strainwave demo --out demo")
def demo(
    out: Out,
    seed: Seed = 0,
    arm: Annotated[Literal["soft", "stiff"], _option("demo.arm", "--arm")] = "soft",
    figures: Figures = False,
    quiet: Quiet = False,
) -> None:
    """Identify the built-in virtual arm. Compares the estimates with the true parameters."""
    from strainwave.report.matplotlib_backend import require_matplotlib
    from strainwave.report.terminal import print_summary
    from strainwave.virtual.experiments import demonstrate
    from strainwave.virtual.scara import ARMS

    if figures:
        require_matplotlib()
    with _progress(quiet) as report:
        identification, truth = demonstrate(
            out, seed=seed, progress=report, figures=figures, built_in=ARMS[arm]
        )
    if not quiet:
        print_summary(identification, out, truth=truth, figures=figures)
    raise typer.Exit(identification.verdict.exit_code)


@app.command(epilog="Example: strainwave campaign rigs/ --out store --workers 4")
def campaign(
    studies: Annotated[list[str], _argument("campaign.studies")],
    out: Annotated[str, _option("campaign.out")],
    stages: Stages = None,
    options: Overrides = None,
    workers: Annotated[int | None, _option("campaign.workers", min=1)] = None,
    scheduler: Annotated[str | None, _option("campaign.scheduler")] = None,
    cluster: Annotated[Path | None, _option("campaign.cluster")] = None,
    time_limit: Annotated[float, _option("campaign.time-limit", min=1.0)] = 600.0,
    memory_limit: Annotated[int | None, _option("campaign.memory-limit", min=1)] = None,
    retry_failed: Annotated[bool, _option("campaign.retry-failed", "--retry-failed")] = False,
    quiet: Annotated[bool, _option("campaign.quiet", "--quiet", "-q")] = False,
) -> None:
    """Identify many studies, on one machine or a cluster. Recorded runs are not repeated."""
    from strainwave import pipeline
    from strainwave.fleet import campaign as campaigns

    if scheduler is not None and cluster is not None:
        raise InvalidInput(
            "--scheduler and --cluster are given together",
            remedy="name a running scheduler, or a cluster to start",
        )
    settings = campaigns.Settings(
        store=out,
        stages=None if stages is None else pipeline.check_stages(stages),
        options=options or (),
        workers=workers,
        scheduler=scheduler,
        cluster=cluster,
        limits=campaigns.RunLimits(time_s=time_limit, memory_mib=memory_limit),
        retry_failed=retry_failed,
        display=not quiet and sys.stderr.isatty(),
    )
    summary = campaigns.run(studies, settings)
    typer.echo(summary.tally.line())
    if not quiet and summary.exit_code != DONE:
        for line in summary.undetermined:
            typer.echo(line)
    for message in (summary.ended_early, summary.unmerged):
        if message:
            print(f"strainwave: {message}.", file=sys.stderr)
    raise typer.Exit(summary.exit_code)


@app.command(epilog="Example: strainwave serve rigs")
def serve(
    folder: Annotated[Path, _argument("serve.folder")] = Path(),
    port: Annotated[int, _option("serve.port", min=0, max=65535)] = 8765,
    host: Annotated[str, _option("serve.host")] = "127.0.0.1",
    token_file: Annotated[Path | None, _option("serve.token-file")] = None,
    allow: Annotated[list[Path] | None, _option("serve.allow")] = None,
    max_upload: Annotated[int, _option("serve.max-upload", min=1)] = 2048,
) -> None:
    """Serve the workbench, the whole method in a browser. Ctrl-C ends it."""
    from strainwave.workbench.options import ServerOptions, token_from
    from strainwave.workbench.server import serve

    serve(ServerOptions(folder, host, port, token_from(token_file), max_upload, tuple(allow or ())))


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[object], None]]:
    """Show the current activity on one line of stderr, if stderr is a terminal or for programs."""
    if _prints_progress_as_json.get():
        yield _print_progress
        return
    if quiet or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield lambda text: status.update(f"{text} ...")


def _print_progress(activity: object) -> None:
    """Print an activity, and the completed share of the run where it is known."""
    line = {"activity": str(activity), "fraction": getattr(activity, "fraction", None)}
    print(json.dumps(line), file=sys.stderr, flush=True)


def main() -> None:
    """Run the command line; errors of the input are one sentence without traceback."""
    from strainwave.numerics.parallel import configure_process

    configure_process()
    try:
        app()
    except (InvalidInput, NotIdentifiable, NumericalFailure) as error:
        print(f"strainwave: {error}", file=sys.stderr)
        sys.exit(INPUT_AT_FAULT if isinstance(error, InvalidInput) else NOT_DETERMINED)
    except BrokenPipeError:  # stdout was closed, as in `strainwave ... | head`
        sys.stderr.close()
        sys.exit(DONE)
