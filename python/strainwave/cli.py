"""The command line: arguments, progress, exit codes. No arithmetic.

Exit codes: 0 done; 1 a bug; 2 the input is at fault; 3 the data cannot answer the question.
"""

from __future__ import annotations

import os
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from strainwave import __version__
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure

DONE, AT_FAULT, NOT_ANSWERED, INTERRUPTED = 0, 2, 3, 130


def _init(given: Namespace) -> int:
    """Look at logs and write a study file to complete: guesses with reasons, and what is TODO."""
    from strainwave.starting import start_study

    with _progress(given.quiet) as tell:
        tell("looking at the logs")
        started = start_study(given.logs, given.out)
    if not given.quiet:
        print(
            f"{started.path}: {started.joints} joint(s), {started.experiments} record(s), "
            f"{len(started.channels)} channel(s) guessed ({', '.join(started.channels)}); "
            f"{started.todos} value(s) are TODO"
        )
    return DONE


def _identify(given: Namespace) -> int:
    """Identify the arm: logs in, DIR/result.json and DIR/report.html out."""
    from strainwave import pipeline
    from strainwave.cores import keep_memory
    from strainwave.drawing import require_matplotlib

    keep_memory()
    if given.figures:
        require_matplotlib()  # before the work, not after it
    stages = pipeline.STAGES
    if given.stages is not None:
        stages = tuple(stage.strip() for stage in given.stages.split(","))
    with _progress(given.quiet) as tell:
        identification = pipeline.identify(given.study, stages=stages, progress=tell)
        tell("writing the report")
        pipeline.write(identification, given.out, figures=given.figures)
    if not given.quiet:
        from strainwave.summary import print_summary

        print_summary(identification, given.out, figures=given.figures)
    return DONE if identification.determined else NOT_ANSWERED


def _simulate(given: Namespace) -> int:
    """Run the study's experiments on a virtual arm: logs and a study.toml that identify reads."""
    from strainwave import virtual

    with _progress(given.quiet) as tell:
        written = virtual.simulate_study_file(
            given.study,
            given.parameters,
            given.out,
            seed=given.seed,
            ideal=given.ideal,
            progress=tell,
        )
    if not given.quiet:
        print(f"{written} logs and study.toml are in {given.out}")
    return DONE


def _export(given: Namespace) -> int:
    """Write the identified arm for MuJoCo, ROS, MATLAB, C or as plain numbers."""
    from strainwave.export import export_file

    cautions = export_file(given.result, given.out, form=given.form, study=given.study)
    if not given.quiet:
        print(f"the arm is in {given.out}")
        for caution in cautions:
            print(f"warning: {caution.where}: {caution.message}")
    return DONE


def _excite(given: Namespace) -> int:
    """Design the experiments to record: what to apply, for how long, and what the arm will do."""
    from strainwave import design

    with _progress(given.quiet) as tell:
        planned = design.excite_study_file(
            given.study,
            given.parameters,
            given.out,
            limit_angle=given.limit_angle,
            limit_velocity=given.limit_velocity,
            limit_voltage=given.limit_voltage,
            limit_torque=given.limit_torque,
            kind=given.kind,
            seed=given.seed,
            progress=tell,
        )
    if not given.quiet:
        from strainwave.design.told import print_design

        print_design(planned, given.out)
    return DONE


def _demo(given: Namespace) -> int:
    """Simulate the built-in SCARA-type arm, identify it, and compare with the truth."""
    from strainwave import virtual
    from strainwave.drawing import require_matplotlib
    from strainwave.summary import print_comparisons, print_summary

    out, seed, figures = given.out, given.seed, given.figures
    if figures:
        require_matplotlib()
    with _progress(given.quiet) as tell:
        identification, truth = virtual.demonstrate(out, seed=seed, progress=tell, figures=figures)
    if not given.quiet:
        print_summary(identification, out, truth=truth, figures=figures)
    if not given.quick:
        with _progress(given.quiet) as tell:
            found = virtual.compare(identification, out, seed=seed, progress=tell)
        if not given.quiet:
            print_comparisons(found, out)
    return DONE if identification.determined else NOT_ANSWERED


class _Parser(ArgumentParser):
    """Says in one line what is wrong with the arguments."""

    def error(self, message: str) -> NoReturn:
        self.exit(AT_FAULT, f"{self.prog}: {message}; see {self.prog} --help\n")


def _parser() -> ArgumentParser:
    parser = _Parser(
        prog="strainwave",
        description="From the logs of a robot arm with elastic joints to a physical model you can"
        " trust.",
        allow_abbrev=False,
    )
    version = f"strainwave {__version__}"
    parser.add_argument("--version", action="version", version=version, help="Print the version.")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for work, said, example, arguments in _COMMANDS:
        name = work.__name__.removeprefix("_")
        command = commands.add_parser(
            name,
            help=said,
            description=work.__doc__,
            epilog=f"Example: strainwave {name} {example}",
            allow_abbrev=False,
        )
        command.set_defaults(work=work)
        for flag, options in (*arguments, _QUIET):
            command.add_argument(*flag.split(", "), **options)
    return parser


_Argument = tuple[str, dict[str, Any]]
"""Its name or flags, and what argparse is to know of it."""

_STUDY: _Argument = ("study", {"type": Path, "metavar": "STUDY.toml", "help": "The study file."})
_OUT: _Argument = (
    "--out",
    {"type": Path, "required": True, "metavar": "DIR", "help": "Directory for the results."},
)
_FIGURES: _Argument = (
    "--figures",
    {"action": "store_true", "help": "Also every figure as SVG and PNG, in DIR/figures."},
)
_QUIET: _Argument = ("-q, --quiet", {"action": "store_true", "help": "Print nothing but errors."})


def _seed(said: str) -> _Argument:
    return "--seed", {"type": int, "default": 0, "metavar": "N", "help": f"{said} (default: 0)."}


_COMMANDS: tuple[tuple[Callable[[Namespace], int], str, str, tuple[_Argument, ...]], ...] = (
    (
        _init,
        "Write a study file to complete from logs.",
        "run1.csv run2.csv --out study.toml",
        (
            (
                "logs",
                {
                    "type": Path,
                    "nargs": "+",
                    "metavar": "LOG",
                    "help": "Logs of one rig: files or bags.",
                },
            ),
            (
                "--out",
                {
                    "type": Path,
                    "default": Path("study.toml"),
                    "metavar": "STUDY.toml",
                    "help": "The study file to write (default: study.toml).",
                },
            ),
        ),
    ),
    (
        _identify,
        "Identify the arm: logs in, result and report out.",
        "study.toml --out results",
        (
            _STUDY,
            _OUT,
            ("--stages", {"help": "Run only the first stages, for example: rigid."}),
            _FIGURES,
        ),
    ),
    (
        _simulate,
        "Run a study's experiments on a virtual arm.",
        "study.toml --parameters arm.json --out virtual",
        (
            _STUDY,
            (
                "--parameters",
                {
                    "type": Path,
                    "required": True,
                    "metavar": "P.json",
                    "help": "A result.json, or a file like it.",
                },
            ),
            _OUT,
            _seed("Seed of the sensors' noise and of the motions"),
            (
                "--ideal",
                {"action": "store_true", "help": "Sensors without noise, bias and rounding."},
            ),
        ),
    ),
    (
        _export,
        "Write the arm for MuJoCo, ROS, MATLAB or C.",
        "results/result.json --out arm.xml",
        (
            (
                "result",
                {"type": Path, "metavar": "RESULT.json", "help": "A result.json of identify."},
            ),
            (
                "--out",
                {"type": Path, "required": True, "metavar": "FILE", "help": "The file to write."},
            ),
            (
                "--format",
                {
                    "dest": "form",
                    "help": "mjcf, urdf, state-space, matlab, c or json; without it, by FILE's"
                    " ending.",
                },
            ),
            (
                "--study",
                {
                    "type": Path,
                    "metavar": "STUDY.toml",
                    "help": "The study file, if not where the result says.",
                },
            ),
        ),
    ),
    (
        _excite,
        "Design the experiments to record.",
        "study.toml --parameters arm.json --out designed --limit-angle 1.2 --limit-velocity 180",
        (
            _STUDY,
            _OUT,
            (
                "--limit-angle",
                {"required": True, "help": "Of the links, either side of zero [rad]."},
            ),
            (
                "--limit-velocity",
                {"required": True, "help": "Of the motors [rad/s]; one a joint: 180,150."},
            ),
            (
                "--parameters",
                {
                    "type": Path,
                    "metavar": "P.json",
                    "help": "A guess of the arm, or an earlier result.json.",
                },
            ),
            ("--limit-voltage", {"help": "Of the drives [V]; the servo's limit without."}),
            ("--limit-torque", {"help": "Of the gears, at the link [N m]; none without."}),
            (
                "--kind",
                {"default": "prbs", "help": "Of the voltages: prbs (the default) or multisine."},
            ),
            _seed("Seed of the search and of phases"),
        ),
    ),
    (
        _demo,
        "Identify the built-in arm, compare with the truth.",
        "--out demo",
        (
            _OUT,
            _seed("Seed of the sensors' noise and of the motions"),
            (
                "--quick",
                {
                    "action": "store_true",
                    "help": "Leave out the comparisons with the published figures.",
                },
            ),
            _FIGURES,
        ),
    ),
)


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[str], None]]:
    """One line on stderr that says what is being done, where a person watches."""
    if quiet or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield lambda text: status.update(f"{text} ...")


def run(arguments: Sequence[str]) -> int:
    """Do one command.

    Parameters
    ----------
    arguments : sequence of str
        As given behind the program's name; without any, the help is shown.

    Returns
    -------
    int
        The exit code.

    Raises
    ------
    InvalidInput, NotIdentifiable, NumericalFailure
    SystemExit
        The arguments are at fault, or ask for help.
    """
    parser = _parser()
    if not arguments:
        parser.print_help()
        return AT_FAULT
    given = parser.parse_args(arguments)
    code: int = given.work(given)
    return code


def main() -> None:
    """Run the command line; the errors that a user can mend are one sentence, without traceback."""
    try:
        code = run(sys.argv[1:])
        sys.stdout.flush()
    except InvalidInput as error:
        print(f"strainwave: {error}", file=sys.stderr)
        code = AT_FAULT
    except (NotIdentifiable, NumericalFailure) as error:
        print(f"strainwave: {error}", file=sys.stderr)
        code = NOT_ANSWERED
    except KeyboardInterrupt:
        print("strainwave: interrupted", file=sys.stderr)
        code = INTERRUPTED
    except BrokenPipeError:  # the reader of our output has gone, as in `strainwave ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = DONE
    sys.exit(code)
