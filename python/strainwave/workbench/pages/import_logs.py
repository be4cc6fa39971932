"""Page "Import logs": upload logs, and draft a study file from them as `strainwave init` does."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from strainwave.errors import InvalidInput
from strainwave.init import start_study
from strainwave.io.logs.bags import BAG_SUFFIXES
from strainwave.io.logs.tables import TABLE_SUFFIXES
from strainwave.workbench.web import (
    Body,
    Routes,
    json_response,
    page,
    text_of,
    workspace_of,
)
from strainwave.workbench.workspace import check_name, is_runs_folder

routes = Routes()

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
