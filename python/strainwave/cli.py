"""The command line: arguments, progress, exit codes. No arithmetic.

Exit codes: 0 done; 1 a bug; 2 the input is at fault; 3 the data cannot answer the question; 4 what
was compared differs or changes; 130 the user stopped it by Ctrl-C.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from strainwave import __version__
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure

app = typer.Typer(
    name="strainwave",
    help="From the logs of a robot arm with elastic joints to a physical model you can trust.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Out = Annotated[Path, typer.Option("--out", help="Directory for the results.", metavar="DIR")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
StudyFile = Annotated[Path, typer.Argument(help="The study file.", metavar="STUDY.toml")]
Figures = Annotated[
    bool, typer.Option("--figures", help="Also every figure as SVG and PNG, in DIR/figures.")
]
Seed = Annotated[int, typer.Option("--seed", help="Seed of the sensors' noise and of the motions.")]

DONE, AT_FAULT, NOT_ANSWERED, CHANGED = 0, 2, 3, 4


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        typer.echo(f"strainwave {__version__}")
        raise typer.Exit


@app.command(
    short_help="Write a study file to complete from logs.",
    epilog="Example: strainwave init run1.csv run2.csv --out study.toml",
)
def init(
    logs: Annotated[
        list[Path], typer.Argument(help="Logs of one rig: files or bags.", metavar="LOG...")
    ],
    out: Annotated[
        Path, typer.Option("--out", help="The study file to write.", metavar="STUDY.toml")
    ] = Path("study.toml"),
    quiet: Quiet = False,
) -> None:
    """Look at logs and write a study file to complete: guesses with reasons, and what is TODO."""
    from strainwave.study_draft import start_study

    with _progress(quiet) as follow:
        follow("looking at the logs")
        started = start_study(logs, out)
    if not quiet:
        if started.limit:
            typer.echo(f"limit: {started.limit}")
        typer.echo(
            f"{started.path}: {started.joints} joint(s), {started.experiments} record(s), "
            f"{len(started.channels)} channel(s) guessed ({', '.join(started.channels)}); "
            f"{started.todos} value(s) are TODO"
        )
        for warning in started.warnings:
            typer.echo(f"warning: {warning}")


@app.command(
    short_help="Identify the arm: logs in, result and report out.",
    epilog="Example: strainwave identify study.toml --out results",
)
def identify(
    study: StudyFile,
    out: Out,
    stages: Annotated[
        str | None,
        typer.Option("--stages", help="Run only the first stages, for example: rigid."),
    ] = None,
    options: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="An option of a stage, over the study's: links.order=1, statespace.method=n4sid.",
            metavar="STAGE.KEY=VALUE",
        ),
    ] = None,
    figures: Figures = False,
    quiet: Quiet = False,
) -> None:
    """Identify the arm: logs in, DIR/result.json and DIR/report.html out."""
    from strainwave import pipeline
    from strainwave.presentation.matplotlib_backend import require_matplotlib

    if figures:
        require_matplotlib()  # before the work, not after it
    chosen = pipeline.STAGES if stages is None else tuple(s.strip() for s in stages.split(","))
    with _progress(quiet) as follow:
        identification = pipeline.identify(
            study,
            stages=chosen,
            options=options or None,
            progress=pipeline.with_report_loading(follow),
        )
        pipeline.write(identification, out, figures=figures, progress=follow)
    if not quiet:
        from strainwave.presentation.terminal import print_summary

        print_summary(identification, out, figures=figures)
    raise typer.Exit(identification.verdict.exit_code)


@app.command(
    short_help="Run a study's experiments on a virtual arm.",
    epilog="Example: strainwave simulate study.toml --parameters arm.json --out virtual",
)
def simulate(
    study: StudyFile,
    parameters: Annotated[
        Path,
        typer.Option("--parameters", help="A result.json, or a file like it.", metavar="P.json"),
    ],
    out: Out,
    seed: Seed = 0,
    ideal: Annotated[
        bool, typer.Option("--ideal", help="Sensors without noise, bias and rounding.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Run the study's experiments on a virtual arm: logs and a study.toml that identify reads."""
    from strainwave.virtual.experiments import simulate_study_file

    with _progress(quiet) as follow:
        written = simulate_study_file(
            study, parameters, out, seed=seed, ideal=ideal, progress=follow
        )
    if not quiet:
        typer.echo(f"{written} logs and study.toml are in {out}")


@app.command(
    short_help="Write the arm for MuJoCo, ROS, MATLAB or C.",
    epilog="Example: strainwave export results/result.json --out arm.xml",
)
def export(
    result: Annotated[
        Path, typer.Argument(help="A result.json, or a directory with one.", metavar="RESULT")
    ],
    out: Annotated[Path, typer.Option("--out", help="The file to write.", metavar="FILE")],
    form: Annotated[
        str | None,
        typer.Option(
            "--format",
            help="mjcf, urdf, state-space, matlab, c or json; without it, by FILE's ending.",
            metavar="FORMAT",
        ),
    ] = None,
    study: Annotated[
        Path | None,
        typer.Option(
            "--study", help="The study file, if not where the result says.", metavar="STUDY.toml"
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write the identified arm for MuJoCo, ROS, MATLAB, C or as plain numbers."""
    from strainwave.export import export_file

    written = export_file(result, out, form=form, study=study)
    if not quiet:
        typer.echo(f"the arm is in {out}")
        for warning in written.warnings:
            typer.echo(f"warning: {warning.where}: {warning.message}")
        for note in written.notes:
            typer.echo(f"note: {note}")


@app.command(
    short_help="Design the experiments to record.",
    epilog="Example: strainwave excite study.toml --parameters arm.json --out designed "
    "--limit-angle 1.2 --limit-velocity 180",
)
def excite(
    study: StudyFile,
    out: Out,
    limit_angle: Annotated[
        str, typer.Option("--limit-angle", help="Of the links, either side of zero [rad].")
    ],
    limit_velocity: Annotated[
        str, typer.Option("--limit-velocity", help="Of the motors [rad/s]; one per joint: 180,150.")
    ],
    parameters: Annotated[
        Path | None,
        typer.Option(
            "--parameters", help="A guess of the arm, or an earlier result.json.", metavar="P.json"
        ),
    ] = None,
    limit_voltage: Annotated[
        str | None,
        typer.Option("--limit-voltage", help="Of the drives [V]; the servo's limit without."),
    ] = None,
    limit_torque: Annotated[
        str | None,
        typer.Option("--limit-torque", help="Of the gears, at the link [N m]; none without."),
    ] = None,
    kind: Annotated[
        str, typer.Option("--kind", help="Of the voltages: prbs or multisine.")
    ] = "prbs",
    seed: Annotated[int, typer.Option("--seed", help="Seed of the search and of phases.")] = 0,
    quiet: Quiet = False,
) -> None:
    """Design the experiments to record: what to apply, for how long, and what the arm will do."""
    from strainwave import experiment_design as design

    with _progress(quiet) as follow:
        planned = design.excite_study_file(
            study,
            parameters,
            out,
            limit_angle=limit_angle,
            limit_velocity=limit_velocity,
            limit_voltage=limit_voltage,
            limit_torque=limit_torque,
            kind=kind,
            seed=seed,
            progress=follow,
        )
    if not quiet:
        from strainwave.experiment_design.summary import print_design

        print_design(planned, out)


@app.command(
    short_help="Compare results of one arm: what has changed?",
    epilog="Example: strainwave compare january/result.json june/result.json --out compared",
)
def compare(
    results: Annotated[
        list[Path],
        typer.Argument(
            help="Two or more result.json of one arm, or directories with one.", metavar="RESULT..."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="Directory for comparison.json and comparison.html.", metavar="DIR"
        ),
    ] = None,
    level: Annotated[
        float,
        typer.Option("--level", help="Probability of naming a difference where there is none."),
    ] = 0.05,
    quiet: Quiet = False,
) -> None:
    """Compare results of one arm; exit code 0 where they agree, 4 where they differ."""
    from strainwave.monitoring import comparison_output
    from strainwave.monitoring.comparison import compare as compare_results
    from strainwave.monitoring.estimates import read_estimates

    found = compare_results(read_estimates(results), level)
    if out is not None:
        comparison_output.write(found, out)
    if not quiet:
        comparison_output.print_comparison(found, out)
    raise typer.Exit(CHANGED if found.differs else DONE)


@app.command(
    short_help="Follow arms over their visits: does anything change?",
    epilog="Example: strainwave trend store --covariates visits.csv --out trend",
)
def trend(
    store: Annotated[str, typer.Argument(help="Of strainwave campaign.", metavar="STORE")],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Directory for trend.json and trend.html.", metavar="DIR"),
    ] = None,
    arm: Annotated[
        str | None,
        typer.Option(
            "--arm",
            help="What names an arm: a column of the runs, or an expression with a group, searched "
            "for in the study's path; its folder without.",
            metavar="COLUMN|REGEX",
        ),
    ] = None,
    covariates: Annotated[
        Path | None,
        typer.Option(
            "--covariates",
            help="A table with columns study, time and numbers to regress out.",
            metavar="FILE.csv",
        ),
    ] = None,
    level: Annotated[
        float, typer.Option("--level", help="Probability of a false alarm, per arm.")
    ] = 0.01,
    quiet: Quiet = False,
) -> None:
    """Follow arms over their visits; exit code 0 where none changes, 4 where one does."""
    from strainwave.monitoring import trend_output
    from strainwave.monitoring.trend import trend as trend_of
    from strainwave.monitoring.visits import read_histories

    with _progress(quiet) as follow:
        follow("reading the store")
        histories = read_histories(store, arm=arm, covariates=covariates)
        follow("looking for changes")
        found = trend_of(histories, level)
        if out is not None:
            trend_output.write(found, out)
    if not quiet:
        trend_output.print_trend(found, out)
    raise typer.Exit(CHANGED if found.concern else DONE)


@app.command(
    short_help="Identify the built-in arm, compare with the truth.",
    epilog="Example: strainwave demo --as-published --seeds 10 --out demo",
)
def demo(
    out: Out,
    seed: Seed = 0,
    quick: Annotated[
        bool, typer.Option("--quick", help="Leave out the comparisons with the published figures.")
    ] = False,
    seeds: Annotated[
        int,
        typer.Option("--seeds", min=1, help="Of how many seeds to compare the published figures."),
    ] = 1,
    as_published: Annotated[
        bool,
        typer.Option(
            "--as-published", help="Compare the published figures by the paper's settings as well."
        ),
    ] = False,
    figures: Figures = False,
    quiet: Quiet = False,
) -> None:
    """Simulate the built-in SCARA-type arm, identify it, and compare with the truth."""
    from strainwave.paper.run import write_comparisons
    from strainwave.presentation.matplotlib_backend import require_matplotlib
    from strainwave.presentation.terminal import print_comparisons, print_summary
    from strainwave.virtual.experiments import demonstrate

    if figures:
        require_matplotlib()
    with _progress(quiet) as follow:
        identification, truth = demonstrate(out, seed=seed, progress=follow, figures=figures)
    if not quiet:
        print_summary(identification, out, truth=truth, figures=figures)
    if not quick:
        with _progress(quiet) as follow:
            found = write_comparisons(
                identification,
                out,
                seed=seed,
                seeds=seeds,
                as_published=as_published,
                progress=follow,
            )
        if not quiet:
            print_comparisons(found, out)
    raise typer.Exit(identification.verdict.exit_code)


@app.command(
    short_help="Identify many studies, on one machine or a cluster.",
    epilog="Example: strainwave campaign rigs/ --out store --workers 4",
)
def campaign(
    studies: Annotated[
        list[str],
        typer.Argument(
            help="Study files, folders, globs, tables of paths, URLs, or one campaign.toml.",
            metavar="STUDIES...",
        ),
    ],
    out: Annotated[
        str, typer.Option("--out", help="The store: a folder, or a URL.", metavar="STORE")
    ],
    stages: Annotated[
        str | None,
        typer.Option("--stages", help="Run only the first stages, for example: rigid."),
    ] = None,
    options: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="An option of a stage, over the studies'.", metavar="STAGE.KEY=VALUE"
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", min=1, help="Studies at a time; one per core without."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler", help="Of a running Dask cluster: tcp://host:8786.", metavar="ADDRESS"
        ),
    ] = None,
    cluster: Annotated[
        Path | None,
        typer.Option(
            "--cluster", help="A Dask cluster to start: class, arguments, workers.", metavar="FILE"
        ),
    ] = None,
    time_limit: Annotated[
        float, typer.Option("--time-limit", min=1.0, help="Of one study [s].")
    ] = 600.0,
    memory_limit: Annotated[
        int | None, typer.Option("--memory-limit", min=1, help="Of one worker [MiB].")
    ] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Run again what is recorded as failed.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print one line at the end, and errors.")
    ] = False,
) -> None:
    """Identify many studies and record each run in STORE; what is recorded is not run again."""
    from strainwave import campaign as campaigns

    if scheduler is not None and cluster is not None:
        raise InvalidInput(
            "--scheduler and --cluster are given together",
            remedy="name a running scheduler, or a cluster to start",
        )
    settings = campaigns.Settings(
        store=out,
        stages=None if stages is None else [s.strip() for s in stages.split(",")],
        options=options or (),
        workers=workers,
        scheduler=scheduler,
        cluster=cluster,
        limits=campaigns.Limits(time_s=time_limit, memory_mib=memory_limit),
        retry_failed=retry_failed,
        display=not quiet and sys.stderr.isatty(),
    )
    summary = campaigns.run(studies, settings)
    typer.echo(summary.tally.line())
    if not quiet and summary.exit_code != DONE:
        for line in summary.tally.causes():
            typer.echo(line)
    for said in (summary.ended_early, summary.unmerged):
        if said:
            print(f"strainwave: {said}.", file=sys.stderr)
    raise typer.Exit(summary.exit_code)


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[object], None]]:
    """One line on stderr that says what is being done, where a person watches."""
    if quiet or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield lambda text: status.update(f"{text} ...")


def main() -> None:
    """Run the command line; the errors that a user can mend are one sentence, without traceback."""
    from strainwave.numerics.parallel import own_process

    own_process()
    try:
        app()
    except InvalidInput as error:
        print(f"strainwave: {error}", file=sys.stderr)
        sys.exit(AT_FAULT)
    except (NotIdentifiable, NumericalFailure) as error:
        print(f"strainwave: {error}", file=sys.stderr)
        sys.exit(NOT_ANSWERED)
    except BrokenPipeError:  # the reader of our output has gone, as in `strainwave ... | head`
        sys.stderr.close()
        sys.exit(DONE)
