"""Page "Signals": every signal over time, spectra, marks, windows."""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from strainwave import pipeline
from strainwave.domain import Log, Study
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.presentation.plotly_backend import plotly
from strainwave.presentation.report import torques
from strainwave.workbench.cached_files import fingerprint, log_of, study_at
from strainwave.workbench.signal_views import (
    coherence_figure,
    marks_of,
    sequences_of,
    spectrum_figure,
    time_figure,
)
from strainwave.workbench.study_edit import Change, edit_study
from strainwave.workbench.web import Body, Routes, page, study_of, text_of

routes = Routes()

_POINTS = (200, 6000)  # smallest and largest number of points of a line


@routes.page("/signals/{study:path}")
def show_signals(request: Request) -> Response:
    """The page."""
    study = study_at(study_of(request))
    return page(request, "signals", "Signals", experiments=study.experiments)


@routes.get("/api/record/{study:path}")
def describe_record(request: Request) -> object:
    """Channels, window, marks and detected sequences of a record."""
    path, study, log = _record(request)
    experiment = next(e for e in study.experiments if e.name == log.name)
    return {
        "channels": list(log.channels),
        "samples": len(log),
        "sample_time": log.sample_time,
        "start": float(log.time[0]),
        "stop": float(log.time[-1]),
        "window": [experiment.start, experiment.stop],
        "use": experiment.use,
        "joint": experiment.joint,
        "marks": [asdict(mark) for mark in marks_of(log, Arm.of(study.arm))],
        "sequences": sequences_of(log),
        "file": str(study.log_path(experiment).relative_to(path.parent)),
    }


@routes.get("/api/signal-time/{study:path}")
def show_time(request: Request) -> object:
    """Channels over a span of time."""
    _, study, log = _record(request)
    query = request.query_params
    low = _number(query.get("from"), float(log.time[0]))
    high = _number(query.get("to"), float(log.time[-1]))
    if not low < high:
        raise InvalidInput("the time span is empty", where="from, to")
    points = int(min(max(_number(query.get("points"), 1200.0), _POINTS[0]), _POINTS[1]))
    names = query.get("channels", "").split(",")
    return plotly(time_figure(log, study.arm, names, (low, high), points))


@routes.get("/api/signal-spectra/{study:path}")
def show_spectra(request: Request) -> object:
    """Spectra of channels, and the coherence of inputs and motor velocities."""
    _, study, log = _record(request)
    names = request.query_params.get("channels", "").split(",")
    spectra = spectrum_figure(log, study.arm, names)
    return {
        "spectra": plotly(spectra),
        "coherence": plotly(coherence_figure(log, study.arm.n_joints)),
    }


@routes.get("/api/joint-spectrum/{study:path}")
def show_joint_spectrum(request: Request) -> object:
    """Spectra of motor torque and interaction torque, the two inputs of a joint."""
    path = study_of(request)
    name = request.query_params.get("experiment", "")
    shown = {one["experiment"]: one for one in _joint_spectra(path, fingerprint(path))}
    if name not in shown:
        raise NotIdentifiable(f"the record {name!r} excites no joint with an interaction torque")
    return shown[name]


@lru_cache(maxsize=8)
def _joint_spectra(path: Path, _fingerprint: str) -> list[dict[str, Any]]:
    """Of every record, from the stages rigid and decoupled."""
    result = pipeline.identify(study_at(path), stages=("rigid", "decoupled"))
    return [
        {
            "experiment": record.signals.experiment.name,
            "text": torques.describe(record.signals),
            "checks": [
                {"passed": check.passed, "message": check.message}
                for check in record.signals.checks
            ],
            "figure": plotly(torques.spectrum_figure(record.signals)),
        }
        for record in result.records
        if record.signals.inputs.shape[1] == 2
    ]


@routes.post("/api/window/{study:path}")
def set_window(request: Request, body: Body) -> object:
    """Write the window of a record to the study file; null removes an end."""
    path, name = study_of(request), text_of(body, "experiment")
    study, log = study_at(path), log_of(path, name, is_whole=True)
    index = [e.name for e in study.experiments].index(name)
    ends = [body.get("start"), body.get("stop")]
    for end in ends:
        if end is not None and not (isinstance(end, int | float) and math.isfinite(end)):
            raise InvalidInput("a window has two numbers in s", where="start, stop")
    low = log.time[0] if ends[0] is None else ends[0]
    high = log.time[-1] if ends[1] is None else ends[1]
    if not low < high or low > log.time[-1] or high < log.time[0]:
        raise InvalidInput("the window contains no samples", where="start, stop")
    edit_study(
        path,
        [
            Change(("experiment", index, key), None if end is None else round(float(end), 6))
            for key, end in zip(("start", "stop"), ends, strict=True)
        ],
    )
    return {}


def _record(request: Request) -> tuple[Path, Study, Log]:
    """Study file, study, and the whole log that the request names."""
    path = study_of(request)
    study = study_at(path)
    name = request.query_params.get("experiment", "") or study.experiments[0].name
    return path, study, log_of(path, name, is_whole=True)


def _number(text: str | None, default: float) -> float:
    try:
        value = float(text) if text else default
    except ValueError as error:
        raise InvalidInput(f"{text!r} is no number", where="request") from error
    if not math.isfinite(value):
        raise InvalidInput(f"{text!r} is not finite", where="request")
    return value
