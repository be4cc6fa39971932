"""Page "Estimate": stages and options, runs with progress, order and horizon."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from starlette.requests import Request
from starlette.responses import Response

from strainwave import pipeline
from strainwave.domain import RecordModel
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.io.atomic_files import decode, write_whole
from strainwave.pipeline import check_stages
from strainwave.presentation.figures import DOTTED, Axis, Colour, Figure, Line, Panel, Upright
from strainwave.presentation.plotly_backend import plotly
from strainwave.workbench.cached_files import study_at
from strainwave.workbench.gate import gate_of, require_open
from strainwave.workbench.option_form import option_arguments, option_groups
from strainwave.workbench.pages.runs import describe, runs_of
from strainwave.workbench.runs import Run, Runs, status_of
from strainwave.workbench.web import Body, Routes, message_of, page, study_of, text_of

routes = Routes()

_MAX_SHOWN = 24  # singular values; those of the noise follow


def order_figures(path: Path) -> list[dict[str, Any]]:
    """Singular values of the subspace step of each record, with the order and horizon selected.

    Takes as long as the stages rigid and decoupled. Raises NotIdentifiable if no record excites a
    joint with link motion as second output.
    """
    study = study_at(path)
    options = replace(study.options.statespace, method="subspace")
    study = replace(study, options=replace(study.options, statespace=options))
    result = pipeline.identify(study, stages=("rigid", "decoupled"))
    shown = [_entry(record) for record in result.records if record.state_space is not None]
    if not shown:
        raise NotIdentifiable("no record excites a joint such that a state-space model exists")
    return shown


def _entry(record: RecordModel) -> dict[str, Any]:
    model = record.state_space
    assert model is not None
    values = np.asarray(model.singular_values, dtype=float)[:_MAX_SHOWN]
    index = np.arange(1.0, len(values) + 1.0)
    line = Line(index, values / values[0], "singular values", Colour.MEASURED, size=7.0)
    order = Upright(model.order + 0.5, f"order {model.order}", dash=DOTTED)
    axis = Axis("singular value / largest", log=True)
    figure = Figure(Axis("number", step=1.0), (Panel(axis, (line,)),), uprights=(order,))
    return {
        "experiment": record.signals.experiment.name,
        "joint": record.signals.joint,
        "order": model.order,
        "horizon": model.horizon,
        "figure": plotly(figure),
    }


_STAGE_CHOICES = (
    (
        "rigid,decoupled,tuned",
        "All stages",
        "Rigid model, joint models, and the whole arm at once.",
    ),
    (
        "rigid,decoupled",
        "Joint models",
        "Without the fit of the whole arm: faster, wider intervals.",
    ),
    ("rigid", "Rigid model", "Inertias and friction from slow motion; no elasticity."),
)
_SNAPSHOT = "study.toml"


@routes.page("/estimate/{study:path}")
def show_estimate(request: Request) -> Response:
    """The page."""
    path = study_of(request)
    groups = option_groups(study_at(path).options)
    name = Runs(path).free_name("identify")
    return page(request, "estimate", "Estimate", groups=groups, stages=_STAGE_CHOICES, name=name)


@routes.get("/api/estimate/{study:path}")
def estimates(request: Request) -> object:
    """Gate and runs for the page."""
    path = study_of(request)
    gate = gate_of(path)
    runs = runs_of(request)
    shown = [_summary(runs, run) for run in reversed(runs.all("identify"))]
    return {
        "gate": {
            "is_open": gate.is_open,
            "reason": message_of(request, gate.reason),
            "state": gate.state,
        },
        "runs": shown,
        "name": runs.free_name("identify"),
    }


@routes.post("/api/estimate/{study:path}")
def start_estimate(request: Request, body: Body) -> object:
    """Start an identification of a copy of the study, which stays in the run's folder."""
    path = study_of(request)
    require_open(path)
    stages = ",".join(check_stages(text_of(body, "stages", _STAGE_CHOICES[0][0])))
    options = body.get("options", {})
    if not isinstance(options, dict):
        raise InvalidInput("the request has no options", where="request")
    arguments = option_arguments(options, path)
    runs = Runs(path)
    name = text_of(body, "name", "") or runs.free_name("identify")
    folder = runs.prepare(name)
    write_whole(folder, {_SNAPSHOT: snapshot(path).encode()})
    if body.get("figures") is True:
        arguments.append("--figures")
    command = ("identify", _SNAPSHOT, "--out", ".", "--stages", stages, *arguments)
    return describe(runs.start(name, "identify", [command], text_of(body, "note", "")))


def snapshot(path: Path) -> str:
    """The text of a study file for a folder two levels below, so that a run can be repeated."""
    document = tomlkit.parse(decode(path.read_bytes(), path))
    for experiment in document.get("experiment", []):
        experiment["file"] = f"../../{experiment['file']}"
    if "urdf" in document.get("arm", {}):
        document["arm"]["urdf"] = f"../../{document['arm']['urdf']}"
    return tomlkit.dumps(document)


@routes.get("/api/orders/{study:path}")
def show_orders(request: Request) -> object:
    """Singular values of the subspace method for each record that excites a joint."""
    return order_figures(study_of(request))


def _summary(runs: Runs, run: Run) -> dict[str, Any]:
    """A run with its verdict."""
    is_done = run.state == "done"
    return describe(run) | {"status": status_of(runs.path(run.name)) if is_done else None}
