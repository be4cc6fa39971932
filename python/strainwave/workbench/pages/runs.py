"""Requests about runs, and reports of runs in frames."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
from collections.abc import AsyncIterator
from dataclasses import asdict
from functools import cache
from pathlib import Path

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, Response, StreamingResponse

from strainwave.errors import InvalidInput
from strainwave.presentation.report.blocks import page_scripts
from strainwave.workbench.runs import LOG, Run, Runs
from strainwave.workbench.security import report_policy
from strainwave.workbench.web import Body, Routes, study_of, text_of, workspace_of

routes = Routes()

_POLL = 0.15  # [s] between two looks at the log of a run


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
    runs, name = runs_of(request), request.query_params.get("name", "")
    progress, messages = log_lines(runs.path(runs.get(name).name))
    return {"progress": progress[-1] if progress else None, "messages": messages[-40:]}


def log_lines(folder: Path) -> tuple[list[dict[str, object]], list[str]]:
    """Progress and messages of a run so far."""
    progress, messages = [], []
    path = folder / LOG
    for line in path.read_text("utf-8", "replace").splitlines() if path.is_file() else ():
        try:
            entry = json.loads(line)
        except ValueError:
            entry = None
        if isinstance(entry, dict) and "activity" in entry:
            progress.append(entry)
        else:
            messages.append(line)
    return progress, messages


@routes.page("/api/run-events/{study:path}")
async def run_events(request: Request) -> Response:
    """Server-sent events of a run: its progress, then its end."""
    runs, name = await run_in_threadpool(runs_of, request), request.query_params.get("name", "")
    await run_in_threadpool(runs.get, name)

    async def events() -> AsyncIterator[str]:
        sent = ""
        while True:
            run = await run_in_threadpool(runs.get, name)
            progress, messages = await run_in_threadpool(log_lines, runs.path(name))
            last = progress[-1] if progress else None
            state = describe(run) | {"progress": last, "messages": messages[-40:]}
            text = json.dumps(state)
            if text != sent:
                yield f"data: {text}\n\n"
                sent = text
            if run.state != "running":
                return
            await asyncio.sleep(_POLL)

    return StreamingResponse(events(), media_type="text/event-stream")


@routes.page("/report/{study:path}")
def show_report(request: Request) -> Response:
    """An HTML file of a run for a frame, without access to the workbench."""
    name = request.query_params.get("file", "report.html")
    path = _file_of_run(request, name)
    if path.suffix != ".html":
        raise InvalidInput("is not a page", where=name)
    headers = {"content-security-policy": report_policy(_script_hashes())}
    return HTMLResponse(path.read_bytes(), headers=headers)


@routes.page("/download/{study:path}")
def download(request: Request) -> Response:
    """A file of a run to save."""
    path = _file_of_run(request, request.query_params.get("file", ""))
    return FileResponse(path, filename=path.name, media_type="application/octet-stream")


def _file_of_run(request: Request, name: str) -> Path:
    runs, run = runs_of(request), request.query_params.get("run", "")
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
