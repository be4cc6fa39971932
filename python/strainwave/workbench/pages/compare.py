"""Page "Compare": results side by side, and predictions of check records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, get_args

import numpy as np
from starlette.requests import Request
from starlette.responses import Response

import strainwave as sw
from strainwave.domain import Parameter, Prediction
from strainwave.domain.keys import label_of
from strainwave.domain.messages import plus_minus
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.export import arm_of
from strainwave.export.linear_models import joint_model
from strainwave.fleet.monitoring import comparison as monitoring
from strainwave.fleet.monitoring.comparison_output import to_document
from strainwave.identification.closed_loop import restrict_to_values
from strainwave.identification.trial_values import ChannelTest, starting_values, window_of
from strainwave.identification.whole_arm.inference.fit_tests import SIGNIFICANCE_LEVEL
from strainwave.io.atomic_files import read_json
from strainwave.io.kept_files import fingerprint, log_of, study_at
from strainwave.io.results import NOT_A_RESULT, rigid_band_of
from strainwave.io.system import relative_path
from strainwave.report.document.blocks import read_figures
from strainwave.report.document.predictions import difference_figure
from strainwave.report.figures.comparison import (
    Scale,
    changes,
    poles_and_zeros,
    ratios,
    step_responses,
)
from strainwave.report.figures.curves import Curve, bode
from strainwave.report.plotly_backend import faded, plotly, whiskers
from strainwave.workbench.pages.by_hand import usable_experiments
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

_SHARED = (
    "The results come from the same logs ({}): their errors are not independent, so that no test"
    " of a difference applies."
)
_MAX_DURATION = 60.0  # [s] of a predicted record


@dataclass(frozen=True, slots=True)
class NamedResult:
    """A result with the name under which it is compared."""

    name: str
    path: Path
    result: sw.Result


def shared_logs(workspace: Workspace, results: Sequence[NamedResult]) -> list[str]:
    """Names of the logs that several results come from, by their studies in the folder."""
    counts = Counter(log for one in results for log in _logs_of(workspace, one))
    return sorted(path.name for path, count in counts.items() if count > 1)


def _logs_of(workspace: Workspace, one: NamedResult) -> set[Path]:
    """Logs of a result by its study, whose path is relative to the run's or the served folder."""
    name = str(one.result.document.get("study", {}).get("path", ""))
    for folder in (one.path.parent, workspace.folder):
        with suppress(InvalidInput):  # the study was deleted, or lies elsewhere
            files = workspace.files_named(workspace.study(str(folder / name)))
            return {path for path in files if path.suffix != ".urdf"}
    return set()


def parameter_rows(
    results: Sequence[NamedResult], *, are_independent: bool = True
) -> list[dict[str, Any]]:
    """One row per parameter: value, interval, and change from the first result if independent."""
    tables = [{p.key: p for p in one.result if p.value is not None} for one in results]
    rows = []
    for key in dict.fromkeys(chain(*tables)):
        estimates = [table.get(key) for table in tables]
        unit = next(p.unit for p in estimates if p is not None)
        first = estimates[0] if are_independent else None
        cells = [_cell(p, None if p is first else first) for p in estimates]
        rows.append({"label": label_of(*key), "unit": unit, "cells": cells})
    return rows


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


def joints_of(results: Sequence[NamedResult]) -> list[int]:
    """Joints that have a linear model of their own in every result."""
    joints = []
    with suppress(InvalidInput):  # a result without parameters
        arms = [arm_of(one.result.document, one.path) for one in results]
        for joint in range(1, min(arm.study.arm.n_joints for arm in arms) + 1):
            with suppress(InvalidInput):
                for arm in arms:
                    joint_model(arm, joint)
                joints.append(joint)
    return joints


def check_fits(results: Sequence[NamedResult]) -> list[dict[str, Any]]:
    """Fits of check records in percent, one row per record and channel."""
    checks = [one.result.checks for one in results]
    rows = dict.fromkeys(
        (name, channel) for each in checks for name in each for channel in each[name]
    )
    return [
        {"record": name, "channel": channel, "fits": [e.get(name, {}).get(channel) for e in checks]}
        for name, channel in rows
    ]


@lru_cache(maxsize=16)
def _predicted(
    study: Path, _stamp: str, record: str, result: Path, _time: int
) -> tuple[Prediction, list[ChannelTest]]:
    """Prediction and residual tests of a record with the values of a result."""
    arm, log = study_at(study).arm, log_of(study, record)
    values = starting_values(arm, result).values
    arm, first = restrict_to_values(Arm.of(arm), values), float(log.time[0])
    band = rigid_band_of(read_json(result, "the result", NOT_A_RESULT))
    span = (first, first + _MAX_DURATION)
    window = window_of(log, span, arm, band or None, exact_at=values)
    prediction = window.predict(values)
    return prediction, window.residual_tests(prediction)


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
    results = _chosen(request, body)
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
    tables = {one.name: one.result for one in results}
    scales: tuple[Scale, ...] = get_args(Scale)
    return {
        "names": [one.name for one in results],
        "rows": parameter_rows(results, are_independent=not shared),
        "intervals": {scale: whiskers(*changes(tables, scale)) for scale in scales},
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
    results, joint = _chosen(request, body), body.get("joint")
    if not isinstance(joint, int):
        raise InvalidInput("the request names no joint", where="joint")
    curves, models = [], {}
    for one in results:
        response = one.result.frequency_response(joint)
        stds = response.magnitude_std, response.phase_std
        curves.append(Curve(one.name, response.frequencies_hz, response.response, *stds))
        models[one.name] = joint_model(arm_of(one.result.document, one.path), joint)
    name = results[0].name
    return {
        "bode": faded(plotly(bode(curves, "")), name),
        "difference": plotly(bode(ratios(curves), "")),
        "step": faded(plotly(step_responses(models)), name),
        "poles": plotly(poles_and_zeros(models)),
    }


@routes.post("/api/compare-record/{study:path}")
def predicted_record(request: Request, body: Body) -> object:
    """Differences and residual tests of a record with the values of each result."""
    path, record = study_of(request), text_of(body, "record")
    log_of(path, record)  # exists
    predictions, tests, notes = dict[str, Prediction](), list[dict[str, Any]](), list[str]()
    for one in _chosen(request, body):
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
    usable = usable_experiments(path)
    return [e.name for e in usable if e.use == "check"] or [e.name for e in usable]


@routes.post("/api/compare-figure/{study:path}")
def report_figure(request: Request, body: Body) -> object:
    """One figure of the reports of all results."""
    key = body.get("key")
    shown = []
    for one in _chosen(request, body):
        figure = read_figures(one.path.parent / "report.html").get(str(key))
        shown.append({"name": one.name, "figure": figure})
    return shown


@routes.post("/api/save-comparison/{study:path}")
def save_comparison(request: Request, body: Body) -> object:
    """Start `strainwave compare`, which writes comparison.json and comparison.html."""
    results = _chosen(request, body)
    runs = Runs(study_of(request))
    name = runs.free_name("compare")
    folder = runs.prepare(name)
    paths = (relative_path(one.path, folder) for one in results)
    command = ("compare", *paths, "--out", ".")
    return describe(runs.start(name, "compare", [command]))


def _chosen(request: Request, body: Body) -> list[NamedResult]:
    """The results of a request by name; raises InvalidInput if they are no two results."""
    paths = body.get("paths")
    workspace, here = workspace_of(request), study_of(request).parent
    if not isinstance(paths, list) or not all(isinstance(path, str) for path in paths):
        raise InvalidInput("no results are chosen", remedy="choose at least two")
    named: dict[str, Path] = {}
    for path in map(workspace.resolve, dict.fromkeys(paths)):
        name = _name(path, here)
        named[name if name not in named else workspace.relative(path.parent)] = path
    if len(named) < 2:
        raise InvalidInput("a comparison needs two results", remedy="choose at least two")
    return [NamedResult(name, path, sw.read_result(path)) for name, path in named.items()]
