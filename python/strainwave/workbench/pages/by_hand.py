"""Page "By hand": sliders for every parameter over measured data."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from starlette.requests import Request
from starlette.responses import Response

from strainwave.domain import (
    Experiment,
    FrequencyResponse,
    Log,
    Prediction,
    Study,
    channel_parts,
)
from strainwave.domain.arm.assumed_values import AssumedValues
from strainwave.domain.arm.description import ArmDescription, unit_in
from strainwave.domain.arm.kinds.base import LINK_PARAMETERS
from strainwave.domain.arm.link_sensors import constant_of
from strainwave.domain.arm.parameter_table import ParameterDescription, base_name, record_of
from strainwave.domain.arm.parameters import parameter_descriptions
from strainwave.domain.keys import Key, Values, label_of
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.export.linear_models import trial_response
from strainwave.identification.closed_loop import restrict_to_values
from strainwave.identification.trial_values import (
    MotionWindow,
    TorqueWindow,
    starting_values,
    window_of,
)
from strainwave.io.atomic_files import read_json, write_whole
from strainwave.io.kept_files import fingerprint, log_of, study_at
from strainwave.io.parameters import parameter_file
from strainwave.io.results import response_of, rigid_band_of
from strainwave.report.document.predictions import prediction_figure
from strainwave.report.figures.curves import Curve, bode
from strainwave.report.plotly_backend import plotly
from strainwave.signals.recorded_input import missing_motor_signal
from strainwave.workbench.pages.check import require_open
from strainwave.workbench.pages.estimate import snapshot
from strainwave.workbench.pages.runs import describe
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import Body, Routes, page, study_of, text_of, workspace_of
from strainwave.workbench.workspace import check_name

_MAX_POINTS = 600  # of a line
_RANGE = 10.0  # of a slider, as a factor on either side of its start
_ZERO_RANGE = 0.1  # of a slider that starts at zero, over the largest value of its unit
_LINK_NAMES = frozenset(f"link_{name}" for name in LINK_PARAMETERS)


def sliders(study: Study, start: AssumedValues, record: str) -> list[dict[str, Any]]:
    """The values that the simulation of a record needs, with the ranges of their sliders."""
    arm, values = restrict_to_values(Arm.of(study.arm), start.values), start.values
    idle = set(arm.base.links) - set(arm.base.effective)  # without effect on the motion
    keys = [key for key in arm.parameter_names if key in values]
    keys += [k for k in values if _is_of_record(k) and record_of(k[0]) in ("", record)]
    keys.sort(key=lambda key: (key[1] or 0, key[0] in _LINK_NAMES))
    constants = {key: constant_of(key) for key in keys}
    units = {key: c.unit if c else unit_in(study.arm, key) for key, c in constants.items()}
    sizes = [(unit, abs(values[key])) for key, unit in units.items()]
    largest = dict(sorted(sizes))
    rows = []
    for key, unit in units.items():
        value, text = values[key], parameter_descriptions().get(base_name(key[0]))
        has_sign = not isinstance(text, ParameterDescription) or text.range == "any"
        is_log = value > 0.0 and not has_sign
        spread = 2.0 * abs(value) or _ZERO_RANGE * largest[unit] or 1.0
        low = value / _RANGE if is_log else value - spread if has_sign else 0.0
        high = value * _RANGE if is_log else value + spread
        group = "Link" if key[0] in _LINK_NAMES else "Sensors" if constants[key] else "Joint"
        row: dict[str, Any] = {
            "name": key[0],
            "joint": key[1],
            "label": label_of(*key),
            "unit": unit,
        }
        row |= {"group": f"{group} {key[1]}" if key[1] else "Arm"}
        row |= {"value": value, "low": low, "high": high, "is_log": is_log}
        row |= {"is_idle": key in idle, "reason": start.reasons.get(key, "")}
        row |= {"symbol": text.symbol, "description": text.description} if text else {}
        rows.append(row)
    return rows


def _is_of_record(key: Key) -> bool:
    """Whether a value belongs to a sensor, or to one record as a change of friction."""
    is_change = record_of(key[0]) != "" and base_name(key[0]) in parameter_descriptions()
    return is_change or constant_of(key) is not None


def check_values(study: Study, entries: object) -> Values:
    """Values of a request; raises InvalidInput for an unknown parameter or no number."""
    values: Values = {}
    for entry in entries if isinstance(entries, list) else [None]:
        if not isinstance(entry, dict):
            raise InvalidInput("the request has no values", where="values")
        name, joint, value = str(entry.get("name")), entry.get("joint"), entry.get("value")
        if not isinstance(joint, int | None):
            raise InvalidInput(f"there is no parameter {label_of(name, joint)}", where="values")
        place = f"the field of {label_of(name, joint)}"
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise InvalidInput("is not a number", where=place)
        if not math.isfinite(value):
            raise InvalidInput("is not a finite number", where=place)
        values[name, joint] = float(value)
    known = restrict_to_values(Arm.of(study.arm), values).parameter_names
    for key in values.keys() - set(known):
        if not _is_of_record(key):
            raise InvalidInput(f"there is no parameter {label_of(*key)}", where="values")
    return values


@dataclass(frozen=True, slots=True)
class Shown:
    """A window of a record, and the channels that are shown of it."""

    path: Path  # of the study
    experiment: str
    window: tuple[float, float]  # [s]
    channels: tuple[str, ...] = ()  # empty: all
    band_hz: float = 0.0  # of the torques of rigid joints; 0: that of the motion


def simulate(shown: Shown, given: Values) -> Prediction:
    """Simulate a record with given parameters; `trial_values` tells what is compared.

    Raises NotIdentifiable with a sentence if these values cannot be simulated, and InvalidInput if
    the record cannot be compared.
    """
    record = _prepared(replace(shown, channels=()), fingerprint(shown.path), frozenset(given))
    return record.predict(given, shown.channels)


@lru_cache(maxsize=6)
def _prepared(shown: Shown, _stamp: str, keys: frozenset[Key]) -> MotionWindow | TorqueWindow:
    """A window of a record for an arm whose known parameters are `keys`."""
    arm = restrict_to_values(Arm.of(study_at(shown.path).arm), dict.fromkeys(keys, 0.0))
    log = log_of(shown.path, shown.experiment)
    return window_of(log, shown.window, arm, shown.band_hz or None)


routes = Routes()

_START = "start.json"
# of a window; longer ones take longer than a tenth of a second
_MAX_DURATION = 20.0  # [s]
_MAX_JOINT_SECONDS = 30.0  # [s] times joints, behind elastic gears


def longest_window(arm: ArmDescription) -> float:
    """Longest window [s] that follows a slider."""
    is_rigid = len(arm.rigid_joints) == arm.n_joints
    return min(_MAX_DURATION, np.inf if is_rigid else round(_MAX_JOINT_SECONDS / arm.n_joints, 1))


def usable_experiments(path: Path) -> list[Experiment]:
    """Experiments of a study whose logs have the angle and the input of every motor."""
    study = study_at(path)
    arm = Arm.of(study.arm)
    return [
        each
        for each in study.experiments
        if missing_motor_signal(arm, log_of(path, each.name)) is None
    ]


@routes.page("/by-hand/{study:path}")
def _show_by_hand(request: Request) -> Response:
    path, workspace = study_of(request), workspace_of(request)
    arm = study_at(path).arm
    return page(
        request,
        "by_hand",
        "By hand",
        records=usable_experiments(path),
        starts=[workspace.relative(file) for file in workspace.results_of(path)],
        joints=range(1, arm.n_joints + 1),
        is_rigid=len(arm.rigid_joints) == arm.n_joints,
        duration=longest_window(arm),
    )


@routes.post("/api/by-hand-begin/{study:path}")
def begin(request: Request, body: Body) -> object:
    """Sliders with the values of a file, and the channels of a record."""
    shown = _shown(request, body)
    study, file = study_at(shown.path), workspace_of(request).resolve(text_of(body, "start"))
    start = starting_values(study.arm, file)
    rows = sliders(study, start, shown.experiment)
    prediction = simulate(shown, {(row["name"], row["joint"]): row["value"] for row in rows})
    return {"sliders": rows, "channels": prediction.channels, "window": shown.window}


@routes.post("/api/by-hand/{study:path}")
def update(request: Request, body: Body) -> object:
    """Simulated channels, residuals and Bode plot with the values of the sliders."""
    begin_time = time.perf_counter()
    shown = _shown(request, body)
    study = study_at(shown.path)
    values = check_values(study, body.get("values"))
    prediction = simulate(shown, values)
    wanted = body.get("channels")
    names = [n for n in prediction.channels if isinstance(wanted, list) and n in wanted]
    figure = prediction_figure(
        prediction, study.arm.joints, _MAX_POINTS, names or prediction.channels[:2], "simulated"
    )
    return {
        "time": plotly(figure),
        "fits": prediction.fit_percent,
        "bode": _bode(request, body, study, values),
        "milliseconds": 1e3 * (time.perf_counter() - begin_time),
    }


def _shown(request: Request, body: Body) -> Shown:
    """The record, its window, and the channels of a request: those named and of the joint."""
    path = study_of(request)
    log, measured = log_of(path, text_of(body, "experiment")), tuple[str, ...]()
    wanted, joint = body.get("channels"), body.get("joint")
    if isinstance(wanted, list) and isinstance(joint, int):
        of_joint = (name for name in log.channels if channel_parts(name)[1] == joint)
        names = [*filter(None, map(str, wanted)), *of_joint, f"omega_m{joint}"]
        measured = tuple(name.replace("theta", "omega") for name in names)
    band, _ = _start_of(request, body)
    window = _window(body, log, longest_window(study_at(path).arm))
    return Shown(path, log.name, window, measured, band)


def _start_of(
    request: Request, body: Body, joint: int | None = None
) -> tuple[float, FrequencyResponse | None]:
    """Bandwidth [Hz] of the rigid stage, and measured response of a joint, of a starting result.

    The bandwidth is zero, and the response None, if it has none.
    """
    path = workspace_of(request).resolve(text_of(body, "start"))
    return _parts_of(path, path.stat().st_mtime_ns, joint) if path.is_file() else (0.0, None)


@lru_cache(maxsize=32)
def _parts_of(path: Path, _time: int, joint: int | None) -> tuple[float, FrequencyResponse | None]:
    document = read_json(path, "the start", "choose another one")
    if not isinstance(document, dict):
        return 0.0, None
    return rigid_band_of(document), None if joint is None else response_of(document, joint)


def _bode(request: Request, body: Body, study: Study, values: Values) -> dict[str, Any] | None:
    """Response of a joint with the values, and the measured one of the starting result."""
    joint = body.get("joint")
    if not isinstance(joint, int):
        return None
    try:
        curves = [Curve("sliders", *trial_response(study, values, joint))]
    except InvalidInput:  # rigid, or a joint of a coupled transmission
        return None
    _, measured = _start_of(request, body, joint)
    if measured is not None:
        points = measured.frequencies_hz, measured.response[:, 0, 0]
        curves.insert(0, Curve("measured", *points, true=True))
    return plotly(bode(curves, f"Joint {joint}"))


def _window(body: Body, log: Log, duration: float) -> tuple[float, float]:
    """Window of the record, of at most a duration [s]."""
    first, last, start = float(log.time[0]), float(log.time[-1]), body.get("from")
    if not isinstance(start, int | float) or not math.isfinite(start):
        start = first
    start = min(max(float(start), first), last)
    return start, min(start + duration, last + log.sample_time)


@routes.post("/api/by-hand-save/{study:path}")
def save_values(request: Request, body: Body) -> object:
    """Write the values of the sliders to a parameter file next to the study."""
    path, name = study_of(request), text_of(body, "name")
    check_name(name)
    file = name if name.endswith(".json") else f"{name}.json"
    if (path.parent / file).exists():
        raise InvalidInput("exists already", where=file, remedy="choose another name")
    values = check_values(study_at(path), body.get("values"))
    write_whole(path.parent, {file: parameter_file(values)})
    return {"file": file}


@routes.post("/api/by-hand-fit/{study:path}")
def fit_from_here(request: Request, body: Body) -> object:
    """Start an identification whose whole-arm fit starts at the values of the sliders."""
    path = study_of(request)
    require_open(path)
    values = check_values(study_at(path), body.get("values"))
    held = body.get("held", [])
    if not isinstance(held, list) or not all(isinstance(each, str) for each in held):
        raise InvalidInput("the request names no parameters to hold", where="held")
    runs = Runs(path)
    name = runs.free_name("identify")
    files = {"study.toml": snapshot(path).encode(), _START: parameter_file(values)}
    runs.prepare(name)
    command = ["identify", "study.toml", "--out", ".", "--start", _START]
    if held:
        command += ["--set", f"tuning.hold={json.dumps(held)}"]
    return describe(runs.start(name, "identify", [command], "from sliders", files))
