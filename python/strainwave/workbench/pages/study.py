"""Page "Study": channels, rig data, a picture of the arm, and the file itself."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from starlette.requests import Request
from starlette.responses import Response
from tomlkit.items import Whitespace

from strainwave.domain import channel_names
from strainwave.domain.arm import gear_laws, kinds
from strainwave.domain.arm.description import Motion
from strainwave.domain.arm.link_sensors import key_texts
from strainwave.domain.study import KeyKind, StudyKey, study_keys
from strainwave.errors import InvalidInput
from strainwave.init import count_todos
from strainwave.io.atomic_files import decode, read_bytes, write_whole
from strainwave.io.logs.bags import Bag, is_bag
from strainwave.io.logs.tables import open_table
from strainwave.io.study import read_study
from strainwave.report.document.predictions import unit_of
from strainwave.report.document.rig import arm_picture
from strainwave.report.figures import Axis, Figure, line_panel
from strainwave.report.plotly_backend import plotly
from strainwave.workbench.pages.experiments import experiments_of
from strainwave.workbench.pages.overview import column_names
from strainwave.workbench.study_edit import (
    TODO,
    KeyChange,
    changed_text,
    parse_draft,
    table_of,
    tables_of,
)
from strainwave.workbench.web import (
    Body,
    Routes,
    message_of,
    page,
    study_file_of,
    text_of,
    workspace_of,
)

Place = tuple[str | int, ...]
_MARKDOWN = re.compile(r"`|\[([^]]*)\]\([^)]*\)")  # code, or a link and its text


@dataclass(frozen=True, slots=True)
class Field:
    """One field of the form, with its value."""

    place: Place
    key: StudyKey
    meaning: str  # in plain text
    choices: tuple[str, ...]
    value: str
    is_todo: bool
    reason: str  # comment of the file: why `init` guesses the value, or where to find it


def field_groups(document: Mapping[str, Any]) -> dict[str, list[Field]]:
    """The form of a study file: the fields of each table."""
    arm = table_of(document, "arm")
    is_serial = arm.get("kind") == "serial"
    rows = [
        key
        for key in study_keys()["arm"]
        if key.serial in (None, is_serial)
        and not (key.key == "link_length" and arm.get("kind") == "single-joint")
    ]
    groups = {"Arm": list(_fields(arm, ("arm",), rows))}
    is_placed = is_serial and "urdf" not in arm
    keys = {key.key: key for key in study_keys()["joint"] if not key.serial or is_placed}
    for name, (title, unit) in key_texts().items():  # of a link sensor: those of its type
        text = f"{title[:1].upper()}{title[1:]}"
        keys[name] = replace(keys.get(name, StudyKey(key=name)), title=text, unit=unit)
    for index, joint in enumerate(tables_of(document, "joint")):
        groups[f"Joint {index + 1}"] = list(_fields(joint, ("joint", index), keys.values()))
    for name in ("servo", "transmission") if is_serial else ("servo",):
        table = table_of(document, name)
        groups[name.capitalize()] = list(_fields(table, (name,), study_keys()[name]))
    return groups


def _fields(table: Mapping[str, Any], place: Place, rows: Iterable[StudyKey]) -> Iterator[Field]:
    reasons = comments_of(table)
    choices = {
        ("arm", "kind"): tuple(kinds.KINDS),
        ("joint", "spring"): (gear_laws.AUTO, *gear_laws.LAWS),
        ("joint", "motion"): get_args(Motion),
        ("servo", "kind"): ("pi-velocity",),
    }
    for row in rows:
        keys = row.key.split(".")
        value: Any = table
        for key in keys:
            value = value.get(key) if isinstance(value, Mapping) else None
        if row.title:
            yield Field(
                place=(*place, *keys),
                key=row,
                meaning=_MARKDOWN.sub(r"\1", row.meaning),
                choices=choices.get((str(place[0]), row.key), ()),
                value=_shown(value),
                is_todo=TODO in _shown(value),
                reason=reasons.get(row.key, ""),
            )


def comments_of(table: Mapping[str, Any]) -> dict[str, str]:
    """Comments of a table of tomlkit by key: the lines above the key, or behind its value."""
    comments: dict[str, str] = {}
    above: list[str] = []
    for key, item in getattr(getattr(table, "value", None), "body", []):
        if isinstance(item, Whitespace):
            above = []
            continue
        comment = item.trivia.comment.lstrip("# ")
        if key is None:
            above = [*above, comment] if comment else []
            continue
        comments[key.key] = " ".join([*above, comment]).strip()
        above = []
    return comments


def _shown(value: Any) -> str:
    """A value as the user types it."""
    if value is None:
        return ""
    if isinstance(value, list):
        return ", ".join(f"[{_shown(v)}]" if isinstance(v, list) else _shown(v) for v in value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def value_of(text: str, kind: KeyKind) -> Any:
    """The value of a field's text; None if it is empty.

    Raises InvalidInput if a number is needed and the text is none.
    """
    stripped = text.strip()
    if not stripped:
        return None
    if kind == "numbers":
        return _numbers(stripped)
    if kind != "number" or stripped in ("unknown", TODO):
        return stripped  # "unknown" is a torque per volt that the records determine
    try:
        value = float(stripped)
    except ValueError as error:
        raise InvalidInput(f"{stripped!r} is not a number", remedy="use a point: 0.25") from error
    if not math.isfinite(value):
        raise InvalidInput(f"{stripped!r} is not finite")
    is_integer = value.is_integer() and "." not in stripped and "e" not in stripped.lower()
    return int(value) if is_integer else value


def _numbers(text: str) -> list[Any]:
    """A list of numbers, or of lists of numbers: 1, 2 or [1, 0], [0.2, 1], also in brackets."""
    try:
        value = parse_draft(f"list = [{text}]", Path("value")).unwrap()["list"]
    except InvalidInput as error:
        raise InvalidInput(f"{text!r} is no list of numbers", remedy="write 0, 0, -9.81") from error
    while len(value) == 1 and isinstance(value[0], list):
        value = value[0]
    rows = value if all(isinstance(row, list) for row in value) else [value]
    for entry in (entry for row in rows for entry in row):
        if entry != TODO and (isinstance(entry, bool) or not isinstance(entry, int | float)):
            raise InvalidInput(f"{text!r} is no list of numbers", remedy="write 0, 0, -9.81")
    return list(value)


routes = Routes()


@routes.page("/study/{study:path}")
def _show_study(request: Request) -> Response:
    study_file_of(request)
    return page(request, "study", "Study")


@routes.get("/api/study/{study:path}")
def read_state(request: Request) -> object:
    """The study file as form, text and picture, with its error."""
    return _state(request, study_file_of(request))


@routes.post("/api/study/{study:path}")
def save(request: Request, body: Body) -> object:
    """Write changes of the form, or the whole text, if the file is still the one that was shown."""
    path = study_file_of(request)
    data = read_bytes(path, "the study file")
    if text_of(body, "sha256") != hashlib.sha256(data).hexdigest():
        raise InvalidInput(
            "the study file has changed in the meantime",
            where=path.name,
            remedy="reload the page, and repeat the change",
        )
    typed = text_of(body, "text") if "text" in body else decode(data, path)
    text = (
        changed_text(typed, changes, path)
        if (changes := _changes(body.get("changes", [])))
        else typed
    )
    parse_draft(text, path)
    write_whole(path.parent, {path.name: text.encode()})
    return _state(request, path)


def _changes(entries: object) -> list[KeyChange]:
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
        value = entry.get("value")  # a text of a field, or a value of another study
        value = value_of(value, kind) if isinstance(value, str) else value
        if entry.get("is_list") and isinstance(value, str):
            value = [part.strip() for part in value.split(",")]
        changes.append(KeyChange(tuple(place), value))
    return changes


def _state(request: Request, path: Path) -> dict[str, Any]:
    workspace = workspace_of(request)
    data = read_bytes(path, "the study file")
    text = decode(data, path)
    state: dict[str, Any] = {"sha256": hashlib.sha256(data).hexdigest(), "text": text}
    state |= {"error": None, "arm": None, "groups": [], "experiments": [], "channels": []}
    try:
        document = parse_draft(text, path)
        state["groups"] = [
            {"title": title, "fields": [asdict(field) for field in fields]}
            for title, fields in field_groups(document).items()
        ]
        state["experiments"] = experiments_of(document)
        state["channels"] = _channels(document)
        state["columns"] = _columns(document, partial(workspace.file_of, path))
        state["todos"] = count_todos(text)
        workspace.study(workspace.relative(path))
        state["arm"] = plotly(arm_picture(read_study(path).arm))
    except InvalidInput as error:
        state["error"] = message_of(request, error)
    return state


def _channels(document: Mapping[str, Any]) -> list[dict[str, Any]]:
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


def _columns(document: Mapping[str, Any], file_of: Callable[[str], Path]) -> dict[str, list[str]]:
    columns: dict[str, list[str]] = {}
    for experiment in tables_of(document, "experiment"):
        name = str(experiment.get("name"))
        try:
            columns[name] = column_names(file_of(str(experiment.get("file"))))
        except InvalidInput:
            columns[name] = []
    return columns


@routes.get("/api/preview/{study:path}")
def preview(request: Request) -> object:
    """One column of a log after scaling, over its samples."""
    path, query = study_file_of(request), request.query_params
    document = parse_draft(decode(read_bytes(path, "the study file"), path), path)
    wanted = query.get("experiment")
    named = [e for e in tables_of(document, "experiment") if e.get("name") == wanted]
    if not named:
        raise InvalidInput("there is no such experiment", where=path.name)
    file = workspace_of(request).file_of(path, str(named[0].get("file", "")))
    column = query.get("column", "")
    if is_bag(file):
        tracks, _ = Bag(file).tracks([column])
        values = next(track.columns[column] for track in tracks if column in track.columns)
    else:
        table = open_table(file)
        if column not in table.names:
            raise table.missing_column_error(column, "which the channel needs")
        values = table.read([column])[column]
    entries = (value_of(query.get(key, ""), "number") for key in ("scale", "offset"))
    given = [None if isinstance(entry, str) else entry for entry in entries]
    scale, offset = 1.0 if given[0] is None else given[0], given[1] or 0.0
    channel = query.get("channel", "")
    title = f"{channel} [{'s' if channel == 't' else unit_of(channel)}]"
    panel = line_panel(title, np.arange(float(len(values))), scale * values + offset, column)
    return plotly(Figure(Axis("sample"), (panel,)))
