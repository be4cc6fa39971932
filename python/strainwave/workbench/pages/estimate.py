"""Page "Estimate": stages and options, runs with progress, order and horizon."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import tomlkit
from starlette.requests import Request
from starlette.responses import Response

from strainwave import pipeline
from strainwave.domain.study import Options, option_texts
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.io.atomic_files import decode
from strainwave.io.study import with_options
from strainwave.pipeline import check_stages
from strainwave.report.figures import DOTTED, Axis, Colour, Figure, Line, Panel, Upright
from strainwave.report.plotly_backend import plotly
from strainwave.workbench.pages.check import gate_of, require_open
from strainwave.workbench.pages.runs import describe
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import Body, Routes, message_of, page, study_of, text_of
from strainwave.workbench.workspace import study_at


@dataclass(frozen=True, slots=True)
class OptionRow:
    """One option of the form."""

    name: str  # "links.order"
    text: Mapping[str, str]  # `meaning`, `default` and `reason`
    choices: tuple[str, ...]  # TOML values to choose from; empty: any value
    value: str  # of the study, if it differs from the default


def option_groups(options: Options) -> dict[str, list[OptionRow]]:
    """The form of all options with the values of a study, by the title of their stage."""
    defaults = asdict(Options())
    groups = {}
    for stage, texts in option_texts().items():
        record = getattr(options, stage)
        hints = get_type_hints(type(record), include_extras=False)
        rows = []
        for key, text in texts["options"].items():
            shown, value = "", getattr(record, key)
            if asdict(options)[stage][key] != defaults[stage][key]:
                item = tomlkit.item(list(value) if isinstance(value, tuple) else value)
                shown = str(item.as_string())
            plain = {kind: words.replace("`", "") for kind, words in text.items()}
            rows.append(OptionRow(f"{stage}.{key}", plain, _choices(hints[key]), shown))
        groups[texts["title"]] = rows
    return groups


def option_arguments(values: Mapping[str, Any], study_path: Any) -> list[str]:
    """Arguments `--set` of a form's values; empty values are left out.

    Raises InvalidInput if an option is unknown or its value invalid.
    """
    flags = []
    names = {f"{stage}.{key}" for stage, each in option_texts().items() for key in each["options"]}
    for name, value in values.items():
        if name not in names or not isinstance(value, str):
            raise InvalidInput(f"there is no option {name!r}", where="options")
        if value.strip():
            flags.append(f"{name}={value.strip()}")
    with_options(study_at(study_path), flags)
    return [part for flag in flags for part in ("--set", flag)]


def _choices(hint: Any) -> tuple[str, ...]:
    """The values of a literal or of a truth value."""
    parts = get_args(hint) if get_origin(hint) is not Literal else (hint,)
    if hint is bool or bool in parts:
        return ("true", "false")
    for part in (hint, *parts):
        if get_origin(part) is Literal:
            return tuple(str(value) for value in get_args(part))
    return ()


routes = Routes()

_MAX_SHOWN = 24  # singular values; those of the noise follow


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
        values = np.asarray(model.singular_values, dtype=float)[:_MAX_SHOWN]
        index = np.arange(1.0, len(values) + 1.0)
        line = Line(index, values / values[0], "singular values", Colour.MEASURED, size=7.0)
        order = Upright(model.order + 0.5, f"order {model.order}", dash=DOTTED)
        axis = Axis("singular value / largest", log=True)
        figure = Figure(Axis("number", step=1.0), (Panel(axis, (line,)),), uprights=(order,))
        entry = {"order": model.order, "horizon": model.horizon, "figure": plotly(figure)}
        signals = record.signals
        shown.append(entry | {"experiment": signals.experiment.name, "joint": signals.joint})
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
_SNAPSHOT = "study.toml"


@routes.page("/estimate/{study:path}")
def _show_estimate(request: Request) -> Response:
    path = study_of(request)
    groups = option_groups(study_at(path).options)
    name = Runs(path).free_name("identify")
    return page(request, "estimate", "Estimate", groups=groups, stages=_STAGE_CHOICES, name=name)


@routes.get("/api/estimate/{study:path}")
def estimates(request: Request) -> object:
    """Gate and runs for the page."""
    path = study_of(request)
    gate = gate_of(path)
    runs = Runs(path)
    reason = message_of(request, gate.reason)
    return {
        "gate": {"is_open": gate.is_open, "reason": reason, "state": gate.state},
        "runs": [describe(run) for run in reversed(runs.all("identify"))],
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
    files, note = {_SNAPSHOT: snapshot(path).encode()}, text_of(body, "note", "")
    runs.prepare(name)
    if body.get("figures") is True:
        arguments.append("--figures")
    command = ("identify", _SNAPSHOT, "--out", ".", "--stages", stages, *arguments)
    return describe(runs.start(name, "identify", [command], note, files))


def snapshot(path: Path) -> str:
    """The text of a study file for a folder two levels below, so that a run can be repeated."""
    document = tomlkit.parse(decode(path.read_bytes(), path))
    for experiment in document.get("experiment", []):
        experiment["file"] = _from_below(experiment["file"])
    if "urdf" in document.get("arm", {}):
        document["arm"]["urdf"] = _from_below(document["arm"]["urdf"])
    return tomlkit.dumps(document)


def _from_below(name: str) -> str:
    """A path as seen from a folder two levels below; an absolute one stays."""
    return name if Path(name).is_absolute() else f"../../{name}"
