"""Page "Design": experiments to record, and servos, by `excite` and `tune`."""

from __future__ import annotations

from typing import Any, Literal, get_args

from starlette.requests import Request
from starlette.responses import Response

from strainwave.commands import command_texts
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import read_json
from strainwave.io.kept_files import study_at
from strainwave.io.logs.tables import open_table
from strainwave.io.system import relative_path
from strainwave.report.figures import Axis, Figure, line_panel
from strainwave.report.plotly_backend import plotly
from strainwave.workbench.pages.runs import describe, file_of_run, log_lines
from strainwave.workbench.run_record import Run
from strainwave.workbench.runs import RUN_FILES, Runs
from strainwave.workbench.web import Body, Routes, page, study_of, text_of, workspace_of

routes = Routes()

Command = Literal["excite", "tune"]
COMMANDS: tuple[Command, ...] = get_args(Command)


def options_of(command: Command) -> dict[str, dict[str, Any]]:
    """Texts of the options of a command that the form has, by flag."""
    return {flag: texts for flag, texts in command_texts()[command].items() if "title" in texts}


@routes.page("/design/{study:path}")
def _show_design(request: Request) -> Response:
    path = study_of(request)
    workspace = workspace_of(request)
    results = [workspace.relative(p) for p in workspace.results_of(path)]
    options = {command: options_of(command) for command in COMMANDS}
    return page(request, "design", "Design", options=options, results=results)


@routes.post("/api/design/{study:path}")
def start(request: Request, body: Body) -> object:
    """Start `excite` or `tune` with the values of the form."""
    path, command = study_of(request), body.get("kind")
    if command not in COMMANDS:
        raise InvalidInput("the request has no kind", where="kind")
    chosen = text_of(body, "parameters", "")
    source = workspace_of(request).resolve(chosen) if chosen else None
    flags = option_flags(command, body.get("options"))
    study_at(path)
    if source is None:
        raise InvalidInput("a design needs parameters", remedy="choose a finished run")
    runs = Runs(path)
    name = runs.free_name(command)
    folder = runs.prepare(name)
    given = relative_path(source, folder)
    if command == "excite":
        flags.insert(0, f"--parameters={given}")
        given = f"../../{path.name}"
    return describe(runs.start(name, command, [[command, given, "--out", ".", *flags]]))


def option_flags(command: Command, values: object) -> list[str]:
    """Arguments of a command line; a value cannot become a flag of its own.

    Raises InvalidInput for an unknown option or a value that is no text.
    """
    flags, known = [], options_of(command)
    for name, value in (values if isinstance(values, dict) else {}).items():
        if name not in known or not isinstance(value, str):
            raise InvalidInput(f"there is no option {name!r}", where="options")
        parts = value.split(";") if known[name].get("repeated") else [value]
        flags += [f"--{name}={part.strip().replace(' ', '')}" for part in parts if part.strip()]
    return flags


@routes.get("/api/designs/{study:path}")
def list_designs(request: Request) -> object:
    """Designs of the study, the newest first."""
    runs = Runs(study_of(request))
    designs = [run for run in runs.all() if run.kind in COMMANDS]
    return [_shown(runs, run) for run in reversed(designs)]


def _shown(runs: Runs, run: Run) -> dict[str, Any]:
    folder = runs.path(run.name)
    files = sorted(p.name for p in folder.iterdir() if p.is_file() and p.name not in RUN_FILES)
    return describe(run) | {"files": files, "messages": log_lines(folder, run.kind, 1 << 13)[1]}


@routes.get("/api/plan/{study:path}")
def show_plan(request: Request) -> object:
    """Commands of one planned record over time."""
    query = request.query_params
    table = open_table(file_of_run(request, query.get("run", ""), query.get("file", "")))
    columns = table.read(table.names)
    time, *names = columns
    panels = (line_panel(name, columns[time], columns[name], name) for name in names)
    return plotly(Figure(Axis(time), tuple(panels)))


@routes.get("/api/precision/{study:path}")
def show_precision(request: Request) -> object:
    """Predicted intervals of a plan."""
    file = file_of_run(request, request.query_params.get("run", ""), "predicted.json")
    document = read_json(file, "the prediction", "plan the records again")
    try:
        return [entry for entry in document["parameters"] if entry["value"] is not None]
    except (KeyError, TypeError) as error:
        raise InvalidInput("is no prediction", where=str(file)) from error
