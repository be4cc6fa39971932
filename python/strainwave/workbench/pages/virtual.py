"""Page "Virtual arm": record and identify a simulated arm whose parameters are known."""

from __future__ import annotations

import shutil
from contextlib import suppress
from itertools import count

from starlette.requests import Request
from starlette.responses import Response

from strainwave.api import read_result
from strainwave.errors import InvalidInput
from strainwave.io.parameters import parameter_file, read_parameters
from strainwave.io.study import read_study, write_study
from strainwave.virtual.experiments import derived
from strainwave.virtual.settings import SENSORS, SETTINGS, errors_of, virtual_rig
from strainwave.workbench.pages.runs import describe, file_of_run
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import Body, Routes, page, study_of, workspace_of

routes = Routes()

_RUN, _RIG, _TRUTH = "record-and-identify", "rig.toml", "truth.json"


@routes.page("/virtual")
def _show_virtual(request: Request) -> Response:
    return page(request, "virtual", "Virtual arm", settings=SETTINGS, sensors=SENSORS)


@routes.post("/api/virtual")
def record_and_identify(request: Request, body: Body) -> object:
    """Simulate the records of a virtual arm in a new folder, and identify it from them."""
    workspace = workspace_of(request)
    for number in count(1):
        folder = workspace.folder / f"virtual-{number}"
        with suppress(FileExistsError):
            folder.mkdir()
            break
    try:
        rig = virtual_rig(body, folder)
        runs = Runs(folder / "study.toml")
        run_folder = runs.prepare(_RUN)
        write_study(rig.study, folder / "study.toml")
        write_study(rig.study, run_folder / _RIG)
        simulate = ["simulate", _RIG, "--parameters", _TRUTH, "--out", "../.."]
        commands = [
            simulate if rig.has_noise else [*simulate, "--ideal"],
            ["identify", "../../study.toml", "--out", "."],
        ]
        run = runs.start(_RUN, "virtual", commands, files={_TRUTH: parameter_file(rig.values)})
    except (InvalidInput, OSError):
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return describe(run) | {"study": workspace.relative(folder / "study.toml")}


@routes.get("/api/virtual/{study:path}")
def show_result(request: Request) -> object:
    """Estimates, true values and verdict of a finished run."""
    arm = read_study(study_of(request)).arm
    file, truth = (file_of_run(request, _RUN, name) for name in ("result.json", _TRUTH))
    result = read_result(file)
    rows = errors_of(result, derived(read_parameters(truth), arm))
    return {"rows": rows, "status": result.status, "run": _RUN}
