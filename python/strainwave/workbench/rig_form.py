"""The tables of a study file as a form: fields with unit, meaning and plausible range."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

from tomlkit.items import Whitespace

from strainwave.domain import gear_laws, kinds
from strainwave.domain.arm import Motion
from strainwave.domain.link_sensors import key_texts
from strainwave.domain.study import KeyKind, StudyKey, study_keys
from strainwave.errors import InvalidInput
from strainwave.workbench.study_edit import TODO, parse_draft, table_of, tables_of

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


@dataclass(frozen=True, slots=True)
class FieldGroup:
    """Fields of one table."""

    title: str
    fields: tuple[Field, ...]


def field_groups(document: Mapping[str, Any]) -> list[FieldGroup]:
    """The form of a study file."""
    arm = table_of(document, "arm")
    is_serial = arm.get("kind") == "serial"
    rows = [
        key
        for key in study_keys()["arm"]
        if key.serial in (None, is_serial)
        and not (key.key == "link_length" and arm.get("kind") == "single-joint")
    ]
    groups = [FieldGroup("Arm", tuple(_fields(arm, ("arm",), rows)))]
    rows = _joint_keys(is_placed=is_serial and "urdf" not in arm)
    for index, joint in enumerate(tables_of(document, "joint")):
        fields = tuple(_fields(joint, ("joint", index), rows))
        groups.append(FieldGroup(f"Joint {index + 1}", fields))
    for name in ("servo", "transmission") if is_serial else ("servo",):
        fields = tuple(_fields(table_of(document, name), (name,), study_keys()[name]))
        groups.append(FieldGroup(name.capitalize(), fields))
    return groups


def _joint_keys(*, is_placed: bool) -> list[StudyKey]:
    """Keys of a joint; titles and units of a link sensor's keys are those of its type."""
    sensors = {
        key: StudyKey(key=key, title=f"{title[:1].upper()}{title[1:]}", unit=unit)
        for key, (title, unit) in key_texts().items()
    }
    known = {key.key: key for key in study_keys()["joint"] if not key.serial or is_placed}
    for key, sensor in sensors.items():
        known[key] = replace(known.get(key, sensor), title=sensor.title, unit=sensor.unit)
    return list(known.values())


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
    if kind == "number":
        # "unknown" is a torque per volt that the records determine
        return stripped if stripped in ("unknown", TODO) else _number(stripped)
    return stripped


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


def _number(text: str) -> float | int | str:
    cleaned = text.strip()
    if cleaned == TODO:
        return cleaned
    try:
        value = float(cleaned)
    except ValueError as error:
        raise InvalidInput(f"{cleaned!r} is not a number", remedy="use a point: 0.25") from error
    if not math.isfinite(value):
        raise InvalidInput(f"{cleaned!r} is not finite")
    is_integer = value.is_integer() and "." not in cleaned and "e" not in cleaned.lower()
    return int(value) if is_integer else value
