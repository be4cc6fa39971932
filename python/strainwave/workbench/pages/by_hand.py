"""Page "By hand": sliders for every parameter over measured data."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from starlette.requests import Request
from starlette.responses import Response

from strainwave.domain import (
    ComplexArray,
    FloatArray,
    FrictionTerm,
    Log,
    Parameter,
    Prediction,
    Signals,
    Study,
    channel_parts,
)
from strainwave.domain.arm.assumed_values import OF_LINKS, AssumedValues, assume_missing
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.description import ArmDescription, unit_in
from strainwave.domain.arm.effects import effect_named
from strainwave.domain.arm.kinds.base import LINK_PARAMETERS
from strainwave.domain.arm.link_sensors import constant_of
from strainwave.domain.arm.parameter_table import ParameterDescription, base_name, record_of
from strainwave.domain.arm.parameters import parameter_descriptions
from strainwave.domain.keys import Key, Values, label_of
from strainwave.domain.results.estimates import is_physical
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import resonance
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.export.linear_models import joint_model
from strainwave.export.source import IdentifiedArm
from strainwave.identification.closed_loop import restrict_to_values
from strainwave.identification.joint_model.agreement import motor_response
from strainwave.identification.validation import predict_torques
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.preparation import (
    cutoff_of,
    dataset_of,
    lengthen_steps,
)
from strainwave.io.atomic_files import write_whole
from strainwave.io.parameters import read_assumptions, read_parameters
from strainwave.io.results import response_of, stage_estimates_of
from strainwave.report.document.predictions import prediction_figure
from strainwave.report.figures.curves import Curve, bode
from strainwave.report.plotly_backend import plotly
from strainwave.signals.motor import SignalOptions, motion_bands, prepare_motor_signals
from strainwave.signals.recorded_input import missing_motor_signal
from strainwave.workbench.pages.check import require_open
from strainwave.workbench.pages.estimate import snapshot
from strainwave.workbench.pages.runs import describe
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import Body, Routes, page, study_of, text_of, workspace_of
from strainwave.workbench.workspace import check_name, fingerprint, log_of, study_at

_MAX_POINTS = 600  # of a line
_DECADES = 1.0  # of a Bode plot below the anti-resonance and above the resonance
_N_FREQUENCIES = 160
_DEFAULT_RESONANCE_HZ = 30.0  # where no joint has a linear model
_RANGE_DECADES = 1.0  # of a slider on either side of its start
_ZERO_RANGE = 0.1  # of a slider that starts at zero, over the largest value of its unit
_SIGNAL_BAND = 4.0  # of motor signals over the compared band
_SAMPLES_PER_PERIOD = 8.0  # of the band of motor signals
_MIN_MOTION_TO_NOISE = 3.0  # a channel with less has no fit
_MIN_MOTION_SHARE = 0.02  # of the largest motion of a channel of its kind
_LINK_NAMES = frozenset(f"link_{name}" for name in LINK_PARAMETERS)
_OF_STAGE = "an estimate that the verdict of the result does not confirm"
_OF_RIGID = "the smallest value with which the rigid model fits the records"


def starting_values(study: Study, file: Path) -> AssumedValues:
    """Values of all parameters from a result or a parameter file, also where it has none."""
    given = read_parameters(file)
    document = json.loads(file.read_bytes())
    entries = document.get("parameters") or ()
    known = {(p["name"], p.get("joint")) for p in entries if p.get("value") is not None}
    values, reasons = dict(given), dict[Key, str]()
    if "stages" in document:
        reasons = dict.fromkeys(given.keys() - known, OF_LINKS)  # `standard_parameters`
        for table, reason in (
            (stage_estimates_of(document), _OF_STAGE),
            (read_assumptions(file), _OF_RIGID),
        ):
            added = {k: v for k, v in table.items() if k not in values and is_physical(k[0], v)}
            values |= added
            reasons |= dict.fromkeys(added, reason)
    assumed = assume_missing(values, restrict_to_values(Arm.of(study.arm), values))
    return AssumedValues(assumed.values, {**assumed.reasons, **reasons})


def sliders(study: Study, start: AssumedValues, record: str) -> list[dict[str, Any]]:
    """The values that the simulation of a record needs, with the ranges of their sliders."""
    arm, values = restrict_to_values(Arm.of(study.arm), start.values), start.values
    idle = set(arm.base.links) - set(arm.base.effective)
    keys = [key for key in arm.parameter_names if key in values]
    keys += [k for k in values if constant_of(k) and record_of(k[0]) in ("", record)]
    units = {key: _unit(study, key) for key in keys}
    largest: dict[str, float] = {}
    for key, unit in units.items():
        largest[unit] = max(largest.get(unit, 0.0), abs(values[key]))
    rows = []
    for key, unit in units.items():
        value, text = values[key], parameter_descriptions().get(base_name(key[0]))
        has_sign = not isinstance(text, ParameterDescription) or text.range == "any"
        is_log = value > 0.0 and not has_sign
        factor = 10.0**_RANGE_DECADES
        spread = 2.0 * abs(value) or _ZERO_RANGE * largest[unit] or 1.0
        group = "Link" if key[0] in _LINK_NAMES else "Sensors" if constant_of(key) else "Joint"
        rows.append(
            {
                "label": label_of(*key),
                "name": key[0],
                "joint": key[1],
                "group": f"{group} {key[1]}" if key[1] else "Arm",
                "symbol": text.symbol if text else "",
                "description": text.description if text else "",
                "unit": unit,
                "value": value,
                "low": value / factor if is_log else value - spread if has_sign else 0.0,
                "high": value * factor if is_log else value + spread,
                "is_log": is_log,
                "is_idle": key in idle,  # the motion does not depend on it
                "reason": start.reasons.get(key, ""),
            }
        )
    return rows


def _unit(study: Study, key: Key) -> str:
    constant = constant_of(key)
    return constant.unit if constant else unit_in(study.arm, key)


def check_values(study: Study, entries: object) -> Values:
    """Values of a request; raises InvalidInput for an unknown parameter or no number."""
    values: Values = {}
    for entry in entries if isinstance(entries, list) else [None]:
        if not isinstance(entry, dict):
            raise InvalidInput("the request has no values", where="values")
        name, joint, value = str(entry.get("name")), entry.get("joint"), entry.get("value")
        if not isinstance(joint, int | None):
            raise InvalidInput(f"there is no parameter {label_of(name, joint)}", where="values")
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value):
            raise InvalidInput("is not a number", where=f"the field of {label_of(name, joint)}")
        values[name, joint] = float(value)
    known = restrict_to_values(Arm.of(study.arm), values).parameter_names
    for key in values.keys() - set(known):
        if not constant_of(key):
            raise InvalidInput(f"there is no parameter {label_of(*key)}", where="values")
    return values


@dataclass(frozen=True, slots=True)
class Shown:
    """A window of a record, and the channels that are shown of it."""

    path: Path  # of the study
    experiment: str
    window: tuple[float, float]  # [s]
    channels: tuple[str, ...] = ()  # empty: all
    bandwidth_hz: float | None = None  # of the torques of rigid joints; None: that of the motion


def simulate(shown: Shown, given: Values) -> Prediction:
    """Simulate a record with given parameters; link sensors without their bias.

    Behind rigid gears the torques of the motors are predicted from the measured motion: a motion
    that is simulated from torques drifts away under gravity. Raises NotIdentifiable with a sentence
    if these values cannot be simulated, and InvalidInput if the record cannot be compared.
    """
    stamp, keys = fingerprint(shown.path), frozenset(given)
    arm = restrict_to_values(Arm.of(study_at(shown.path).arm), given)
    values = assume_missing(given, arm).values
    if not any(joint.elastic for joint in arm.joints):
        return _predict_torques(shown, stamp, arm, values)
    record = _prepared(shown.path, stamp, shown.experiment, shown.window, keys)
    kinds = np.array([channel_parts(name)[0] for name in record.channel_names])
    motion = record.measured.std(axis=0)
    # a channel with little motion of its kind only reacts to the motion of others
    largest = np.array([motion[kinds == kind].max() for kind in kinds])
    rests = motion < np.maximum(_MIN_MOTION_TO_NOISE * record.noise, _MIN_MOTION_SHARE * largest)
    columns = [k for k, name in enumerate(record.channel_names) if name in shown.channels]
    columns = columns or list(range(len(kinds)))
    record = replace(
        record,
        channels=tuple(record.channels[k] for k in columns),
        measured=record.measured[:, columns],
        step_error_correction=record.step_error_correction[:, columns],
    )
    try:
        simulated, _ = record.linearise(values, record.start(), ())
    except (NumericalFailure, InvalidInput) as error:
        raise NotIdentifiable(f"these values cannot be simulated: {error}") from error
    if not np.all(np.isfinite(simulated)):
        raise NotIdentifiable("these values cannot be simulated: the motion grows without limit")
    measured = record.advance_measured(values)
    residual = measured - simulated
    of_link = kinds[columns] != "omega_m"  # a sensor on the link has a bias
    residual[:, of_link] -= residual[:, of_link].mean(axis=0)
    errors = np.sqrt(np.mean(residual**2, axis=0))
    fits = 100.0 * (1.0 - errors / np.where(rests[columns], np.nan, motion[columns]))
    return Prediction(
        shown.experiment,
        record.time,
        tuple(record.channel_names),
        measured,
        measured - residual,
        dict(zip(record.channel_names, fits.tolist(), strict=True)),
    )


def _predict_torques(shown: Shown, stamp: str, arm: Arm, values: Values) -> Prediction:
    """Torques of the motors behind rigid gears."""
    signals, bandwidth = _motion(
        shown.path, stamp, shown.experiment, shown.window, shown.bandwidth_hz
    )
    solution = [value_of(column.parts, values) for column in arm.rigid_columns]
    terms = []
    for number, joint in enumerate(arm.joints, start=1):
        for effect in map(effect_named, joint.named_effects):
            size, *shape = (values[name, number] for name in effect.names)
            of_size = Parameter(effect.sizes[0], number, size, None, "", "rigid")
            terms.append(FrictionTerm(effect.name, number, of_size, shape[0] if shape else 0.0))
    return predict_torques(np.array(solution), signals, arm, bandwidth, terms)


@lru_cache(maxsize=6)
def _motion(
    path: Path,
    _stamp: str,
    experiment: str,
    window: tuple[float, float],
    bandwidth_hz: float | None,
) -> tuple[Signals, float]:
    """Motor signals of a window of a record at a low rate, and the bandwidth [Hz] to compare."""
    log, arm = _cut(log_of(path, experiment), window), Arm.of(study_at(path).arm)
    signals = prepare_motor_signals(log, arm)
    if bandwidth_hz is None:
        bands = motion_bands(signals.motor_angle, signals.sample_time, slow=True)
        bandwidth_hz = max(bands, default=signals.bandwidth_hz)
    bandwidth = min(bandwidth_hz, signals.bandwidth_hz)
    wide = SignalOptions(bandwidth_hz=min(_SIGNAL_BAND * bandwidth, signals.bandwidth_hz))
    signals = prepare_motor_signals(log, arm, wide)
    step = max(1, int(1.0 / (_SAMPLES_PER_PERIOD * signals.bandwidth_hz * signals.sample_time)))
    arrays = {
        field.name: value[::step]
        for field in fields(signals)
        if isinstance(value := getattr(signals, field.name), np.ndarray)
        and len(value) == len(signals.time)
    }
    return replace(signals, sample_time=step * signals.sample_time, **arrays), bandwidth


@lru_cache(maxsize=6)
def _prepared(
    path: Path, _stamp: str, experiment: str, window: tuple[float, float], keys: frozenset[Key]
) -> Dataset:
    """A window of a record, filtered and in long integrator steps; `keys` are the parameters."""
    study = study_at(path)
    cut = _cut(log_of(path, experiment), window)
    arm = restrict_to_values(Arm.of(study.arm), dict.fromkeys(keys, 0.0))
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


def joint_response(study: Study, given: Values, joint: int) -> tuple[FloatArray, ComplexArray]:
    """Frequencies [Hz] and response of motor velocity to motor torque of one joint alone.

    Raises InvalidInput if the joint has no linear model with these values.
    """
    arm = restrict_to_values(Arm.of(study.arm), given)
    values = assume_missing(given, arm).values
    identified = IdentifiedArm(replace(study, arm=arm), (), "the sliders", completion=values)
    model = joint_model(identified, joint)
    high = resonance(model).frequency_hz
    f = np.geomspace(high / 10.0 ** (2.0 * _DECADES), high * 10.0**_DECADES, _N_FREQUENCIES)
    return f, motor_response(model.vector, model.gear_ratio, f)


def parameter_document(values: Values) -> dict[str, Any]:
    """Values as a parameter file that the command line reads."""
    entries = [{"name": key[0], "joint": key[1], "value": value} for key, value in values.items()]
    return {"parameters": entries}


routes = Routes()

_START = "start.json"
# of a window; longer ones take longer than a tenth of a second
_MAX_DURATION = 20.0  # [s]
_MAX_JOINT_SECONDS = 35.0  # [s] times joints, behind elastic gears


def longest_window(arm: ArmDescription) -> float:
    """Longest window [s] that follows a slider."""
    is_rigid = len(arm.rigid_joints) == arm.n_joints
    return min(_MAX_DURATION, np.inf if is_rigid else round(_MAX_JOINT_SECONDS / arm.n_joints, 1))


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
    shown = {"records": records, "starts": starts, "joints": range(1, arm.n_joints + 1)}
    is_rigid, duration = len(arm.rigid_joints) == arm.n_joints, longest_window(arm)
    return page(request, "by_hand", "By hand", is_rigid=is_rigid, duration=duration, **shown)


@routes.post("/api/by-hand-begin/{study:path}")
def begin(request: Request, body: Body) -> object:
    """Sliders with the values of a file, and the channels of a record."""
    shown = _shown(request, body)
    study, file = study_at(shown.path), workspace_of(request).resolve(text_of(body, "start"))
    start = starting_values(study, file)
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
    stage = _document(request, body).get("stages", {}).get("rigid") or {}
    window = _window(body, log, longest_window(study_at(path).arm))
    return Shown(path, log.name, window, measured, stage.get("bandwidth_hz"))


def _document(request: Request, body: Body) -> dict[str, Any]:
    """The result at which the sliders start; empty for a parameter file."""
    start = workspace_of(request).resolve(text_of(body, "start"))
    return _result_at(start, start.stat().st_mtime_ns) if start.name == "result.json" else {}


@lru_cache(maxsize=4)
def _result_at(path: Path, _time: int) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path.read_bytes())
    return document


def _bode(request: Request, body: Body, study: Study, values: Values) -> dict[str, Any] | None:
    """Response of a joint with the values, and the measured one of the starting result."""
    joint = body.get("joint")
    if not isinstance(joint, int):
        return None
    try:
        curves = [Curve("sliders", *joint_response(study, values, joint))]
    except InvalidInput:  # rigid, or a joint of a coupled transmission
        return None
    measured = response_of(_document(request, body), joint)
    if measured is not None:
        points = measured.frequencies_hz, measured.response[:, 0, 0]
        curves.insert(0, Curve("measured", *points, true=True))
    return plotly(bode(curves, f"Joint {joint}"))


def _window(body: Body, log: Log, duration: float) -> tuple[float, float]:
    """Window of the record, of at most a duration [s]."""
    begin_time = body.get("from")
    first, last = float(log.time[0]), float(log.time[-1])
    if not isinstance(begin_time, int | float) or not math.isfinite(begin_time):
        begin_time = first
    begin_time = min(max(float(begin_time), first), last)
    return begin_time, min(begin_time + duration, last + log.sample_time)


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
    folder = runs.prepare(name)
    write_whole(folder, {"study.toml": snapshot(path).encode(), _START: _json(values)})
    command = ["identify", "study.toml", "--out", ".", "--start", _START]
    if held:
        command += ["--set", f"tuning.hold={json.dumps(held)}"]
    return describe(runs.start(name, "identify", [command], note="from sliders"))


def _json(values: Values) -> bytes:
    return json.dumps(parameter_document(values), indent=1).encode()
