"""Page "Files": what a run leaves to take away, and the script that repeats it."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from starlette.background import BackgroundTask
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response

from strainwave.errors import InvalidInput
from strainwave.export import export_file
from strainwave.workbench.pages.runs import describe, runs_of
from strainwave.workbench.runs import RUN_FILES, Run
from strainwave.workbench.web import Body, Routes, message_of, page, study_of, text_of

routes = Routes()

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


_EXPORTS = "exports"
_MAX_ZIP = 4 << 30  # [bytes] of the files


@routes.page("/files/{study:path}")
def show_files(request: Request) -> Response:
    """The page."""
    study_of(request)
    return page(request, "files", "Files", formats=list(EXPORT_FILES))


@routes.get("/api/files/{study:path}")
def list_files(request: Request) -> object:
    """Runs with their files, command lines and scripts, the newest first."""
    runs = runs_of(request)
    shown = []
    for run in reversed(runs.all()):
        folder = runs.path(run.name)
        entries = [
            {"name": p.relative_to(folder).as_posix(), "size": p.stat().st_size}
            for p in _files(folder)
        ]
        script = python_script(run) if _is_repeatable(run) else ""
        is_result = (folder / "result.json").is_file()
        shown.append(describe(run) | {"files": entries, "script": script, "has_result": is_result})
    return shown


def _files(folder: Path) -> list[Path]:
    """Files that the commands of a run wrote; a link could lead out of the served folder."""
    return [
        path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.is_symlink() and path.name not in RUN_FILES
    ]


@routes.post("/api/export/{study:path}")
def export(request: Request, body: Body) -> object:
    """Export the result of a run in one format."""
    runs, form = runs_of(request), text_of(body, "format")
    if form not in EXPORT_FILES:
        formats = ", ".join(EXPORT_FILES)
        raise InvalidInput(f"there is no format {form!r}", remedy=f"choose from: {formats}")
    run = runs.get(text_of(body, "name"))
    folder = runs.path(run.name)
    (folder / _EXPORTS).mkdir(exist_ok=True)
    target = folder / _EXPORTS / EXPORT_FILES[form]
    written = export_file(folder / "result.json", target, form=form)
    warnings = [f"{w.where}: {w.message}" for w in written.warnings]
    return {
        "file": target.relative_to(folder).as_posix(),
        "messages": [message_of(request, text) for text in (*warnings, *written.notes)],
    }


@routes.page("/script/{study:path}")
def download_script(request: Request) -> Response:
    """The Python script that repeats a run."""
    run = _run(request)
    if not _is_repeatable(run):
        raise InvalidInput(f"the run {run.name!r} identifies nothing", remedy="choose another run")
    headers = {"content-disposition": f'attachment; filename="{run.name}.py"'}
    return PlainTextResponse(python_script(run), headers=headers)


def _is_repeatable(run: Run) -> bool:
    """Whether a script can repeat a run; a run with a damaged record has no commands."""
    return run.kind == "identify" and bool(run.commands)


@routes.page("/zip/{study:path}")
def download_zip(request: Request) -> Response:
    """All files of a run in one archive."""
    runs, run = runs_of(request), _run(request)
    folder = runs.path(run.name)
    files = _files(folder)
    size = sum(p.stat().st_size for p in files)
    if size > _MAX_ZIP:
        raise InvalidInput(f"the run has {size >> 20} MiB", remedy="copy its folder")
    with tempfile.NamedTemporaryFile(suffix=".zip", delete=False) as file:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in files:
                archive.write(path, f"{run.name}/{path.relative_to(folder).as_posix()}")
        name = Path(file.name)
    remove = BackgroundTask(name.unlink, missing_ok=True)
    return FileResponse(
        name, filename=f"{run.name}.zip", media_type="application/zip", background=remove
    )


def _run(request: Request) -> Run:
    return runs_of(request).get(request.query_params.get("run", ""))
