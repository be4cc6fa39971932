"""Page "Study": channels, rig data, a picture of the arm, experiments, and the file itself."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

from starlette.requests import Request
from starlette.responses import Response

from strainwave.domain import FloatArray, Use, channel_names
from strainwave.domain.study import KeyKind
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import decode, read_bytes, write_whole
from strainwave.io.logs.bags import Bag, is_bag
from strainwave.io.logs.tables import open_table
from strainwave.io.study import read_study
from strainwave.presentation.figures import Axis, Colour, Figure, Line, Panel, decimate
from strainwave.presentation.plotly_backend import plotly
from strainwave.presentation.report.arm_picture import arm_picture
from strainwave.presentation.report.predictions import unit_of
from strainwave.workbench.rig_form import comments_of, field_groups, value_of
from strainwave.workbench.study_edit import (
    Change,
    changed_text,
    parse_draft,
    table_of,
    tables_of,
)
from strainwave.workbench.web import Body, Routes, message_of, page, study_of, text_of

routes = Routes()

_EXPERIMENT = (  # key, title, kind, choices, and whether the value is a list of texts
    ("name", "Name", "text", (), False),
    ("file", "File", "text", (), False),
    ("use", "Use", "choice", get_args(Use), False),
    ("joint", "Joint", "number", (), False),
    ("control", "Control", "text", (), True),
    ("start", "Start [s]", "number", (), False),
    ("stop", "Stop [s]", "number", (), False),
)


@routes.page("/study/{study:path}")
def show_study(request: Request) -> Response:
    """The page."""
    study_of(request)
    return page(request, "study", "Study")


@routes.get("/api/study/{study:path}")
def read_state(request: Request) -> object:
    """The study file as form, text and picture, with its error."""
    return _state(request, study_of(request))


@routes.post("/api/study/{study:path}")
def save(request: Request, body: Body) -> object:
    """Write changes of the form, or the whole text, if the file is still the one that was shown."""
    path = study_of(request)
    data = read_bytes(path, "the study file")
    if text_of(body, "sha256") != hashlib.sha256(data).hexdigest():
        raise InvalidInput(
            "the study file has changed in the meantime",
            where=path.name,
            remedy="reload the page, and repeat the change",
        )
    if "text" in body:
        text = text_of(body, "text")
        parse_draft(text, path)
    else:
        text = changed_text(decode(data, path), _changes(body.get("changes")), path)
    write_whole(path.parent, {path.name: text.encode()})
    return _state(request, path)


def _changes(entries: object) -> list[Change]:
    if not isinstance(entries, list):
        raise InvalidInput("the request has no changes", where="request")
    changes = []
    for entry in entries:
        if not isinstance(entry, dict):
            raise InvalidInput("the request has no changes", where="request")
        place: Any = entry.get("place")
        kind: Any = entry.get("kind")
        if kind not in get_args(KeyKind) or not isinstance(place, list) or not place:
            raise InvalidInput("the request has no place", where="request")
        value = value_of(text_of(entry, "value"), kind)
        if entry.get("is_list") and isinstance(value, str):
            value = [part.strip() for part in value.split(",")]
        changes.append(Change(tuple(place), value))
    return changes


def _state(request: Request, path: Path) -> dict[str, Any]:
    data = read_bytes(path, "the study file")
    text = decode(data, path)
    state: dict[str, Any] = {"sha256": hashlib.sha256(data).hexdigest(), "text": text}
    state |= {"error": None, "arm": None, "groups": [], "experiments": [], "channels": []}
    try:
        document = parse_draft(text, path)
        state["groups"] = [asdict(group) for group in field_groups(document)]
        state["experiments"] = _experiments(document)
        state["channels"] = _channels(document)
        state["columns"] = _columns(document, path.parent)
        state["todos"] = sum(f["is_todo"] for group in state["groups"] for f in group["fields"])
        study = read_study(path)
        state["arm"] = plotly(arm_picture(study.arm))
    except InvalidInput as error:
        state["error"] = message_of(request, error)
    return state


def _experiments(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    rows = []
    for index, experiment in enumerate(tables_of(document, "experiment")):
        cells = []
        for key, title, kind, choices, is_list in _EXPERIMENT:
            value = experiment.get(key)
            shown = ", ".join(map(str, value)) if isinstance(value, list) else value
            cells.append(
                {
                    "place": ["experiment", index, key],
                    "title": title,
                    "kind": kind,
                    "choices": choices,
                    "value": "" if shown is None else str(shown),
                    "is_list": is_list,
                }
            )
        rows.append({"name": str(experiment.get("name", "")), "cells": cells})
    return rows


def _channels(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """All channels of the arm with their mapping."""
    mapped = table_of(document, "channels")
    reasons = comments_of(mapped)
    rows = []
    for name in channel_names(len(tables_of(document, "joint"))):
        entry = mapped.get(name)
        table = entry if isinstance(entry, Mapping) else {"column": entry or ""}
        rows.append(
            {
                "channel": name,
                "column": str(table.get("column", "")),
                "scale": str(table.get("scale", "")),
                "offset": str(table.get("offset", "")),
                "unit": "s" if name == "t" else unit_of(name),
                "reason": reasons.get(name, ""),
            }
        )
    return rows


def _columns(document: Mapping[str, Any], folder: Path) -> dict[str, list[str]]:
    """Names of the columns of each log; empty if it cannot be read."""
    columns: dict[str, list[str]] = {}
    for experiment in tables_of(document, "experiment"):
        name, file = str(experiment.get("name")), folder / str(experiment.get("file"))
        try:
            columns[name] = list((Bag(file) if is_bag(file) else open_table(file)).names)
        except InvalidInput:
            columns[name] = []
    return columns


@routes.get("/api/preview/{study:path}")
def preview(request: Request) -> object:
    """One column of a log after scaling, over its samples."""
    path, query = study_of(request), request.query_params
    document = parse_draft(decode(read_bytes(path, "the study file"), path), path)
    wanted = query.get("experiment")
    named = [e for e in tables_of(document, "experiment") if e.get("name") == wanted]
    if not named:
        raise InvalidInput("there is no such experiment", where=path.name)
    file, column = path.parent / str(named[0].get("file", "")), query.get("column", "")
    values = _read_column(file, column)
    scale, offset = (_factor(query.get(k), d) for k, d in (("scale", 1.0), ("offset", 0.0)))
    values = scale * values + offset
    rows = decimate(values)
    line = Line(rows.astype(float), values[rows], column, Colour.MEASURED)
    channel = query.get("channel", "")
    title = f"{channel} [{'s' if channel == 't' else unit_of(channel)}]"
    return plotly(Figure(Axis("sample"), (Panel(Axis(title), (line,)),)))


def _read_column(file: Path, column: str) -> FloatArray:
    if is_bag(file):
        tracks, _ = Bag(file).tracks([column])
        return next(track.columns[column] for track in tracks if column in track.columns)
    table = open_table(file)
    if column not in table.names:
        raise table.missing_column_error(column, "which the channel needs")
    return table.read([column])[column]


def _factor(text: str | None, default: float) -> float:
    value = value_of(text or "", "number")
    return default if value is None or isinstance(value, str) else float(value)
