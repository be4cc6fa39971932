"""First page: the studies of the folder; and page "Import logs".

It uploads logs, and drafts a study file from them as `strainwave init` does.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from strainwave.errors import InvalidInput
from strainwave.init import start_study
from strainwave.io.logs.bags import BAG_SUFFIXES
from strainwave.io.logs.tables import TABLE_SUFFIXES
from strainwave.workbench.run_record import Run
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import (
    Body,
    Routes,
    json_response,
    message_of,
    page,
    text_of,
    workspace_of,
)
from strainwave.workbench.workspace import check_name, is_runs_folder, study_at

routes = Routes()

MARKS = {"determined": "good", "partly-determined": "doubt", "not-determined": "bad"}
"""Colour of the status of a result."""


@routes.page("/")
def show_home(request: Request) -> Response:
    """The studies of the folder."""
    rows = [_row(request, name) for name in workspace_of(request).studies()]
    return page(request, "home", "Studies", studies=rows)


def _row(request: Request, name: str) -> dict[str, Any]:
    """A study file: its arm, or its error, and the verdict of the latest finished run."""
    runs: list[Run] = []
    try:
        path = workspace_of(request).study(name)
        runs = Runs(path).all()
        study = study_at(path)
        arm = study.arm
        springs = ", ".join(dict.fromkeys(joint.spring for joint in arm.joints))
        plural = "s" if arm.n_joints > 1 else ""
        description = (
            f"{arm.kind.replace('-', ' ')}, {arm.n_joints} joint{plural} ({springs}),"
            f" {len(study.experiments)} records"
        )
        is_valid = True
    except InvalidInput as error:
        description, is_valid = message_of(request, error), False
    finished = [run for run in runs if run.kind == "identify" and run.state == "done"]
    status = (finished[-1].status or "no result") if finished else ""
    row = {"path": name, "description": description, "is_valid": is_valid, "runs": len(runs)}
    latest = finished[-1].ended if finished else None
    return row | {"status": status, "mark": MARKS.get(status, ""), "ended": (latest or "")[:10]}


LOG_SUFFIXES = (*TABLE_SUFFIXES, *BAG_SUFFIXES)
_ACCEPTED = (*LOG_SUFFIXES, ".urdf", ".yaml")  # .yaml: metadata of a bag


@routes.page("/import")
def _show_import(request: Request) -> Response:
    accepted = ", ".join(LOG_SUFFIXES)
    return page(request, "import", "Import logs", accepted=accepted, folders=_folders(request))


def _folders(request: Request) -> list[str]:
    """Folders with logs and without a study file."""
    root = workspace_of(request).folder
    folders = [path for path in root.iterdir() if path.is_dir() and not is_runs_folder(path.name)]
    return sorted(path.name for path in folders if not path.name.startswith(".") and _logs(path))


def _logs(folder: Path) -> list[str]:
    return sorted(
        path.name
        for path in folder.iterdir()
        if path.name.lower().endswith(LOG_SUFFIXES) or (path / "metadata.yaml").is_file()
    )


@routes.get("/api/logs")
def list_logs(request: Request) -> object:
    """Logs and URDF files of a folder."""
    folder = workspace_of(request).resolve(request.query_params.get("folder", ""))
    if not folder.is_dir():
        return {"logs": [], "urdfs": []}
    return {"logs": _logs(folder), "urdfs": sorted(path.name for path in folder.glob("*.urdf"))}


@routes.page("/api/upload/{folder}/{name}", method="PUT")
async def upload(request: Request) -> Response:
    """Store one file of a folder."""
    folder, name = request.path_params["folder"], request.path_params["name"]
    check_name(folder)
    if not name.lower().endswith(_ACCEPTED):
        raise InvalidInput(
            "has an unknown file type", where=name, remedy=f"choose {', '.join(_ACCEPTED)}"
        )
    path = await workspace_of(request).receive(folder, name, request.stream())
    size = (await run_in_threadpool(path.stat)).st_size
    return json_response({"name": name, "size": size})


@routes.post("/api/draft")
def draft(request: Request, body: Body) -> object:
    """Write a draft of the study file in a folder."""
    workspace, folder = workspace_of(request), text_of(body, "folder")
    check_name(folder)
    names, urdf = body.get("logs"), text_of(body, "urdf", "")
    if not isinstance(names, list) or not names:
        raise InvalidInput("no log is chosen", remedy="choose at least one log")
    logs = [workspace.resolve(f"{folder}/{name}") for name in names]
    target = workspace.resolve(f"{folder}/study.toml")
    robot = workspace.resolve(f"{folder}/{urdf}") if urdf else None
    summary = asdict(start_study(logs, target, robot))
    return summary | {"path": workspace.relative(target)}
