"""Page "Compare": results side by side, and predictions of check records."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg
from starlette.requests import Request
from starlette.responses import Response

import strainwave as sw
from strainwave.domain import ComplexArray, Joint, Parameter, Prediction
from strainwave.domain.keys import Key, label_of
from strainwave.domain.messages import plus_minus
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.export import arm_of
from strainwave.export.linear_models import Matrices, joint_model, state_space
from strainwave.fleet.monitoring import comparison as monitoring
from strainwave.fleet.monitoring.comparison_output import to_document
from strainwave.identification.closed_loop import restrict_to_values
from strainwave.identification.trial_values import ChannelTest, starting_values, window_of
from strainwave.identification.whole_arm.inference.fit_tests import SIGNIFICANCE_LEVEL
from strainwave.io.kept_files import fingerprint, log_of, study_at
from strainwave.io.results import rigid_band_of
from strainwave.report.document.blocks import read_figures
from strainwave.report.document.predictions import unit_of
from strainwave.report.figures import DASHES, PALETTE, Axis, Figure, Line, Markers, Panel
from strainwave.report.figures.curves import Curve, Series, bode, lines
from strainwave.report.plotly_backend import plotly, whiskers
from strainwave.signals.recorded_input import missing_motor_signal
from strainwave.workbench.pages.runs import describe
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import (
    HANDLED,
    Body,
    Routes,
    message_of,
    page,
    study_of,
    text_of,
    workspace_of,
)
from strainwave.workbench.workspace import Workspace, is_runs_folder

_PERIODS = 8.0  # of the resonance, in a step response
_STEP_POINTS = 600
_MIN_PENCIL = 1e-10  # of the largest; eigenvalues of smaller ones are at infinity
_SHARED = (
    "The results come from the same logs ({}): their errors are not independent, so that no test"
    " of a difference applies."
)
_MAX_SHOWN_STD = 0.2  # relative; wider intervals would set the scale of the figure
_GHOST_OPACITY = 0.55  # of the lines of other results
_MAX_DURATION = 60.0  # [s] of a predicted record


@dataclass(frozen=True, slots=True)
class NamedResult:
    """A result with the name under which it is compared."""

    name: str
    path: Path
    result: sw.Result


def read_results(paths: Mapping[str, Path]) -> list[NamedResult]:
    """Results by name. Raises InvalidInput for fewer than two, or a file that is no result."""
    if len(paths) < 2:
        raise InvalidInput("a comparison needs two results", remedy="choose at least two")
    return [NamedResult(name, path, sw.read_result(path)) for name, path in paths.items()]


def shared_logs(workspace: Workspace, results: Sequence[NamedResult]) -> list[str]:
    """Names of the logs that several results come from, by their studies in the folder."""
    counts: Counter[Path] = Counter()
    for one in results:
        study = one.result.document.get("study", {})
        with suppress(InvalidInput):  # the study was deleted, or lies elsewhere
            files = workspace.files_named(workspace.study(str(study.get("path", ""))))
            counts.update({path for path in files if path.suffix != ".urdf"})
    return sorted(path.name for path, count in counts.items() if count > 1)


def parameter_rows(
    results: Sequence[NamedResult], *, are_independent: bool = True
) -> list[dict[str, Any]]:
    """One row per parameter: value, interval, and change from the first result if independent."""
    rows = []
    for key in dict.fromkeys(p.key for one in results for p in one.result if p.value is not None):
        estimates = [_estimate(one, key) for one in results]
        unit = next(p.unit for p in estimates if p is not None)
        first = estimates[0] if are_independent else None
        cells = [_cell(p, None if p is first else first) for p in estimates]
        rows.append({"label": label_of(*key), "unit": unit, "cells": cells})
    return rows


def _estimate(one: NamedResult, key: Key) -> Parameter | None:
    return one.result[key] if key in one.result else None  # noqa: SIM401 - it has no `get`


def _cell(parameter: Parameter | None, first: Parameter | None) -> dict[str, Any]:
    """A value with its interval, and its change from the first result in standard deviations."""
    if parameter is None or parameter.value is None:
        return {"text": "", "low": None, "high": None, "change": None}
    low, high = parameter.ci95 or (None, None)
    text = f"{parameter.value:.5g}"
    if parameter.std is not None:
        text = " ± ".join(plus_minus(parameter.value, parameter.std))
    change = None
    if first is not None and first.value is not None:
        spread = float(np.hypot(first.std or 0.0, parameter.std or 0.0))
        change = (parameter.value - first.value) / spread if spread > 0.0 else None
    return {"text": text, "low": low, "high": high, "change": change}


def interval_figure(results: Sequence[NamedResult], scale: str) -> dict[str, Any]:
    """Changes from the first result with 95 % intervals, one row per parameter, by joint.

    `scale` is "percent" of the first value, or "std", standard deviations of the first result.
    """
    rows = [(p, p.value, p.std) for p in results[0].result if p.value and p.std]
    if scale == "percent":
        rows = [row for row in rows if row[2] < _MAX_SHOWN_STD * abs(row[1])]
    rows.sort(key=lambda row: row[0].joint or 0)
    joints = [f"joint {p.joint}" if p.joint else "arm" for p, _, _ in rows]
    sizes = np.array([0.01 * abs(v) if scale == "percent" else std for _, v, std in rows])
    dots = []
    for one in results:
        estimates = [_estimate(one, p.key) for p, _, _ in rows]
        values = [np.nan if p is None or p.value is None else p.value for p in estimates]
        stds = [np.nan if p is None or p.std is None else p.std for p in estimates]
        change = (np.array(values) - np.array([value for _, value, _ in rows])) / sizes
        dots.append(Series(one.name, change, CI95_STDS * np.array(stds) / sizes))
    unit = "%" if scale == "percent" else f"standard deviations of {results[0].name}"
    names = [p.name for p, _, _ in rows]
    return whiskers((joints, names), dots, f"change from {results[0].name} [{unit}]")


def joints_of(results: Sequence[NamedResult]) -> list[int]:
    """Joints that have a linear model of their own in every result."""
    arms, joints = list[Any](), list[int]()
    with suppress(InvalidInput):  # a result without parameters
        arms = list(map(_arm, results))
    for joint in range(1, min((arm.study.arm.n_joints for arm in arms), default=0) + 1):
        with suppress(InvalidInput):
            for arm in arms:
                joint_model(arm, joint)
            joints.append(joint)
    return joints


def _arm(one: NamedResult) -> Any:
    return arm_of(one.result.document, one.path)


def with_ghosts(figure: dict[str, Any], name: str) -> dict[str, Any]:
    """The figure with the lines of all but one result faint and dashed."""
    for trace in figure["data"]:
        if trace.get("name") != name:
            trace["opacity"] = _GHOST_OPACITY
        if "fill" not in trace:
            trace["line"]["dash"] = "solid" if trace.get("name") == name else "6px,4px"
    return figure


def bode_differences(results: Sequence[NamedResult], joint: int) -> Figure:
    """Responses over that of the first result, at its frequencies."""
    responses = [one.result.frequency_response(joint) for one in results]
    f, first = responses[0].frequencies_hz, responses[0].response
    curves = [Curve(results[0].name, f, np.ones_like(first))]
    for one, response in zip(results[1:], responses[1:], strict=True):
        inside = (f >= response.frequencies_hz[0]) & (f <= response.frequencies_hz[-1])
        logarithm = np.log(np.abs(response.response)) + 1j * np.unwrap(np.angle(response.response))
        at = np.interp(np.log(f[inside]), np.log(response.frequencies_hz), logarithm)
        if inside.any():
            curves.append(Curve(one.name, f[inside], np.exp(at) / first[inside]))
    return bode(curves, f"Joint {joint}: responses over that of {results[0].name}")


def bode_figure(results: Sequence[NamedResult], joint: int) -> Figure:
    """Responses of motor velocity to motor torque, with 95 % bands."""
    curves = []
    for one in results:
        response = one.result.frequency_response(joint)
        stds = response.magnitude_std, response.phase_std
        curves.append(Curve(one.name, response.frequencies_hz, response.response, *stds))
    return bode(curves, f"Joint {joint}: motor torque to motor velocity")


def step_figure(results: Sequence[NamedResult], joint: int) -> Figure:
    """Motor and link velocity after a step of the motor torque of 1 N m."""
    from scipy import signal  # takes half a second

    lines: list[list[Line]] = [[], []]
    models = [state_space(_arm(one), joint) for one in results]
    frequencies = [np.abs(np.linalg.eigvals(model.A)).max() / (2.0 * np.pi) for model in models]
    time = np.linspace(0.0, _PERIODS / min(frequencies), _STEP_POINTS)
    styles = zip(results, models, cycle(PALETTE), cycle(DASHES), strict=False)
    for one, model, colour, dash in styles:
        C, D = np.vstack([model.C[0], np.eye(3)[2]]), np.zeros((2, 1))
        _, response = signal.step(signal.StateSpace(model.A, model.B[:, :1], C, D), T=time)
        for panel, velocity in zip(lines, np.asarray(response).T, strict=True):
            panel.append(Line(time, velocity, one.name, colour, dash))
    names = ("motor velocity [rad/s]", "link velocity [rad/s]")
    panels = (Panel(Axis(name), tuple(each)) for name, each in zip(names, lines, strict=True))
    return Figure(Axis("time after a motor torque of 1 N m [s]"), tuple(panels))


def pole_figure(results: Sequence[NamedResult], joint: int) -> Figure:
    """Poles (crosses) and zeros (circles) of motor torque to motor velocity."""
    marks = []
    for one, colour in zip(results, cycle(PALETTE), strict=False):
        model = state_space(_arm(one), joint)
        poles = np.asarray(np.linalg.eigvals(model.A), dtype=np.complex128)
        zeros = _zeros(model)
        pole_name, zero_name = f"{one.name}, poles", f"{one.name}, zeros"
        marks.append(Markers(poles.real, poles.imag, pole_name, colour, 9.0, symbol="x"))
        marks.append(Markers(zeros.real, zeros.imag, zero_name, colour, 9.0, symbol="circle-open"))
    axis = Axis("imaginary part [rad/s]")
    return Figure(Axis("real part [rad/s]"), (Panel(axis, tuple(marks), 2.0),))


def _zeros(model: Matrices) -> ComplexArray:
    """Zeros of motor torque to motor velocity: finite eigenvalues of the system pencil."""
    order = len(model.A)
    system = np.block([[model.A, model.B[:, :1]], [model.C[:1], model.D[:1, :1]]])
    mass = np.zeros_like(system)
    mass[:order, :order] = np.eye(order)
    alpha, beta = linalg.eig(system, mass, right=False, homogeneous_eigvals=True)
    is_finite = np.abs(beta) > _MIN_PENCIL * np.abs(beta).max()
    return np.asarray(alpha[is_finite] / beta[is_finite], dtype=np.complex128)


def check_fits(results: Sequence[NamedResult]) -> list[dict[str, Any]]:
    """Fits of check records in percent, one row per record and channel."""
    rows = dict.fromkeys(
        (record, channel)
        for one in results
        for record, fits in one.result.checks.items()
        for channel in fits
    )
    return [
        {
            "record": record,
            "channel": channel,
            "fits": [one.result.checks.get(record, {}).get(channel) for one in results],
        }
        for record, channel in rows
    ]


@lru_cache(maxsize=16)
def _predicted(
    study: Path, _stamp: str, record: str, result: Path, _time: int
) -> tuple[Prediction, list[ChannelTest]]:
    """Prediction and residual tests of a record with the values of a result."""
    arm, log = study_at(study).arm, log_of(study, record)
    values = starting_values(arm, result).values
    arm, first = restrict_to_values(Arm.of(arm), values), float(log.time[0])
    band, span = rigid_band_of(json.loads(result.read_bytes())), (first, first + _MAX_DURATION)
    window = window_of(log, span, arm, band or None, exact_at=values)
    prediction = window.predict(values)
    return prediction, window.residual_tests(prediction)


def difference_figure(
    predictions: Mapping[str, Prediction], channel: str, joints: Sequence[Joint]
) -> Figure:
    """Simulated minus measured channel of each result over time."""
    series = []
    for name, prediction in predictions.items():
        if channel in prediction.channels:
            k = prediction.channels.index(channel)
            difference = prediction.predicted[:, k] - prediction.measured[:, k]
            series.append(Series(name, prediction.time, difference))
    unit = unit_of(channel, joints)
    return lines(series, "time [s]", f"{channel}, simulated minus measured [{unit}]", "")


def test_row(name: str, test: ChannelTest) -> dict[str, Any]:
    """Cells of the residual tests of one channel and result."""
    by_input, is_white = test.by_input, test.whiteness >= SIGNIFICANCE_LEVEL
    return {
        "channel": test.channel,
        "name": name,
        "deviation": f"{test.deviation:.3g}",
        "noise": f"{test.deviation / test.noise:.3g}" if test.noise else "",
        "is_white": is_white,
        "whiteness": f"p = {test.whiteness:.2g}" if is_white else f"p < {SIGNIFICANCE_LEVEL:g}",
        "is_independent": by_input.probability >= SIGNIFICANCE_LEVEL,
        "input": f"joint {by_input.joint}, r = {by_input.correlation:.2f},"
        f" delay {1e3 * by_input.delay:.3g} ms",
    }


routes = Routes()

_MAX_RESULTS = 200  # listed


@routes.page("/compare/{study:path}")
def _show_compare(request: Request) -> Response:
    study_of(request)
    return page(request, "compare", "Compare", level=SIGNIFICANCE_LEVEL)


@routes.get("/api/results/{study:path}")
def list_results(request: Request) -> object:
    """Results of the folder, those of this study first."""
    workspace, here = workspace_of(request), study_of(request).parent
    studies = map(workspace.study_file, workspace.studies())
    folders = {folder for study in studies for folder in (study.parent, Runs(study).folder)}
    names = ("result.json", "*/result.json")
    found = workspace.files((folder, name) for folder in folders for name in names)
    paths = sorted(found, key=lambda p: not p.is_relative_to(here))
    return [
        {"path": workspace.relative(p), "name": _name(p, here), "own": p.is_relative_to(here)}
        for p in paths[:_MAX_RESULTS]
    ]


def _name(path: Path, here: Path) -> str:
    """Name of a result: its run, with the study's folder if it belongs to another study."""
    folder = path.parent
    if not is_runs_folder(folder.parent.name):
        return folder.name
    study = folder.parent.parent
    return folder.name if study == here else f"{study.name}/{folder.name}"


@routes.post("/api/compare/{study:path}")
def compare(request: Request, body: Body) -> object:
    """Parameters, joint test, and the joints that have figures."""
    results = _chosen(request, body.get("paths"))
    document: dict[str, Any] | None = None
    shared = shared_logs(workspace_of(request), results)
    note = _SHARED.format(", ".join(shared)) if shared else ""
    if not shared:
        try:
            estimates = monitoring.read_estimates([one.path for one in results])
            document = to_document(monitoring.compare(estimates))
        except HANDLED as error:
            note = message_of(request, error)
    first = read_figures(results[0].path.parent / "report.html")
    return {
        "names": [one.name for one in results],
        "rows": parameter_rows(results, are_independent=not shared),
        "intervals": {scale: interval_figure(results, scale) for scale in ("percent", "std")},
        "test": document,
        "note": note,
        "joints": joints_of(results),
        "checks": check_fits(results),
        "records": records_of(study_of(request)),
        "figures": [{"key": key, "title": figure["title"]} for key, figure in first.items()],
    }


@routes.post("/api/compare-joint/{study:path}")
def joint_figures(request: Request, body: Body) -> object:
    """Bode plot, step response, and poles and zeros of a joint in all results."""
    results, joint = _chosen(request, body.get("paths")), body.get("joint")
    if not isinstance(joint, int):
        raise InvalidInput("the request names no joint", where="joint")
    name = results[0].name
    return {
        "bode": with_ghosts(plotly(bode_figure(results, joint)), name),
        "difference": plotly(bode_differences(results, joint)),
        "step": with_ghosts(plotly(step_figure(results, joint)), name),
        "poles": plotly(pole_figure(results, joint)),
    }


@routes.post("/api/compare-record/{study:path}")
def predicted_record(request: Request, body: Body) -> object:
    """Differences and residual tests of a record with the values of each result."""
    path, record = study_of(request), text_of(body, "record")
    log_of(path, record)  # exists
    predictions, tests, notes = dict[str, Prediction](), list[dict[str, Any]](), list[str]()
    for one in _chosen(request, body.get("paths")):
        key = path, fingerprint(path), record, one.path, one.path.stat().st_mtime_ns
        try:
            predictions[one.name], tested = _predicted(*key)
            tests += [test_row(one.name, test) for test in tested]
        except HANDLED as error:
            notes.append(f"{one.name}: {message_of(request, error)}")
    channels = list(dict.fromkeys(c for p in predictions.values() for c in p.channels))
    wanted = body.get("channel")
    channel = wanted if wanted in channels else next(iter(channels), None)
    joints = study_at(path).arm.joints
    figure = plotly(difference_figure(predictions, channel, joints)) if channel else None
    tests.sort(key=lambda row: channels.index(row["channel"]))
    shown = {"channels": channels, "channel": channel, "difference": figure}
    return {**shown, "tests": tests, "notes": notes}


def records_of(path: Path) -> list[str]:
    """Records of a study that can be predicted: its check records, or all if there are none."""
    study, arm = study_at(path), Arm.of(study_at(path).arm)
    usable = [
        e for e in study.experiments if missing_motor_signal(arm, log_of(path, e.name)) is None
    ]
    return [e.name for e in usable if e.use == "check"] or [e.name for e in usable]


@routes.post("/api/compare-figure/{study:path}")
def report_figure(request: Request, body: Body) -> object:
    """One figure of the reports of all results."""
    key = body.get("key")
    shown = []
    for one in _chosen(request, body.get("paths")):
        figure = read_figures(one.path.parent / "report.html").get(str(key))
        shown.append({"name": one.name, "figure": figure})
    return shown


@routes.post("/api/save-comparison/{study:path}")
def save_comparison(request: Request, body: Body) -> object:
    """Start `strainwave compare`, which writes comparison.json and comparison.html."""
    results = _chosen(request, body.get("paths"))
    runs = Runs(study_of(request))
    name = runs.free_name("compare")
    folder = runs.prepare(name)
    paths = (os.path.relpath(one.path, folder) for one in results)
    command = ("compare", *paths, "--out", ".")
    return describe(runs.start(name, "compare", [command]))


def _chosen(request: Request, paths: object) -> list[NamedResult]:
    workspace, here = workspace_of(request), study_of(request).parent
    if not isinstance(paths, list) or not all(isinstance(path, str) for path in paths):
        raise InvalidInput("no results are chosen", remedy="choose at least two")
    named: dict[str, Path] = {}
    for path in map(workspace.resolve, dict.fromkeys(paths)):
        name = _name(path, here)
        named[name if name not in named else workspace.relative(path.parent)] = path
    return read_results(named)
