"""Page "Study": channels, rig data, a picture of the arm, and the file itself."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from typing import Any, get_args

import numpy as np
from starlette.requests import Request
from starlette.responses import Response
from tomlkit import TOMLDocument

from strainwave.domain import Joint, channel_names
from strainwave.domain.arm.gear_laws import RIGID
from strainwave.domain.study import KeyKind
from strainwave.errors import InvalidInput
from strainwave.init.changes import (
    KeyChange,
    changed_text,
    parse_draft,
    table_of,
    tables_of,
    value_of,
)
from strainwave.init.draft import placed_arm
from strainwave.init.units import form_units
from strainwave.io.atomic_files import decode, read_bytes, write_whole
from strainwave.io.logs.columns import read_columns
from strainwave.io.study import read_study
from strainwave.report.document.predictions import unit_of
from strainwave.report.document.rig import arm_picture, describe_arm
from strainwave.report.figures import Axis, Figure, line_panel
from strainwave.report.plotly_backend import plotly
from strainwave.workbench.pages.experiments import experiments_of
from strainwave.workbench.pages.overview import columns_by_record, log_path, named_record
from strainwave.workbench.study_form import (
    comments_of,
    form_groups,
    missing_values,
    shown,
)
from strainwave.workbench.web import (
    Body,
    Routes,
    message_of,
    page,
    study_file_of,
    study_of,
    text_of,
    workspace_of,
)

routes = Routes()


@routes.page("/study/{study:path}")
def _show_study(request: Request) -> Response:
    study_file_of(request)
    return page(request, "study", "Study")


@routes.get("/api/study/{study:path}")
def read_state(request: Request) -> object:
    """The study file as form, text and picture, with its error."""
    path = study_file_of(request)
    data = read_bytes(path, "the study file")
    text = decode(data, path)
    state: dict[str, Any] = {"sha256": hashlib.sha256(data).hexdigest(), "text": text}
    state |= {"error": None, "arm": None, "groups": [], "experiments": [], "channels": []}
    state |= {"missing": [], "columns": {}}
    try:
        document = parse_draft(text, path)
        state["groups"] = [
            {"title": title, "rows": [asdict(row) for row in rows]}
            for title, rows in form_groups(document).items()
        ]
        missing = missing_values(document).items()
        state["missing"] = [{"place": place, "hint": hint} for place, hint in missing]
        state["experiments"] = experiments_of(document)
        state["channels"] = _channels(document)
        state["columns"] = columns_by_record(request, document)
        with suppress(InvalidInput):  # the study itself has the message
            state |= _picture(request, document)
        read_study(study_of(request))
    except InvalidInput as error:
        state["error"] = message_of(request, error)
    return state


def _picture(request: Request, document: TOMLDocument) -> dict[str, Any]:
    """The picture of the arm and its caption, also while values are missing."""
    path = study_file_of(request)
    if urdf := table_of(document, "arm").get("urdf"):
        workspace_of(request).file_of(path, str(urdf))
    arm, note = placed_arm(document.unwrap(), path)
    return {"arm": plotly(arm_picture(arm)), "caption": f"{describe_arm(arm)} {note}"}


@routes.post("/api/study/{study:path}")
def save(request: Request, body: Body) -> object:
    """Write changes of the form, or the whole text, if the file is still the one that was shown."""
    path = study_file_of(request)
    data = read_bytes(path, "the study file")
    if text_of(body, "sha256") != hashlib.sha256(data).hexdigest():
        raise InvalidInput(
            "the study file has changed in the meantime",
            where=path.name,
            remedy='press "Reload", and repeat the change',
        )
    text = text_of(body, "text") if "text" in body else decode(data, path)
    if changes := _changes(body.get("changes", [])):
        text = changed_text(text, changes, path)
    parse_draft(text, path)
    write_whole(path.parent, {path.name: text.encode()})
    return read_state(request)


def _changes(entries: object) -> list[KeyChange]:
    if not isinstance(entries, list) or not all(isinstance(each, dict) for each in entries):
        raise InvalidInput("the request has no changes", where="request")
    changes = []
    for entry in entries:
        place, kind = entry.get("place"), entry.get("kind")
        if kind not in get_args(KeyKind) or not isinstance(place, list) or not place:
            raise InvalidInput("the request has no place", where="request")
        value = entry.get("value")  # a text of a field, or a value of another study
        if isinstance(value, str):
            units = (text_of(entry, key, "") for key in ("unit", "chosen"))
            value = value_of(value, kind, *units)
        if entry.get("is_list") and isinstance(value, str):
            value = [part.strip() for part in value.split(",")]
        changes.append(KeyChange(tuple(place), value))
    return changes


def _channels(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    mapped = table_of(document, "channels")
    reasons = comments_of(mapped)
    motions = [joint.get("motion") for joint in tables_of(document, "joint")]
    joints = [Joint(RIGID, 1.0, "prismatic" if m == "prismatic" else "revolute") for m in motions]
    has_servo = table_of(document, "servo").get("kind") == "position"
    rows = []
    for name in channel_names(len(joints)):
        entry = mapped.get(name)
        table = entry if isinstance(entry, Mapping) else {"column": entry or ""}
        rows.append(
            {
                "channel": name,
                **{key: shown(table.get(key)) for key in ("column", "scale", "offset")},
                "unit": (unit := unit_of(name, joints, commands_angles=has_servo)),
                "units": [asdict(each) for each in form_units(unit)],
                "reason": reasons.get(name, ""),
            }
        )
    return rows


@routes.get("/api/preview/{study:path}")
def preview(request: Request) -> object:
    """One column of a log after scaling, over its samples."""
    query = request.query_params
    column, channel = query.get("column", ""), query.get("channel", "")
    _, record = named_record(request)
    values = dict(read_columns(log_path(request, record), [column]))[column]
    unit = unit_of(channel)
    entries = (value_of(query.get(key, ""), "number", unit) for key in ("scale", "offset"))
    given = [None if isinstance(entry, str) else entry for entry in entries]
    scale, offset = 1.0 if given[0] is None else given[0], given[1] or 0.0
    title = f"{channel} [{unit}]"
    panel = line_panel(title, np.arange(float(len(values))), scale * values + offset, column)
    return plotly(Figure(Axis("sample"), (panel,)))
