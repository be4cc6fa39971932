"""What repeats a run outside of the workbench: a Python script."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from strainwave.workbench.runs import Run

EXPORT_FILES = {
    "mjcf": "arm.xml",
    "urdf": "arm.urdf",
    "state-space": "arm-state-space.json",
    "matlab": "arm.m",
    "c": "arm.h",
    "json": "arm.json",
}
"""File of each format of `strainwave export`."""


def python_script(run: Run) -> str:
    """A script that identifies the study again as a run did, in the run's folder."""
    study, options = _arguments(run.commands[-1])
    keywords = [f"stages={options['--stages'][0].split(',')!r}"] if "--stages" in options else []
    if "--set" in options:
        keywords.append(f"options={options['--set']!r}")
    if "--start" in options:
        keywords.append(f"start={options['--start'][0]!r}")
    call = "".join(f"    {keyword},\n" for keyword in keywords)
    inner = f"\n    {study!r},\n{call}" if keywords else repr(study)
    return (
        f'"""Repeat the run {run.name}: start it in the folder of the run.\n\n'
        f'{chr(10).join(run.lines)}\n"""\n\n'
        "import strainwave as sw\n\n"
        f"result = sw.identify({inner})\n"
        "print(result)\n"
        'result.save("repeated.json")\n'
        'result.report("repeated.html")\n'
        'result.export("repeated.xml", format="mjcf")  # or urdf, state-space, matlab, c, json\n'
    )


def _arguments(command: Sequence[str]) -> tuple[str, dict[str, list[str]]]:
    """The study of an identify command, and the values of its options."""
    options: dict[str, list[str]] = {}
    positional = list[str]()
    for name, value in _pairs(command[1:]):
        if name:
            options.setdefault(name, []).append(value)
        else:
            positional.append(value)
    return Path(positional[0]).as_posix(), options


def _pairs(arguments: Sequence[str]) -> Iterator[tuple[str, str]]:
    """(option, value) of each argument; the option of a positional argument is empty."""
    waiting = ""
    for argument in arguments:
        if waiting:
            yield waiting, argument
            waiting = ""
        elif argument == "--figures":  # the script saves none
            continue
        elif argument.startswith("--"):
            waiting = argument
        else:
            yield "", argument
