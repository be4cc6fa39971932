"""Page "Virtual arm": record and identify a simulated arm whose parameters are known."""

from __future__ import annotations

import json
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response

from strainwave.domain import Study
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import write_whole
from strainwave.io.study import write_study
from strainwave.workbench.hand_simulation import parameter_document
from strainwave.workbench.pages.runs import describe
from strainwave.workbench.runs import Runs
from strainwave.workbench.virtual_rig import (
    SENSORS,
    SETTINGS,
    estimates_against_truth,
    virtual_rig,
)
from strainwave.workbench.web import (
    Body,
    get_json,
    get_page,
    page,
    post_json,
    study_of,
    workspace_of,
)

_RUN, _RIG, _TRUTH = "record-and-identify", "rig.toml", "truth.json"


def show_virtual(request: Request) -> Response:
    """The page."""
    return page(request, "virtual", "Virtual arm", settings=SETTINGS, sensors=SENSORS)


def record_and_identify(request: Request, body: Body) -> object:
    """Simulate the records of a virtual arm in a new folder, and identify it from them."""
    workspace = workspace_of(request)
    folder = _new_folder(workspace.folder)
    try:
        rig = virtual_rig(body, folder)
    except InvalidInput:
        folder.rmdir()
        raise
    runs = Runs(folder / "study.toml")
    run_folder = runs.prepare(_RUN)
    _write(rig.study, folder / "study.toml")
    _write(rig.study, run_folder / _RIG)
    truth = json.dumps(parameter_document(rig.values), indent=1)
    write_whole(run_folder, {_TRUTH: truth.encode()})
    simulate = ["simulate", _RIG, "--parameters", _TRUTH, "--out", "../.."]
    commands = [
        simulate if rig.has_noise else [*simulate, "--ideal"],
        ["identify", "../../study.toml", "--out", "."],
    ]
    run = runs.start(_RUN, "virtual", commands)
    return describe(run) | {"study": workspace.relative(folder / "study.toml")}


def _new_folder(parent: Path) -> Path:
    number = 1
    while True:
        folder = parent / f"virtual-{number}"
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
            continue
        return folder


def _write(study: Study, path: Path) -> None:
    write_study(study, path)


def show_result(request: Request) -> object:
    """Estimates, true values and verdict of a finished run."""
    path = study_of(request)
    folder = Runs(path).path(_RUN)
    result = folder / "result.json"
    if not result.is_file():
        raise InvalidInput("the run has no result", where=path.name)
    rows = estimates_against_truth(path, result, folder / _TRUTH)
    document = json.loads(result.read_bytes())
    return {"rows": rows, "status": document["status"], "run": _RUN}


ROUTES = (
    get_page("/virtual", show_virtual),
    post_json("/api/virtual", record_and_identify),
    get_json("/api/virtual/{study:path}", show_result),
)
