"""Requests about runs, reports of runs in frames, and page "Files".

The page has what a run leaves to take away, and the script that repeats it.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import os
import re
import tempfile
from argparse import ArgumentError, ArgumentParser, Namespace
from collections.abc import AsyncIterator, Callable
from dataclasses import asdict
from functools import cache
from pathlib import Path
from urllib.parse import quote
from zipfile import ZIP_DEFLATED, ZipFile

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

from strainwave.commands import command_texts
from strainwave.errors import InvalidInput, entry_of
from strainwave.export import export_file
from strainwave.report.document.blocks import page_scripts
from strainwave.workbench.run_record import LOG, Kind, Run
from strainwave.workbench.runs import MAX_LISTED, RUN_FILES, Runs
from strainwave.workbench.security import report_policy
from strainwave.workbench.supervisor import runs_ahead
from strainwave.workbench.web import Body, Routes, message_of, page, study_of, text_of, workspace_of

routes = Routes()

_POLL = 0.15  # [s] between two looks at the log of a run
_MAX_FOLLOWED = 200  # runs of one stream
_MAX_LOG_BYTES = 1 << 20  # of the end of a log
_MAX_MESSAGE_BYTES = 1 << 13  # of the end of a log, in a table
_NO_MESSAGE = "It ended without a message: the system may have ended it for lack of memory."
_FLAG = re.compile(r"--([a-z][a-z-]*)")
REPORTS = ("report.html", "tune.html", "comparison.html")
"""What a run may leave to read."""
_MAX_ZIP = 4 << 30  # [bytes] of the files


def runs_of(request: Request) -> Runs:
    """The runs of the study in the address."""
    return Runs(study_of(request))


def describe(run: Run) -> dict[str, object]:
    """A run for the pages, with its duration so far [s] and its place in the queue."""
    ahead = runs_ahead(run.group) if run.state == "waiting" else None
    return {**asdict(run), "lines": run.lines, "seconds": run.seconds, "ahead": ahead}


@routes.get("/api/runs/{study:path}")
def list_runs(request: Request) -> object:
    """All runs of a study's folder."""
    return [describe(run) for run in runs_of(request).all()]


@routes.post("/api/cancel-run/{study:path}")
def cancel_run(request: Request, body: Body) -> object:
    """End a run."""
    return describe(runs_of(request).cancel(text_of(body, "name")))


@routes.post("/api/remove-runs/{study:path}")
def remove_runs(request: Request, body: Body) -> object:
    """Delete runs of any kind."""
    return _each(request, body, Runs.remove)


@routes.post("/api/tag-runs/{study:path}")
def tag_runs(request: Request, body: Body) -> object:
    """Set a tag of runs, or remove it."""
    tag, is_set = text_of(body, "tag").strip(), body.get("is_set") is not False
    return _each(request, body, lambda runs, name: runs.tag(name, tag, is_set=is_set))


def _each(request: Request, body: Body, change: Callable[[Runs, str], None]) -> object:
    """Change each of the runs named; those that cannot be changed give messages."""
    runs, names, errors = runs_of(request), body.get("names"), []
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InvalidInput("no runs are named", remedy="tick at least one run")
    for name in names[:MAX_LISTED]:
        try:
            change(runs, name)
        except (InvalidInput, OSError) as error:
            errors.append(message_of(request, error))
    if errors:
        raise InvalidInput(" ".join(errors).removesuffix("."))
    return {}


@routes.get("/api/run-log/{study:path}")
def show_log(request: Request) -> object:
    """Progress and messages of a run."""
    runs = runs_of(request)
    return _state(runs, runs.get(request.query_params.get("name", "")))


def _state(runs: Runs, run: Run) -> dict[str, object]:
    progress, messages = log_lines(runs.path(run.name), run.kind)
    return {"progress": progress[-1] if progress else None, "messages": messages[-40:]}


def log_lines(
    folder: Path, kind: Kind, max_bytes: int = _MAX_LOG_BYTES
) -> tuple[list[dict[str, object]], list[str]]:
    """Progress and messages of a run so far, in the end of its log of a number of bytes."""
    progress, messages = [], []
    for line in _end_of(folder / LOG, max_bytes).decode("utf-8", "replace").splitlines():
        try:
            entry = json.loads(line)
        except ValueError:
            entry = None
        if isinstance(entry, dict) and "activity" in entry:
            progress.append(entry)
        else:
            messages.append(_in_terms_of_the_page(line, kind))
    return progress, messages


def last_message(runs: Runs, run: Run) -> str:
    """Why a run failed."""
    if not run.commands:  # damaged
        return run.note
    messages = log_lines(runs.path(run.name), run.kind, _MAX_MESSAGE_BYTES)[1]
    return next((line for line in reversed(messages) if line.strip()), _NO_MESSAGE)


def _in_terms_of_the_page(line: str, kind: Kind) -> str:
    """A message that names a field of a form instead of an option of the command line."""

    def title(match: re.Match[str]) -> str:
        texts = command_texts().get(kind, {}).get(match[1], {})
        return str(texts.get("title", match[0]))

    line = line.removeprefix("strainwave: ").replace("--set ", "option ")
    return _FLAG.sub(title, line)


def _end_of(path: Path, max_bytes: int) -> bytes:
    """The end of a log of bounded size; nothing if it is missing, a link or no regular file."""
    if path.is_symlink() or not path.is_file():
        return b""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - max_bytes))
        return file.read(max_bytes)


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
    run = runs.listed(name)  # may be deleted in the meantime
    return run, json.dumps(describe(run) | (_state(runs, run) if run.commands else {}))


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
    "usd": "arm.usda",
    "sdf": "arm.sdf",
    "drake": "arm-drake.sdf",
    "simscape": "arm_simscape.m",
    "isaaclab": "isaaclab_actuators.py",
    "mjlab": "mjlab_actuators.py",
    "pace": "pace_actuators.py",
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


def arguments_of(run: Run) -> Namespace:
    """Arguments of the last command of a run, as `identify` has them; others are left out."""
    try:
        return _IDENTIFY.parse_known_args(run.commands[-1][1:] if run.commands else ())[0]
    except ArgumentError:  # written by hand
        return _IDENTIFY.parse_args(())


def python_script(run: Run) -> str:
    """A script that identifies the study again as a run did, in the run's folder.

    Empty for a run that identifies nothing.
    """
    if run.kind != "identify" or not run.commands:  # a damaged record has none
        return ""
    given = arguments_of(run)  # the script saves no figures
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
    """Runs, the newest first; one of them, by default the first, with its files and script."""
    runs = runs_of(request)
    listed = runs.all()[::-1]
    chosen = request.query_params.get("run") or (listed[0].name if listed else "")
    shown = [describe(run) for run in listed]
    for run, row in zip(listed, shown, strict=True):
        if run.name == chosen and run.commands:
            files = _files(runs.path(run.name))
            row["files"] = [{"name": k, "size": file.stat().st_size} for k, file in files.items()]
            row["script"] = python_script(run)
            row["has_result"] = "result.json" in files
    return shown


def _files(folder: Path) -> dict[str, Path]:
    """Files that the commands of a run wrote; a link could lead out of the served folder."""
    return {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.is_symlink() and path.name not in RUN_FILES
    }


@routes.post("/api/export/{study:path}")
def export(request: Request, body: Body) -> object:
    """Export the result of a run in one format."""
    runs, form = runs_of(request), text_of(body, "format")
    file = entry_of(EXPORT_FILES, form, "format", "")
    folder = runs.path(runs.get(text_of(body, "name")).name)
    target = folder / "exports" / file
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
    script = python_script(run)
    if not script:
        raise InvalidInput(f"the run {run.name!r} identifies nothing", remedy="choose another run")
    name = quote(f"{run.name}.py")  # of any letters
    headers = {"content-disposition": f"attachment; filename*=utf-8''{name}"}
    return PlainTextResponse(script, headers=headers)


@routes.page("/zip/{study:path}")
def download_zip(request: Request) -> Response:
    """All files of a run in one archive."""
    run = _run(request)
    files = _files(runs_of(request).path(run.name))
    size = sum(path.stat().st_size for path in files.values())
    if size > _MAX_ZIP:
        raise InvalidInput(f"the run has {size >> 20} MiB", remedy="copy its folder")
    handle, temporary = tempfile.mkstemp(suffix=".zip")
    name = Path(temporary)
    try:
        # without strict time stamps, since some are before 1980
        with (
            os.fdopen(handle, "wb") as file,
            ZipFile(file, "w", ZIP_DEFLATED, strict_timestamps=False) as archive,
        ):
            for key, path in files.items():
                archive.write(path, f"{run.name}/{key}")
    except OSError:  # no space; Windows deletes only closed files
        name.unlink()
        raise
    remove = BackgroundTask(name.unlink, missing_ok=True)
    return FileResponse(
        name, filename=f"{run.name}.zip", media_type="application/zip", background=remove
    )


def _run(request: Request) -> Run:
    return runs_of(request).get(request.query_params.get("run", ""))
