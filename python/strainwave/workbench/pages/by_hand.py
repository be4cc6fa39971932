"""Page "By hand": sliders for every parameter over measured data."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from starlette.requests import Request
from starlette.responses import Response

from strainwave.domain import (
    ComplexArray,
    FloatArray,
    Log,
    Parameter,
    Prediction,
    Study,
    channel_parts,
)
from strainwave.domain.arm.description import unit_in
from strainwave.domain.arm.kinds.base import LINK_PARAMETERS
from strainwave.domain.arm.parameter_table import base_name, parameter_table
from strainwave.domain.arm.parameters import complete_values
from strainwave.domain.keys import Values, label_of
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import resonance
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.export.linear_models import joint_model
from strainwave.export.source import IdentifiedArm
from strainwave.identification.joint_model.agreement import motor_response
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.preparation import (
    cutoff_of,
    dataset_of,
    lengthen_steps,
)
from strainwave.io.atomic_files import write_whole
from strainwave.io.parameters import read_parameters
from strainwave.io.results import response_of
from strainwave.report.document.predictions import prediction_figure
from strainwave.report.figures.curves import Curve, bode
from strainwave.report.plotly_backend import plotly
from strainwave.signals.recorded_input import missing_motor_signal
from strainwave.workbench.pages.check import require_open
from strainwave.workbench.pages.estimate import snapshot
from strainwave.workbench.pages.runs import describe
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import Body, Routes, page, study_of, text_of, workspace_of
from strainwave.workbench.workspace import check_name, fingerprint, log_of, study_at

_MAX_POINTS = 800  # of a line
_DECADES = 1.0  # of a Bode plot below the anti-resonance and above the resonance
_N_FREQUENCIES = 300
_DEFAULT_RESONANCE_HZ = 30.0  # where no joint has a linear model
_RANGE_DECADES = 1.0  # of a slider on either side of its start
_MIN_MOTION_TO_NOISE = 3.0  # a channel with less has no fit
_MIN_MOTION_SHARE = 0.02  # of the largest motion of a channel of its kind
_LINK_NAMES = frozenset(f"link_{name}" for name in LINK_PARAMETERS)


def sliders(study: Study, values: Values) -> list[dict[str, Any]]:
    """The parameters of the arm that a simulation needs, with the ranges of their sliders."""
    arm = Arm.of(study.arm.with_selected_laws(values))
    known = complete_values(values, arm)
    largest: dict[str, float] = {}
    for key in arm.parameter_names:
        unit = unit_in(study.arm, key)
        largest[unit] = max(largest.get(unit, 0.0), abs(known.get(key, 0.0)))
    rows = []
    for key in (key for key in arm.parameter_names if key in known):
        value, unit, table = known[key], unit_in(study.arm, key), parameter_table()
        text = table.get(base_name(key[0]))
        is_log = value > 0.0 and (text is None or text.range != "any")
        factor = 10.0**_RANGE_DECADES
        spread = 2.0 * abs(value) or 0.1 * largest[unit] or 1.0
        rows.append(
            {
                "label": label_of(*key),
                "name": key[0],
                "joint": key[1],
                "symbol": text.symbol if text else "",
                "description": text.description if text else "",
                "unit": unit,
                "value": value,
                "low": value / factor if is_log else value - spread,
                "high": value * factor if is_log else value + spread,
                "is_log": is_log,
                "is_of_link": key[0] in _LINK_NAMES,
            }
        )
    return rows


def check_values(study: Study, entries: object) -> Values:
    """Values of a request; raises InvalidInput for an unknown parameter or no number."""
    values: Values = {}
    for entry in entries if isinstance(entries, list) else [None]:
        if not isinstance(entry, dict) or not isinstance(entry.get("value"), int | float):
            raise InvalidInput("the request has no values", where="values")
        key = str(entry.get("name")), entry.get("joint")
        if not isinstance(key[1], int | None):
            raise InvalidInput(f"there is no parameter {label_of(*key)}", where="values")
        values[key] = float(entry["value"])
    known = Arm.of(study.arm.with_selected_laws(values)).parameter_names
    for key in values.keys() - set(known):
        raise InvalidInput(f"there is no parameter {label_of(*key)}", where="values")
    return values


def simulate(
    path: Path, experiment: str, window: tuple[float, float], values: Values
) -> Prediction:
    """Simulate a window of a record with given parameters; link sensors without their bias.

    Raises NotIdentifiable with a sentence if these values cannot be simulated, and InvalidInput if
    the record cannot be compared.
    """
    record = _prepared(path, fingerprint(path), experiment, window)
    record = replace(record, arm=record.arm.with_selected_laws(values))
    try:
        simulated, _ = record.linearise(values, record.start(), ())
    except (NumericalFailure, InvalidInput) as error:
        raise NotIdentifiable(f"these values cannot be simulated: {error}") from error
    except KeyError as error:  # neither the start nor the study has it
        raise NotIdentifiable(f"there is no value of {label_of(*error.args[0])}") from error
    if not np.all(np.isfinite(simulated)):
        raise NotIdentifiable("these values cannot be simulated: the motion grows without limit")
    residual = record.measured - simulated
    kinds = np.array([channel_parts(name)[0] for name in record.channel_names])
    of_link = kinds != "omega_m"  # a sensor on the link has a bias
    residual[:, of_link] -= residual[:, of_link].mean(axis=0)
    motion, errors = record.measured.std(axis=0), np.sqrt(np.mean(residual**2, axis=0))
    # a channel with little motion of its kind only reacts to the motion of others
    largest = np.array([motion[kinds == kind].max() for kind in kinds])
    rests = motion < np.maximum(_MIN_MOTION_TO_NOISE * record.noise, _MIN_MOTION_SHARE * largest)
    fits = 100.0 * (1.0 - errors / np.where(rests, np.nan, motion))
    return Prediction(
        experiment,
        record.time,
        tuple(record.channel_names),
        record.measured,
        record.measured - residual,
        dict(zip(record.channel_names, fits.tolist(), strict=True)),
    )


@lru_cache(maxsize=6)
def _prepared(
    path: Path, _fingerprint: str, experiment: str, window: tuple[float, float]
) -> Dataset:
    """A window of a record, filtered and in long integrator steps."""
    study, log = study_at(path), log_of(path, experiment)
    cut = _cut(log, window)
    arm = Arm.of(study.arm)
    cutoff = cutoff_of([cut], arm, _DEFAULT_RESONANCE_HZ)
    # under gravity the error of a simulation by recorded voltages grows; a servo holds it
    closed_loop = study.arm.servo is not None and "servo" in cut.experiment.control
    return lengthen_steps(dataset_of(cut, arm, cutoff, closed_loop=closed_loop))


def _cut(log: Log, window: tuple[float, float]) -> Log:
    first, last = np.searchsorted(log.time, window)
    rows = slice(int(first), int(last))
    if first == 0 and last >= len(log):
        return log
    return replace(
        log,
        time=log.time[rows],
        channels={name: values[rows] for name, values in log.channels.items()},
        masked={name: mask[rows] for name, mask in log.masked.items()},
    )


def joint_response(study: Study, values: Values, joint: int) -> tuple[FloatArray, ComplexArray]:
    """Frequencies [Hz] and response of motor velocity to motor torque of one joint alone.

    Raises InvalidInput if the joint has no linear model with these values.
    """
    parameters = tuple(
        Parameter(*key, value, None, unit_in(study.arm, key), "tuned")
        for key, value in values.items()
    )
    study = replace(study, arm=study.arm.with_selected_laws(values))
    model = joint_model(IdentifiedArm(study, parameters, "the sliders"), joint)
    high = resonance(model).frequency_hz
    f = np.geomspace(high / 10.0 ** (2.0 * _DECADES), high * 10.0**_DECADES, _N_FREQUENCIES)
    return f, motor_response(model.vector, model.gear_ratio, f)


def parameter_document(values: Values) -> dict[str, Any]:
    """Values as a parameter file that the command line reads."""
    entries = [{"name": key[0], "joint": key[1], "value": value} for key, value in values.items()]
    return {"parameters": entries}


routes = Routes()

_START = "start.json"
_MAX_DURATION = 20.0  # [s] of a window; longer ones take longer than a tenth of a second


@routes.page("/by-hand/{study:path}")
def _show_by_hand(request: Request) -> Response:
    path = study_of(request)
    study, workspace = study_at(path), workspace_of(request)
    arm = Arm.of(study.arm)
    records = [
        each
        for each in study.experiments
        if missing_motor_signal(arm, log_of(path, each.name)) is None
    ]
    starts = [workspace.relative(file) for file in workspace.results_of(path)]
    elastic = [i for i, joint in enumerate(study.arm.joints, start=1) if joint.elastic]
    return page(request, "by_hand", "By hand", records=records, starts=starts, joints=elastic)


@routes.post("/api/by-hand-begin/{study:path}")
def begin(request: Request, body: Body) -> object:
    """Sliders with the values of a file, and the channels of a record."""
    path = study_of(request)
    study, start = study_at(path), text_of(body, "start")
    log = log_of(path, text_of(body, "experiment"))
    values = read_parameters(workspace_of(request).resolve(start))
    rows = sliders(study, values)
    rows = sliders(study, values)
    values = {(row["name"], row["joint"]): row["value"] for row in rows}
    shown = simulate(path, log.name, _window(body, log), values)
    return {
        "sliders": rows,
        "channels": shown.channels,
        "window": _window(body, log),
    }


@routes.post("/api/by-hand/{study:path}")
def update(request: Request, body: Body) -> object:
    """Simulated channels, residuals and Bode plot with the values of the sliders."""
    begin_time = time.perf_counter()
    path = study_of(request)
    study = study_at(path)
    values = check_values(study, body.get("values"))
    log = log_of(path, text_of(body, "experiment"))
    shown = simulate(path, log.name, _window(body, log), values)
    wanted = body.get("channels")
    names = [name for name in wanted if name in shown.channels] if isinstance(wanted, list) else []
    figure = prediction_figure(
        shown, study.arm.joints, _MAX_POINTS, names or shown.channels[:2], model="simulated"
    )
    return {
        "time": plotly(figure),
        "fits": shown.fit_percent,
        "bode": _bode(request, body, study, values),
        "milliseconds": 1e3 * (time.perf_counter() - begin_time),
    }


def _bode(request: Request, body: Body, study: Study, values: Values) -> dict[str, Any] | None:
    """Response of a joint with the values, and the measured one of the starting result."""
    joint = body.get("joint")
    if not isinstance(joint, int):
        return None
    try:
        curves = [Curve("sliders", *joint_response(study, values, joint))]
    except InvalidInput:  # a joint of a coupled transmission has no model of its own
        return None
    start = workspace_of(request).resolve(text_of(body, "start"))
    if start.name == "result.json":
        measured = response_of(json.loads(start.read_bytes()), joint)
        if measured is not None:
            points = measured.frequencies_hz, measured.response[:, 0, 0]
            curves.insert(0, Curve("measured", *points, true=True))
    return plotly(bode(curves, f"Joint {joint}"))


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
    values = check_values(study_at(path), body.get("values"))
    write_whole(path.parent, {file: _json(values)})
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
    files = {"study.toml": snapshot(path).encode(), _START: _json(values)}
    runs.prepare(name)
    command = ["identify", "study.toml", "--out", ".", "--start", _START]
    if held:
        command += ["--set", f"tuning.hold={json.dumps(held)}"]
    return describe(runs.start(name, "identify", [command], "from sliders", files))


def _json(values: Values) -> bytes:
    return json.dumps(parameter_document(values), indent=1).encode()
