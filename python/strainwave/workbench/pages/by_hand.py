"""Page "By hand": sliders for every parameter over measured data."""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from strainwave.domain import Study
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import write_whole
from strainwave.io.parameters import read_parameters
from strainwave.io.results import response_of
from strainwave.presentation.figures.curves import Curve, bode
from strainwave.presentation.plotly_backend import plotly
from strainwave.signals.recorded_input import missing_motor_signal
from strainwave.workbench import hand_simulation as hand
from strainwave.workbench.cached_files import log_of, study_at
from strainwave.workbench.gate import require_open
from strainwave.workbench.pages.estimate import snapshot
from strainwave.workbench.pages.runs import describe
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import Body, Routes, page, study_of, text_of, workspace_of
from strainwave.workbench.workspace import check_name

routes = Routes()

_START = "start.json"
_MAX_DURATION = 20.0  # [s] of a window; longer ones take longer than a tenth of a second


@routes.page("/by-hand/{study:path}")
def show_by_hand(request: Request) -> Response:
    """The page."""
    path = study_of(request)
    study, workspace = study_at(path), workspace_of(request)
    arm = Arm.of(study.arm)
    records = [
        each
        for each in study.experiments
        if missing_motor_signal(arm, log_of(path, each.name)) is None
    ]
    starts = [
        workspace.relative(file)
        for files in (Runs(path).folder.glob("*/result.json"), path.parent.glob("*.json"))
        for file in sorted(files, key=lambda p: -p.stat().st_mtime)
    ]
    elastic = [i for i, joint in enumerate(study.arm.joints, start=1) if joint.elastic]
    return page(request, "by_hand", "By hand", records=records, starts=starts, joints=elastic)


@routes.post("/api/by-hand-begin/{study:path}")
def begin(request: Request, body: Body) -> object:
    """Sliders with the values of a file, and the channels of a record."""
    path = study_of(request)
    study, start = study_at(path), text_of(body, "start")
    log = log_of(path, text_of(body, "experiment"))
    values = read_parameters(workspace_of(request).resolve(start))
    rows = hand.sliders(study, values)
    shown = hand.simulate(
        path, log.name, _window(body, log), {(s.name, s.joint): s.value for s in rows}
    )
    return {
        "sliders": [asdict(row) for row in rows],
        "channels": list(shown.dataset.channel_names),
        "window": _window(body, log),
    }


@routes.post("/api/by-hand/{study:path}")
def update(request: Request, body: Body) -> object:
    """Simulated channels, residuals and Bode plot with the values of the sliders."""
    begin_time = time.perf_counter()
    path = study_of(request)
    study = study_at(path)
    values = hand.check_values(study, body.get("values"))
    log = log_of(path, text_of(body, "experiment"))
    shown = hand.simulate(path, log.name, _window(body, log), values)
    channels = body.get("channels")
    figure = hand.time_figure(study, shown, channels if isinstance(channels, list) else [])
    answer: dict[str, Any] = {
        "time": plotly(figure),
        "fits": shown.fit_percent,
        "bode": _bode(request, body, study, values),
    }
    return answer | {"milliseconds": 1e3 * (time.perf_counter() - begin_time)}


def _bode(request: Request, body: Body, study: Study, values: Values) -> dict[str, Any] | None:
    """Response of a joint with the values, and the measured one of the starting result."""
    joint = body.get("joint")
    if not isinstance(joint, int):
        return None
    try:
        curves = [Curve("sliders", *hand.joint_response(study, values, joint))]
    except InvalidInput:  # a joint of a coupled transmission has no model of its own
        return None
    measured = _measured(workspace_of(request).resolve(text_of(body, "start")), joint)
    return plotly(bode([*measured, *curves], f"Joint {joint}"))


def _measured(start: Path, joint: int) -> list[Curve]:
    if start.name != "result.json":
        return []
    response = response_of(json.loads(start.read_bytes()), joint)
    if response is None:
        return []
    return [Curve("measured", response.frequencies_hz, response.response[:, 0, 0], true=True)]


def _window(body: Body, log: Any) -> tuple[float, float]:
    """Window of the record, of a bounded duration."""
    begin_time = body.get("from")
    first, last = float(log.time[0]), float(log.time[-1])
    if not isinstance(begin_time, int | float) or not math.isfinite(begin_time):
        begin_time = first
    begin_time = min(max(float(begin_time), first), last)
    return begin_time, min(begin_time + _MAX_DURATION, last + log.sample_time)


@routes.post("/api/by-hand-save/{study:path}")
def save_values(request: Request, body: Body) -> object:
    """Write the values of the sliders to a parameter file next to the study."""
    path, name = study_of(request), text_of(body, "name")
    check_name(name)
    file = name if name.endswith(".json") else f"{name}.json"
    if (path.parent / file).exists():
        raise InvalidInput("exists already", where=file, remedy="choose another name")
    values = hand.check_values(study_at(path), body.get("values"))
    write_whole(path.parent, {file: _json(values)})
    return {"file": file}


@routes.post("/api/by-hand-fit/{study:path}")
def fit_from_here(request: Request, body: Body) -> object:
    """Start an identification whose whole-arm fit starts at the values of the sliders."""
    path = study_of(request)
    require_open(path)
    values = hand.check_values(study_at(path), body.get("values"))
    held = body.get("held", [])
    if not isinstance(held, list) or not all(isinstance(each, str) for each in held):
        raise InvalidInput("the request names no parameters to hold", where="held")
    runs = Runs(path)
    name = runs.free_name("identify")
    folder = runs.prepare(name)
    write_whole(folder, {"study.toml": snapshot(path).encode(), _START: _json(values)})
    command = ["identify", "study.toml", "--out", ".", "--start", _START]
    if held:
        command += ["--set", f"tuning.hold={json.dumps(held)}"]
    return describe(runs.start(name, "identify", [command], note="from sliders"))


def _json(values: Values) -> bytes:
    return json.dumps(hand.parameter_document(values), indent=1).encode()
