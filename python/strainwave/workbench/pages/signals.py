"""Page "Signals": every signal over time, spectra, marks, windows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from starlette.requests import Request
from starlette.responses import Response

from strainwave import pipeline
from strainwave.domain import (
    ArmDescription,
    BoolArray,
    FloatArray,
    IntArray,
    Log,
    Study,
    channel_parts,
)
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.init.signal_features import sequence_of, sequence_under_servo
from strainwave.report.document import elastic
from strainwave.report.document.predictions import unit_of
from strainwave.report.figures import (
    DASHES,
    FREQUENCY_AXIS,
    PALETTE,
    Axis,
    Figure,
    Line,
    Panel,
    line_panel,
    spread_evenly,
)
from strainwave.report.plotly_backend import plotly
from strainwave.signals import hygiene
from strainwave.signals.prepared_record import prepare_record
from strainwave.signals.standstill import runs_of
from strainwave.workbench.study_edit import KeyChange, edit_study
from strainwave.workbench.web import Body, Routes, page, study_of, text_of
from strainwave.workbench.workspace import fingerprint, log_of, study_at

_SEGMENTS = 8  # of Welch's method
_MAX_LINES = 800  # frequencies drawn
_MAX_MARKS = 200  # listed; the largest
_MIN_STANDSTILL = 0.05  # [s] shorter ones belong to every reversal


@dataclass(frozen=True, slots=True)
class Mark:
    """A stretch of a channel."""

    kind: str
    channel: str
    start: float  # [s]
    stop: float  # [s]


def require_channels(log: Log, names: Sequence[str]) -> list[str]:
    """The names; raises InvalidInput if one is no channel of the log, or if there is none."""
    unknown = [name for name in names if name not in log.channels]
    if unknown or not names:
        raise InvalidInput(
            f"the record {log.name!r} has no channel {', '.join(unknown) or 'chosen'}",
            remedy=f"choose from: {', '.join(log.channels)}",
        )
    return list(names)


def time_figure(
    log: Log, arm: ArmDescription, names: Sequence[str], span: tuple[float, float], points: int
) -> Figure:
    """Channels over time in one panel each, decimated to minimum and maximum per column."""
    first, last = np.searchsorted(log.time, span)
    first, last = max(int(first) - 1, 0), min(int(last) + 1, len(log))
    panels = []
    for name, colour in zip(require_channels(log, names), cycle(PALETTE), strict=False):
        values, time = log.channels[name][first:last], log.time[first:last]
        title = f"{name} [{unit_of(name, arm.joints)}]"
        panels.append(line_panel(title, time, values, name, colour, points))
    return Figure(Axis("time [s]", range=span), tuple(panels))


def spectrum_figure(log: Log, arm: ArmDescription, names: Sequence[str]) -> Figure:
    """Amplitude spectral density of channels, by Welch's method."""
    from scipy import signal  # takes half a second

    panels = []
    for name, colour in zip(require_channels(log, names), cycle(PALETTE), strict=False):
        values, rate = log.channels[name], 1.0 / log.sample_time
        frequency, density = signal.welch(values, rate, nperseg=_segment(log))
        rows = _shown(frequency)
        title = f"{name} [{unit_of(name, arm.joints)}/√Hz]"
        line = Line(frequency[rows], np.sqrt(density[rows]), name, colour)
        panels.append(Panel(Axis(title, log=True), (line,)))
    return Figure(FREQUENCY_AXIS, tuple(panels))


def coherence_figure(log: Log, n_joints: int) -> Figure:
    """Coherence of each motor's input and velocity."""
    from scipy import signal

    lines = []
    styles = zip(range(1, n_joints + 1), cycle(PALETTE), cycle(DASHES), strict=False)
    for joint, colour, dash in styles:
        drive = next((c for c in (f"u{joint}", f"torque{joint}") if c in log.channels), None)
        if drive is None or not np.ptp(log.channels[drive]):
            continue
        velocity = np.gradient(log.channels[f"theta_m{joint}"], log.sample_time)
        pair, rate = (log.channels[drive], velocity), 1.0 / log.sample_time
        frequency, share = signal.coherence(*pair, rate, nperseg=_segment(log))
        rows = _shown(frequency)
        name = f"{drive} and velocity of motor {joint}"
        lines.append(Line(frequency[rows], share[rows], name, colour, dash))
    panel = Panel(Axis("coherence", range=(0.0, 1.02)), tuple(lines))
    return Figure(FREQUENCY_AXIS, (panel,))


def _segment(log: Log) -> int:
    return min(len(log), max(64, 2 * len(log) // (_SEGMENTS + 1)))


def _shown(frequency: FloatArray) -> IntArray:
    return spread_evenly(frequency, frequency[1], float(frequency[-1]), _MAX_LINES)


def marks_of(log: Log, arm: Arm) -> list[Mark]:
    """Saturation, standstill and defects of sensors, in the order of time."""
    record = prepare_record(log, arm)
    marks: list[Mark] = []
    for channel, at in zip(record.channels, record.saturation.samples.T, strict=True):
        marks += _stretches(log, "saturation", channel, at)
    for joint, at in enumerate(record.sliding.T == 0.0, start=1):
        standing = _stretches(log, "standstill", f"theta_m{joint}", at)
        marks += [mark for mark in standing if mark.stop - mark.start >= _MIN_STANDSTILL]
    for defect in hygiene.detect_defects([log], arm)[0]:
        last = min(defect.stop, len(log) - 1)
        kind = defect.kind.replace("-", " ")
        times = float(log.time[defect.start]), float(log.time[last])
        marks.append(Mark(kind, defect.channel, *times))
    longest = sorted(marks, key=lambda m: m.start - m.stop)[:_MAX_MARKS]
    return sorted(longest, key=lambda m: (m.start, m.channel))


def _stretches(log: Log, kind: str, channel: str, at: BoolArray) -> Iterator[Mark]:
    for start, stop in runs_of(at).tolist():
        last = min(stop, len(log) - 1)
        yield Mark(kind, channel, float(log.time[start]), float(log.time[last]))


def sequences_of(log: Log) -> list[str]:
    """A sentence about each pseudo-random binary sequence in the inputs."""
    sentences = []
    for name, values in log.channels.items():
        if channel_parts(name)[0] not in ("u", "torque"):
            continue
        prbs = sequence_of(values, log.sample_time) or sequence_under_servo(values, log.sample_time)
        if prbs is not None:
            sentences.append(
                f"{name}: PRBS of order {prbs.order}, clock {1e3 * prbs.clock:g} ms,"
                f" {prbs.periods:g} periods, amplitude {prbs.amplitude:g} {unit_of(name)}"
            )
    return sentences


routes = Routes()

_POINTS = (200, 6000)  # smallest and largest number of points of a line


@routes.page("/signals/{study:path}")
def _show_signals(request: Request) -> Response:
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
    rounded = [None if end is None else round(float(end), 6) for end in ends]
    places = [("experiment", index, key) for key in ("start", "stop")]
    edit_study(path, list(map(KeyChange, places, rounded)))
    return {}


def _record(request: Request) -> tuple[Path, Study, Log]:
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
