"""Page "Compare": results side by side, and predictions of check records."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from strainwave.errors import InvalidInput
from strainwave.monitoring import comparison as monitoring
from strainwave.monitoring.comparison_output import to_document
from strainwave.monitoring.result_estimates import read_estimates
from strainwave.presentation.plotly_backend import plotly
from strainwave.workbench import comparison
from strainwave.workbench.comparison import report_figures
from strainwave.workbench.pages.runs import describe
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import Body, Routes, message_of, page, study_of, workspace_of
from strainwave.workbench.workspace import is_runs_folder

routes = Routes()

_MAX_RESULTS = 200  # listed


@routes.page("/compare/{study:path}")
def show_compare(request: Request) -> Response:
    """The page."""
    study_of(request)
    return page(request, "compare", "Compare")


@routes.get("/api/results/{study:path}")
def list_results(request: Request) -> object:
    """Results of the folder, those of this study first."""
    workspace, here = workspace_of(request), study_of(request).parent
    found = {
        path
        for study in map(workspace.study, workspace.studies())
        for folder in (study.parent, Runs(study).folder)
        for path in (*folder.glob("result.json"), *folder.glob("*/result.json"))
    }
    paths = sorted(found, key=lambda p: (not p.is_relative_to(here), -p.stat().st_mtime))
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
    note = ""
    try:
        estimates = read_estimates([one.path for one in results])
        document = to_document(monitoring.compare(estimates))
    except InvalidInput as error:
        note = message_of(request, error)
    first = report_figures(results[0].path.parent / "report.html")
    return {
        "names": [one.name for one in results],
        "rows": comparison.parameter_rows(results),
        "intervals": plotly(comparison.interval_figure(results)),
        "test": document,
        "note": note,
        "joints": comparison.joints_of(results),
        "checks": comparison.check_fits(results),
        "figures": [{"key": key, "title": figure["title"]} for key, figure in first.items()],
    }


@routes.post("/api/compare-joint/{study:path}")
def joint_figures(request: Request, body: Body) -> object:
    """Bode plot, step response, and poles and zeros of a joint in all results."""
    results, joint = _chosen(request, body.get("paths")), body.get("joint")
    if not isinstance(joint, int):
        raise InvalidInput("the request names no joint", where="joint")
    return {
        "bode": plotly(comparison.bode_figure(results, joint)),
        "step": plotly(comparison.step_figure(results, joint)),
        "poles": plotly(comparison.pole_figure(results, joint)),
    }


@routes.post("/api/compare-figure/{study:path}")
def report_figure(request: Request, body: Body) -> object:
    """One figure of the reports of all results."""
    key = body.get("key")
    shown = []
    for one in _chosen(request, body.get("paths")):
        figure = report_figures(one.path.parent / "report.html").get(str(key))
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


def _chosen(request: Request, paths: object) -> list[comparison.NamedResult]:
    workspace, here = workspace_of(request), study_of(request).parent
    if not isinstance(paths, list) or not all(isinstance(path, str) for path in paths):
        raise InvalidInput("no results are chosen", remedy="choose at least two")
    named: dict[str, Path] = {}
    for path in map(workspace.resolve, dict.fromkeys(paths)):
        name = _name(path, here)
        named[name if name not in named else workspace.relative(path.parent)] = path
    return comparison.read_results(named)
