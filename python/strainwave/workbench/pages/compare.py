"""Page "Compare": results side by side, and predictions of check records."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg
from starlette.requests import Request
from starlette.responses import Response

import strainwave as sw
from strainwave.domain import ComplexArray, Parameter
from strainwave.domain.keys import Key, label_of
from strainwave.domain.messages import plus_minus
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.errors import InvalidInput
from strainwave.export import arm_of
from strainwave.export.linear_models import Matrices, joint_model, state_space
from strainwave.fleet.monitoring import comparison as monitoring
from strainwave.fleet.monitoring.comparison_output import to_document
from strainwave.report.document.blocks import read_figures
from strainwave.report.figures import DASHES, PALETTE, Axis, Figure, Line, Markers, Panel
from strainwave.report.figures.curves import Curve, bode
from strainwave.report.plotly_backend import plotly
from strainwave.workbench.pages.runs import describe
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import Body, Routes, message_of, page, study_of, workspace_of
from strainwave.workbench.workspace import Workspace, is_runs_folder

_PERIODS = 8.0  # of the resonance, in a step response
_STEP_POINTS = 600
_MIN_PENCIL = 1e-10  # of the largest; eigenvalues of smaller ones are at infinity
_SHARED = (
    "The results come from the same logs ({}): their errors are not independent, so that no test"
    " of a difference applies."
)
_MAX_SHOWN_STD = 0.2  # relative; wider intervals would set the scale of the figure


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


def interval_figure(results: Sequence[NamedResult]) -> Figure:
    """Values over those of the first result, with 95 % intervals."""
    marks, keys = [], []
    for parameter in results[0].result:
        estimates = [_estimate(one, parameter.key) for one in results]
        is_narrow = all(
            p and p.value and p.std is not None and p.std < _MAX_SHOWN_STD * abs(p.value)
            for p in estimates
        )
        if parameter.value and is_narrow:
            keys.append((parameter.key, parameter.value))
    names = tuple(label_of(*key) for key, _ in keys)
    for one, colour in zip(results, cycle(PALETTE), strict=False):
        values = [(one.result[key].value or np.nan) / reference for key, reference in keys]
        stds = [(one.result[key].std or np.nan) / abs(reference) for key, reference in keys]
        error = CI95_STDS * np.array(stds)
        marks.append(Markers(names, np.array(values), one.name, colour, 6.0, error=error))
    axis = Axis(f"value / value of {results[0].name}")
    return Figure(Axis(""), (Panel(axis, tuple(marks), 1.6),))


def joints_of(results: Sequence[NamedResult]) -> list[int]:
    """Joints that have a linear model of their own in every result."""
    arms = list(map(_arm, results))
    joints = []
    for joint in range(1, min(len(arm.study.arm.joints) for arm in arms) + 1):
        with suppress(InvalidInput):
            for arm in arms:
                joint_model(arm, joint)
            joints.append(joint)
    return joints


def _arm(one: NamedResult) -> Any:
    return arm_of(one.result.document, one.path)


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


routes = Routes()

_MAX_RESULTS = 200  # listed


@routes.page("/compare/{study:path}")
def _show_compare(request: Request) -> Response:
    study_of(request)
    return page(request, "compare", "Compare")


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
        except InvalidInput as error:
            note = message_of(request, error)
    first = read_figures(results[0].path.parent / "report.html")
    return {
        "names": [one.name for one in results],
        "rows": parameter_rows(results, are_independent=not shared),
        "intervals": plotly(interval_figure(results)),
        "test": document,
        "note": note,
        "joints": joints_of(results),
        "checks": check_fits(results),
        "figures": [{"key": key, "title": figure["title"]} for key, figure in first.items()],
    }


@routes.post("/api/compare-joint/{study:path}")
def joint_figures(request: Request, body: Body) -> object:
    """Bode plot, step response, and poles and zeros of a joint in all results."""
    results, joint = _chosen(request, body.get("paths")), body.get("joint")
    if not isinstance(joint, int):
        raise InvalidInput("the request names no joint", where="joint")
    return {
        "bode": plotly(bode_figure(results, joint)),
        "step": plotly(step_figure(results, joint)),
        "poles": plotly(pole_figure(results, joint)),
    }


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
