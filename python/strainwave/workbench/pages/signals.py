"""Page "Signals": every signal over time, spectra, marks, windows."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from difflib import SequenceMatcher
from functools import lru_cache
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from strainwave import pipeline
from strainwave.domain import Experiment, Log
from strainwave.domain.steps import STEPS, Step, files_of
from strainwave.domain.study import study_keys
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.init.changes import KeyChange, edit_study
from strainwave.init.signal_features import sequences_of
from strainwave.io.kept_files import experiment_of, fingerprint, segments_of, study_at
from strainwave.io.study import detrendable_channels, step_table, with_steps
from strainwave.io.system import relative_path
from strainwave.report.document import elastic
from strainwave.report.document.predictions import unit_of
from strainwave.report.figures.log_figures import (
    UNITS,
    ShownRecord,
    View,
    coherence_figure,
    spectrum_figure,
    time_figure,
)
from strainwave.report.plotly_backend import plotly
from strainwave.signals.marks import marks_of
from strainwave.workbench.web import Body, Routes, page, study_of, text_of, workspace_of

routes = Routes()
_POINTS = (200, 6000)  # smallest and largest number of points of a line


@routes.page("/signals/{study:path}")
def _show_signals(request: Request) -> Response:
    study = study_at(study_of(request))
    steps = {kind: study_keys()[kind] for kind in STEPS}
    return page(request, "signals", "Signals", experiments=study.experiments, steps=steps)


@routes.get("/api/record/{study:path}")
def describe_record(request: Request) -> object:
    """Channels, window, steps, marks and detected sequences of a record."""
    path, name = study_of(request), request.query_params.get("record", "")
    study, experiment = study_at(path), experiment_of(path, name)
    logs = _whole(path, experiment)
    arm = Arm.of(study.arm)
    return {
        "channels": list(logs[0].channels),
        "detrendable": [n for n in logs[0].channels if n in detrendable_channels(study.arm)],
        "samples": sum(map(len, logs)),
        "sample_time": logs[0].sample_time,
        "start": float(logs[0].time[0]),
        "stop": float(logs[-1].time[-1]),
        "window": [experiment.start, experiment.stop],
        "steps": [step_table(step) for step in experiment.steps],
        "marks": [asdict(mark) for log in logs for mark in marks_of(log, arm)],
        "sequences": [
            f"{channel}: PRBS of order {prbs.order}, clock {1e3 * prbs.clock:g} ms,"
            f" {prbs.periods:g} periods, amplitude {prbs.amplitude:g} {unit_of(channel)}"
            for channel, prbs in sequences_of(max(logs, key=len)).items()
        ],
        "files": [relative_path(each, path.parent) for each in study.log_paths(experiment)],
    }


@routes.get("/api/signal-time/{study:path}")
def show_time(request: Request) -> object:
    """Channels over a span of time."""
    query, view = request.query_params, _view(request)
    first = view.records[0]
    low = _number(query.get("from"), float(first.logs[0].time[0]) - (first.origin or 0.0))
    high = _number(query.get("to"), float(first.logs[-1].time[-1]) - (first.origin or 0.0))
    if not low < high:
        raise InvalidInput("the time span is empty", where="from, to")
    points = int(min(max(_number(query.get("points"), 1200.0), _POINTS[0]), _POINTS[1]))
    return plotly(time_figure(view, (low, high), points))


@routes.get("/api/signal-spectra/{study:path}")
def show_spectra(request: Request) -> object:
    """Spectra of channels, and the coherence of inputs and motor velocities."""
    query, view = request.query_params, _view(request)
    frequency, magnitude = (query.get(name) != "linear" for name in ("frequency", "magnitude"))
    spectra = spectrum_figure(view, log_frequency=frequency, log_magnitude=magnitude)
    longest = max(view.records[0].logs, key=len)
    coherence = coherence_figure(longest, view.arm.n_joints)
    return {"spectra": plotly(spectra), "coherence": plotly(coherence)}


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
            "text": elastic.describe_interaction(record.signals),
            "checks": [{"passed": c.passed, "message": c.message} for c in record.signals.checks],
            "figure": plotly(elastic.torque_spectrum(record.signals)),
        }
        for record in result.records
        if record.signals.inputs.shape[1] == 2
    ]


@routes.post("/api/window/{study:path}")
def set_window(request: Request, body: Body) -> object:
    """Write the window of a record to the study file; null removes an end."""
    path, name = study_of(request), text_of(body, "experiment")
    logs = _whole(path, experiment_of(path, name))
    ends = [body.get("start"), body.get("stop")]
    for end in ends:
        if end is not None and not (isinstance(end, int | float) and math.isfinite(end)):
            raise InvalidInput("a window has two numbers in s", where="start, stop")
    first, last = logs[0].time[0], logs[-1].time[-1]
    low = first if ends[0] is None else ends[0]
    high = last if ends[1] is None else ends[1]
    if not low < high or low > last or high < first:
        raise InvalidInput("the window contains no samples", where="start, stop")
    rounded = [None if end is None else round(float(end), 6) for end in ends]
    places = [("experiment", _index(path, name), key) for key in ("start", "stop")]
    edit_study(path, list(map(KeyChange, places, rounded)))
    return {}


@routes.post("/api/steps/{study:path}")
def set_steps(request: Request, body: Body) -> object:
    """Write the preprocessing steps of a record to the study file; unchanged ones stay."""
    path, name = study_of(request), text_of(body, "experiment")
    steps = _steps(request, path, name, body.get("steps"))
    old = experiment_of(path, name).steps
    place = ("experiment", _index(path, name), "steps")
    changes = []
    for _, low, high, first, last in reversed(SequenceMatcher(None, old, steps).get_opcodes()):
        if old[low:high] != steps[first:last]:
            changes += [KeyChange((*place, low), None)] * (high - low)
            new = map(step_table, reversed(steps[first:last]))
            changes += [KeyChange((*place, low), table) for table in new]
    edit_study(path, changes if steps else [KeyChange(place, None)])
    return {}


def _index(path: Path, name: str) -> int:
    return [each.name for each in study_at(path).experiments].index(name)


def _steps(request: Request, path: Path, name: str, tables: object) -> tuple[Step, ...]:
    """Checked steps of a request, whose files lie in the served folder or an allowed one."""
    if not isinstance(tables, list) or not all(isinstance(each, dict) for each in tables):
        raise InvalidInput("the request has no list of steps", where="steps")
    for file in files_of({"steps": tables}):
        workspace_of(request).file_of(path, file)
    experiment_of(path, name)
    changed = with_steps(study_at(path), name, tables)
    return next(each.steps for each in changed.experiments if each.name == name)


def _whole(path: Path, experiment: Experiment) -> tuple[Log, ...]:
    """The segments of a record without its window."""
    return segments_of(path, replace(experiment, start=None, stop=None))


def _view(request: Request) -> View:
    """What the address asks for: records, channels, steps of the first record, panels, units."""
    path, query = study_of(request), request.query_params
    study = study_at(path)
    names = query.getlist("record") or [study.experiments[0].name]
    experiments = [experiment_of(path, name) for name in dict.fromkeys(names)]
    if "steps" in query:
        steps = _steps(request, path, names[0], _json_of(query["steps"]))
        experiments[0] = replace(experiments[0], steps=steps)
    shown = [(each, False) for each in experiments]
    if query.get("before") and experiments[0].steps:
        shown.insert(1, (replace(experiments[0], steps=experiments[0].merges), True))
    records = []
    for experiment, is_before in shown:
        logs = _whole(path, experiment)
        origin = float(logs[0].time[0]) if len(experiments) > 1 else None
        records.append(ShownRecord(experiment.name, logs, origin, is_before))
    units, channels = query.get("units", "rad"), query.getlist("channel")
    if units not in UNITS:
        raise InvalidInput(f"{units!r} are no units", where="units", remedy=", ".join(UNITS))
    return View(records, channels, study.arm, query.get("panels") == "unit", units)


def _json_of(text: str) -> object:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidInput("the steps are no JSON", where="steps") from error


def _number(text: str | None, default: float) -> float:
    try:
        value = float(text) if text else default
    except ValueError as error:
        raise InvalidInput(f"{text!r} is no number", where="request") from error
    if not math.isfinite(value):
        raise InvalidInput(f"{text!r} is not finite", where="request")
    return value
