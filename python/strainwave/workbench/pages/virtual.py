"""Page "Virtual arm": record and identify a simulated arm whose parameters are known."""

from __future__ import annotations

import json
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response

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
from strainwave.workbench.web import Body, Routes, page, study_of, workspace_of

routes = Routes()

_RUN, _RIG, _TRUTH = "record-and-identify", "rig.toml", "truth.json"


@routes.page("/virtual")
def show_virtual(request: Request) -> Response:
    """The page."""
    return page(request, "virtual", "Virtual arm", settings=SETTINGS, sensors=SENSORS)


@routes.post("/api/virtual")
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
    write_study(rig.study, folder / "study.toml")
    write_study(rig.study, run_folder / _RIG)
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


@routes.get("/api/virtual/{study:path}")
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
