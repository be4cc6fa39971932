"""Page "Estimate": stages and options, the table of results, order and horizon."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import tomlkit
from starlette.requests import Request
from starlette.responses import Response

from strainwave import pipeline
from strainwave.domain import Parameter
from strainwave.domain.messages import plus_minus
from strainwave.domain.study import Options, study_options
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.io.atomic_files import decode
from strainwave.io.kept_files import study_at
from strainwave.io.result_summaries import (
    Summary,
    changed_options,
    key_parameters,
    summary_of,
    toml_text,
)
from strainwave.io.study import with_options
from strainwave.pipeline import check_stages
from strainwave.report.document.elastic import order_figure
from strainwave.report.plotly_backend import plotly
from strainwave.workbench.pages.check import gate_of, require_open
from strainwave.workbench.pages.runs import (
    REPORTS,
    arguments_of,
    describe,
    last_message,
    runs_of,
)
from strainwave.workbench.run_record import Run
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import (
    Body,
    Routes,
    message_of,
    page,
    study_of,
    text_of,
    workspace_of,
)


def option_groups(options: Options) -> dict[str, list[dict[str, Any]]]:
    """The form of all options with the values of a study, by the title of their stage."""
    changed = changed_options(asdict(options))
    groups: dict[str, list[dict[str, Any]]] = {}
    for each in study_options():
        default = "" if each.value is None else toml_text(each.value)
        row = {"option": each, "value": changed.get(each.name, ""), "default": default}
        groups.setdefault(each.stage, []).append(row)
    return groups


def option_arguments(values: Mapping[str, Any], study_path: Path) -> list[str]:
    """Arguments `--set` of a form's values; empty values are left out.

    Raises InvalidInput if an option is unknown or its value invalid; `where` is its name.
    """
    arguments: list[str] = []
    names = {option.name for option in study_options()}
    for name, value in values.items():
        if name not in names or not isinstance(value, str):
            raise InvalidInput(f"there is no option {name!r}", where="options")
        if not value.strip():
            continue
        flag = f"{name}={value.strip()}"
        try:
            with_options(study_at(study_path), [flag])
        except InvalidInput as error:
            remedy = "correct the value, or empty the field"
            raise InvalidInput(error.problem, where=name, remedy=remedy) from error
        arguments += ["--set", flag]
    return arguments


routes = Routes()


@routes.get("/api/orders/{study:path}")
def show_orders(request: Request) -> object:
    """Singular values of the subspace step of each record, with the order and horizon selected.

    Takes as long as the stages rigid and decoupled. Raises NotIdentifiable if no record excites a
    joint with link motion as second output.
    """
    study = study_at(study_of(request))
    options = replace(study.options.statespace, method="subspace")
    study = replace(study, options=replace(study.options, statespace=options))
    result = pipeline.identify(study, stages=("rigid", "decoupled"))
    shown = []
    for record in result.records:
        model = record.state_space
        if model is None:
            continue
        entry = {"experiment": record.signals.experiment.name, "joint": record.signals.joint}
        entry |= {"order": model.order, "horizon": model.horizon}
        shown.append(entry | {"figure": plotly(order_figure(model))})
    if not shown:
        raise NotIdentifiable("no record excites a joint such that a state-space model exists")
    return shown


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
_SNAPSHOT, _RESULT = "study.toml", "result.json"
_READING_TIME = 0.1  # [s] of results in one answer


@routes.page("/estimate/{study:path}")
def _show_estimate(request: Request) -> Response:
    path = study_of(request)
    groups = option_groups(study_at(path).options)
    name = Runs(path).free_name("identify")
    return page(request, "estimate", "Estimate", groups=groups, stages=_STAGE_CHOICES, name=name)


@routes.get("/api/estimate/{study:path}")
def estimates(request: Request) -> object:
    """Gate and runs for the page."""
    runs, gate = runs_of(request), gate_of(study_of(request))
    reason = message_of(request, gate.reason)
    shown = {"is_open": gate.is_open, "reason": reason, "state": gate.state}
    return {"gate": shown, "name": runs.free_name("identify"), **_table(request, runs)}


def _table(request: Request, runs: Runs) -> dict[str, Any]:
    """The newest runs with the parameters that the query names, or else the first key parameters.

    Results are read for a limited time, the newest first; the others are `pending`.
    """
    listed = runs.all()
    limit = time.monotonic() + _READING_TIME
    readable = [run for run in reversed(listed) if run.commands]
    summaries: dict[str, Summary] = {}
    for run in readable:
        if summaries and time.monotonic() > limit:
            break
        summaries[run.name] = summary_of(runs.path(run.name) / _RESULT)
    parameters = [p for one in summaries.values() for p in one.parameters.values()]
    units = {p.label: p.unit for p in parameters}
    columns = [label for label in request.query_params.getlist("column") if label in units]
    columns = columns or key_parameters(parameters)
    rows: list[dict[str, Any]] = []
    rig: Mapping[str, str] = {}
    for run in listed:
        summary = summaries.get(run.name, Summary())
        row = _row(request, runs, run, summary)
        row["cells"] = {each: _cell(summary.parameters.get(each)) for each in columns}
        if rig:
            row["rig"] = {k: v for k, v in summary.rig.items() if v != rig.get(k)}
        rig = summary.rig or rig
        rows.append(row)
    return {
        "units": units,
        "columns": columns,
        "pending": len(readable) - len(summaries),
        "total": runs.count(),
        "runs": rows[::-1],
    }


def _row(request: Request, runs: Runs, run: Run, summary: Summary) -> dict[str, Any]:
    """A run with what it leaves; a damaged one has its record alone."""
    given = arguments_of(run)
    options = dict(text.partition("=")[::2] for text in given.set or ())
    folder = runs.folder / run.name
    reports = (name for name in REPORTS if run.commands and (folder / name).is_file())
    return describe(run) | {
        "message": last_message(runs, run) if run.state == "failed" else summary.fault,
        "report": next(reports, ""),
        "path": workspace_of(request).relative(folder / _RESULT) if summary.parameters else "",
        "rig": {},
        "worst": summary.worst_fit,
        "mean": summary.mean_fit,
        "options": summary.options or options,
        "stages": given.stages,
    }


def _cell(parameter: Parameter | None) -> dict[str, Any] | None:
    """A value with the half-width of its 95 % interval."""
    if parameter is None or parameter.value is None:
        return None
    low, high = parameter.ci95 or (math.nan, math.nan)
    value, half = plus_minus(parameter.value, (high - low) / 2.0)
    return {"value": parameter.value, "text": value, "half": half, "low": low, "high": high}


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
    files, note = {_SNAPSHOT: snapshot(path).encode()}, text_of(body, "note", "")
    try:
        runs.prepare(name)
    except InvalidInput as error:
        raise InvalidInput(error.problem, where="name", remedy=error.remedy) from error
    if body.get("figures") is True:
        arguments.append("--figures")
    command = ("identify", _SNAPSHOT, "--out", ".", "--stages", stages, *arguments)
    return describe(runs.start(name, "identify", [command], note, files))


def snapshot(path: Path) -> str:
    """The text of a study file for a folder two levels below, so that a run can be repeated."""
    document = tomlkit.parse(decode(path.read_bytes(), path))
    experiments = document.get("experiment", [])
    steps = [step for each in experiments for step in each.get("steps", [])]
    for table in (document.get("arm", {}), *experiments, *steps):
        for key in ("file", "urdf"):
            if key in table and not Path(table[key]).anchor:
                table[key] = f"../../{table[key]}"
    return tomlkit.dumps(document)
