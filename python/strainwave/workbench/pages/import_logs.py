"""Page "Import logs": store logs, and draft a study file from them as `strainwave init` does."""

from __future__ import annotations

from pathlib import Path

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from strainwave.errors import InvalidInput
from strainwave.init import draft_study
from strainwave.init.changes import changed_text
from strainwave.init.rig_values import is_study_of, rig_changes
from strainwave.io.atomic_files import write_whole
from strainwave.workbench.pages.overview import column_names
from strainwave.workbench.web import (
    Body,
    Routes,
    json_response,
    message_of,
    page,
    text_of,
    workspace_of,
)
from strainwave.workbench.workspace import (
    ACCEPTED,
    LOG_SUFFIXES,
    free_path,
    is_runs_folder,
)

routes = Routes()


@routes.page("/import")
def _show_import(request: Request) -> Response:
    """The page, with the folders that have logs and no study file."""
    root = workspace_of(request).folder
    paths = [path for path in root.iterdir() if path.is_dir() and not is_runs_folder(path.name)]
    folders = sorted(p.name for p in paths if p.name[0] != "." and not (p / "study.toml").exists())
    names = [name for name in folders if logs_in(root / name)]
    return page(request, "import", "Import logs", folders=names)


def logs_in(folder: Path) -> list[str]:
    """Names of the logs in a folder."""
    return sorted(
        path.name
        for path in folder.iterdir()
        if (path.name.lower().endswith(LOG_SUFFIXES) and path.name[0] != ".")
        or (path / "metadata.yaml").is_file()
    )


@routes.get("/api/logs")
def list_logs(request: Request) -> object:
    """Logs and URDF files of a folder."""
    folder = workspace_of(request).resolve(request.query_params.get("folder", ""))
    if not folder.is_dir():
        return {"logs": [], "urdfs": []}
    return {"logs": logs_in(folder), "urdfs": sorted(path.name for path in folder.glob("*.urdf"))}


@routes.get("/api/free-folder")
def free_folder(request: Request) -> object:
    """The name of a new folder: the wanted one, repaired where it is not allowed, or numbered."""
    workspace, query = workspace_of(request), request.query_params
    parent = workspace.resolve(query.get("parent", ""))
    return {"folder": workspace.relative(free_path(parent, query.get("name", "")))}


@routes.page("/api/upload", method="PUT")
async def upload(request: Request) -> Response:
    """Store one file of a folder."""
    folder, name = (request.query_params.get(key, "") for key in ("folder", "name"))
    if not name.lower().endswith(ACCEPTED):
        raise InvalidInput(
            "is no log: its file type is unknown",
            where=name,
            remedy="save it as CSV, Parquet, MAT, HDF5, NumPy, JSON or a bag",
        )
    try:
        path = await workspace_of(request).receive(folder, name, request.stream())
    except ClientDisconnect:  # cancelled
        return Response(status_code=499)
    size = (await run_in_threadpool(path.stat)).st_size
    return json_response({"name": path.name, "size": size})


@routes.post("/api/draft")
def draft(request: Request, body: Body) -> object:
    """Write a draft of the study file of a folder; return its path, and notes for the user.

    `values` is the text of another study file or a data sheet. If it names these logs, it is the
    study file; else the draft takes its values.
    """
    workspace, logs = workspace_of(request), body.get("logs")
    name, urdf, values = (text_of(body, key, "") for key in ("folder", "urdf", "values"))
    target = workspace.resolve(name) / "study.toml"
    if target.exists() or not target.parent.is_dir():
        problem = "has a study already" if target.exists() else "is no folder with logs"
        raise InvalidInput(problem, where=name, remedy="type another name")
    if not isinstance(logs, list) or not logs:
        raise InvalidInput("no log is chosen", remedy="choose at least one log")
    notes: list[str] = []
    if values and is_study_of(values, [path.name for path in target.parent.iterdir()]):
        text = values
    else:
        paths = [workspace.file_of(target, str(each)) for each in logs]
        robot = workspace.file_of(target, urdf) if urdf else None
        text, notes = _draft(request, paths, target, robot)
        if values:
            try:
                columns = {name for path in paths for name in column_names(path)}
                text = changed_text(text, rig_changes(text, values, columns, target), target)
            except InvalidInput as error:
                notes.append(f"The values are not taken: {message_of(request, error)}")
    write_whole(target.parent, {target.name: text.encode()})
    return {"path": workspace.relative(target), "notes": notes}


def _draft(
    request: Request, logs: list[Path], target: Path, urdf: Path | None
) -> tuple[str, list[str]]:
    """The text of a draft, and notes; logs that are not like the others are left out."""
    notes = list[str]()
    while True:
        try:
            drafted = draft_study(logs, target, urdf)
            return drafted.text, [*notes, *filter(None, [drafted.limit]), *drafted.warnings]
        except InvalidInput as error:
            where = f"{error.where}, "  # of a log, or of a row in it
            rest = [path for path in logs if not where.startswith(f"{path}, ")]
            if not rest or len(rest) == len(logs):
                raise
            notes.append(f"Left out: {message_of(request, error)}")
            logs = rest
