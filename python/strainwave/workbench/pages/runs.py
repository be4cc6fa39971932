"""Requests about runs, reports of runs in frames, and page "Files".

The page has what a run leaves to take away, and the script that repeats it.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import tempfile
import zipfile
from argparse import ArgumentParser
from collections.abc import AsyncIterator
from dataclasses import asdict
from functools import cache
from pathlib import Path

from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import (
    FileResponse,
    HTMLResponse,
    PlainTextResponse,
    Response,
    StreamingResponse,
)

from strainwave.errors import InvalidInput
from strainwave.export import export_file
from strainwave.report.document.blocks import page_scripts
from strainwave.workbench.run_record import LOG, Run
from strainwave.workbench.runs import RUN_FILES, Runs
from strainwave.workbench.security import report_policy
from strainwave.workbench.web import Body, Routes, message_of, page, study_of, text_of, workspace_of

routes = Routes()

_POLL = 0.15  # [s] between two looks at the log of a run
_MAX_FOLLOWED = 200  # runs of one stream
_MAX_LOG_BYTES = 1 << 20  # of the end of a log
_EXPORTS = "exports"
_MAX_ZIP = 4 << 30  # [bytes] of the files


def runs_of(request: Request) -> Runs:
    """The runs of the study in the address."""
    return Runs(study_of(request))


def describe(run: Run) -> dict[str, object]:
    """A run for the pages."""
    return {**asdict(run), "lines": run.lines}


@routes.get("/api/runs/{study:path}")
def list_runs(request: Request) -> object:
    """All runs of a study's folder."""
    return [describe(run) for run in runs_of(request).all()]


@routes.post("/api/cancel-run/{study:path}")
def cancel_run(request: Request, body: Body) -> object:
    """End a run."""
    return describe(runs_of(request).cancel(text_of(body, "name")))


@routes.post("/api/remove-run/{study:path}")
def remove_run(request: Request, body: Body) -> object:
    """Delete a run."""
    runs_of(request).remove(text_of(body, "name"))
    return {}


@routes.get("/api/run-log/{study:path}")
def show_log(request: Request) -> object:
    """Progress and messages of a run."""
    runs = runs_of(request)
    return _state(runs, runs.get(request.query_params.get("name", "")))


def _state(runs: Runs, run: Run) -> dict[str, object]:
    progress, messages = log_lines(runs.path(run.name))
    return {"progress": progress[-1] if progress else None, "messages": messages[-40:]}


def log_lines(folder: Path) -> tuple[list[dict[str, object]], list[str]]:
    """Progress and messages of a run so far."""
    progress, messages = [], []
    for line in _end_of(folder / LOG).decode("utf-8", "replace").splitlines():
        try:
            entry = json.loads(line)
        except ValueError:
            entry = None
        if isinstance(entry, dict) and "activity" in entry:
            progress.append(entry)
        else:
            messages.append(line)
    return progress, messages


def _end_of(path: Path) -> bytes:
    """The end of a log of bounded size; nothing if it is missing, a link or no regular file."""
    if path.is_symlink() or not path.is_file():
        return b""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _MAX_LOG_BYTES))
        return file.read(_MAX_LOG_BYTES)


@routes.page("/api/run-events/{study:path}")
async def run_events(request: Request) -> Response:
    """Server-sent events of runs: their progress, then their ends."""
    runs = await run_in_threadpool(runs_of, request)
    sent = dict.fromkeys(request.query_params.getlist("name")[:_MAX_FOLLOWED], "")
    await run_in_threadpool(lambda: [runs.get(name) for name in sent])

    async def events() -> AsyncIterator[str]:
        while sent:
            for name in list(sent):
                run, text = await run_in_threadpool(_event, runs, name)
                if text != sent[name]:
                    yield f"data: {text}\n\n"
                    sent[name] = text
                if not run.is_active:
                    del sent[name]
            await asyncio.sleep(_POLL)

    return StreamingResponse(events(), media_type="text/event-stream")


def _event(runs: Runs, name: str) -> tuple[Run, str]:
    try:
        run = runs.get(name)
        return run, json.dumps(describe(run) | _state(runs, run))
    except InvalidInput as error:  # deleted in the meantime
        run = Run.damaged(name, str(error))
        return run, json.dumps(describe(run))


@routes.page("/report/{study:path}")
def show_report(request: Request) -> Response:
    """An HTML file of a run for a frame, without access to the workbench."""
    name = request.query_params.get("file", "report.html")
    path = file_of_run(request, request.query_params.get("run", ""), name)
    if path.suffix != ".html":
        raise InvalidInput("is not a page", where=name)
    headers = {"content-security-policy": report_policy(_script_hashes())}
    return HTMLResponse(path.read_bytes(), headers=headers)


@routes.page("/download/{study:path}")
def download(request: Request) -> Response:
    """A file of a run to save."""
    query = request.query_params
    path = file_of_run(request, query.get("run", ""), query.get("file", ""))
    return FileResponse(path, filename=path.name, media_type="application/octet-stream")


def file_of_run(request: Request, run: str, name: str) -> Path:
    """The path of a file of a run; raises InvalidInput if there is none, or if it is a link."""
    runs = runs_of(request)
    workspace = workspace_of(request)
    path = workspace.resolve(workspace.relative(runs.path(run)) + f"/{name}")
    if not path.is_relative_to(runs.path(run)) or not path.is_file():
        raise InvalidInput(f"the run {run!r} has no file {name!r}")
    return path


@cache
def _script_hashes() -> tuple[str, ...]:
    """Hashes of the scripts of a report of this version."""
    return tuple(
        f"sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}"
        for script in page_scripts()
    )


EXPORT_FILES = {
    "mjcf": "arm.xml",
    "urdf": "arm.urdf",
    "state-space": "arm-state-space.json",
    "matlab": "arm.m",
    "c": "arm.h",
    "json": "arm.json",
}
"""File of each format of `strainwave export`."""


_IDENTIFY = ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
_IDENTIFY.add_argument("study", nargs="?", default="study.toml")
_IDENTIFY.add_argument("--set", action="append")
for _option in ("--stages", "--start", "--out"):
    _IDENTIFY.add_argument(_option)


def python_script(run: Run) -> str:
    """A script that identifies the study again as a run did, in the run's folder."""
    given, _ = _IDENTIFY.parse_known_args(run.commands[-1][1:])  # the script saves no figures
    study = Path(given.study).as_posix()
    keywords = [f"stages={given.stages.split(',')!r}"] if given.stages else []
    keywords += [f"options={given.set!r}"] if given.set else []
    keywords += [f"start={given.start!r}"] if given.start else []
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


@routes.page("/files/{study:path}")
def _show_files(request: Request) -> Response:
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
    size = sum(path.stat().st_size for path in files)
    if size > _MAX_ZIP:
        raise InvalidInput(f"the run has {size >> 20} MiB", remedy="copy its folder")
    with tempfile.NamedTemporaryFile(suffix=".zip", delete=False) as file:
        name = Path(file.name)
        try:
            with zipfile.ZipFile(
                file,
                "w",
                zipfile.ZIP_DEFLATED,
                strict_timestamps=False,  # a file of before 1980
            ) as archive:
                for path in files:
                    archive.write(path, f"{run.name}/{path.relative_to(folder).as_posix()}")
        except OSError:  # no space
            name.unlink()
            raise
    remove = BackgroundTask(name.unlink, missing_ok=True)
    return FileResponse(
        name, filename=f"{run.name}.zip", media_type="application/zip", background=remove
    )


def _run(request: Request) -> Run:
    return runs_of(request).get(request.query_params.get("run", ""))
