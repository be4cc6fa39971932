"""The form of a study file: its fields, their values as typed, and the missing values."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

from tomlkit.items import Whitespace

from strainwave.domain.arm import gear_laws, kinds
from strainwave.domain.arm.description import POSITION, SERVOS, Motion
from strainwave.domain.study import StudyKey, study_keys
from strainwave.init.changes import table_of, tables_of
from strainwave.init.draft import TODO, Place, has_todo, todo_places
from strainwave.init.units import FormUnit, form_units

_MARKDOWN = re.compile(r"`|\[([^]]*)\]\([^)]*\)")  # code, or a link and its text
_SECTIONS = {"": "", "drive": "Gear and drive", "sensors": "Sensors", "placement": "Placement"}
_CHOICES = {
    ("arm", "kind"): tuple(kinds.KINDS),
    ("joint", "spring"): (gear_laws.AUTO, *gear_laws.LAWS),
    ("joint", "motion"): get_args(Motion),
    ("servo", "kind"): SERVOS,
    ("servo", "output"): ("torque", "current", "duty"),
}


@dataclass(frozen=True, slots=True)
class Field:
    """The value of a key of one table."""

    place: Place
    value: str  # "" for TODO
    is_missing: bool
    reason: str  # comment of the file: why `init` guesses the value, or where to find it


@dataclass(frozen=True, slots=True)
class Row:
    """A key, with a field of the table or of each joint."""

    key: StudyKey
    section: str  # heading of the rows that it belongs to
    meaning: str  # in plain text
    choices: tuple[str, ...]
    units: tuple[FormUnit, ...]  # SI first; empty if the unit has no others
    fields: tuple[Field, ...]


def form_groups(document: Mapping[str, Any]) -> dict[str, list[Row]]:
    """The form of a study file: the rows of each group by its title."""
    arm, joints = table_of(document, "arm"), tables_of(document, "joint")
    is_serial, is_planar = arm.get("kind") == "serial", arm.get("kind") == "planar-two-link"
    is_placed = is_serial and "urdf" not in arm
    keys = {**study_keys()}
    keys["arm"] = tuple(
        key
        for key in keys["arm"]
        if key.serial in (None, is_serial) and (is_planar or key.key != "link_length")
    )
    keys["joint"] = tuple(key for key in keys["joint"] if not key.serial or is_placed)
    if table_of(document, "servo").get("kind") == POSITION:
        keys["servo"] = keys["position_servo"]
    if any(joint.get("motion") == "prismatic" for joint in joints):
        ratio = {"gear_ratio": "link rad (or m) per motor rad"}
        keys["joint"] = tuple(replace(k, unit=ratio.get(k.key, k.unit)) for k in keys["joint"])
    sections = [*_SECTIONS]
    tables: dict[str, dict[Place, Any]] = {
        "Arm": {("arm",): arm},
        "Joints" if len(joints) > 1 else "Joint": {("joint", k): j for k, j in enumerate(joints)},
        "Servo": {("servo",): table_of(document, "servo")},
        "Transmission": {("transmission",): table_of(document, "transmission")}
        if is_serial
        else {},
        "Logs": {("channels",): table_of(document, "channels")},
    }
    return {
        title: [
            _row(key, each)
            for key in sorted(keys[name], key=lambda key: sections.index(key.group))
            if key.title
        ]
        for title, each in tables.items()
        for name in {str(place[0]) for place in each}
    }


def _row(key: StudyKey, tables: Mapping[Place, Any]) -> Row:
    return Row(
        key=key,
        section=_SECTIONS[key.group],
        meaning=_MARKDOWN.sub(r"\1", key.meaning),
        choices=_CHOICES.get((str(next(iter(tables))[0]), key.key), ()),
        units=form_units(key.unit.partition(",")[0]),
        fields=tuple(_field(table, place, key) for place, table in tables.items()),
    )


def _field(table: Mapping[str, Any], place: Place, key: StudyKey) -> Field:
    names = key.key.split(".")
    value: Any = table
    for name in names:
        value = value.get(name) if isinstance(value, Mapping) else None
    is_required = key.default == "required" and (bool(table) or place[0] != "servo")
    return Field(
        place=(*place, *names),
        value=shown(value),
        is_missing=has_todo(value) or (is_required and value is None),
        reason=comments_of(table).get(names[0], ""),
    )


def missing_values(document: Mapping[str, Any]) -> dict[Place, str]:
    """Places of required values that the file lacks, with what they are, in the order of the form.

    Values of other tables are missing if they are TODO.
    """
    rows = [row for group in form_groups(document).values() for row in group]
    fields = [(field, row) for row in rows for field in row.fields if field.is_missing]
    missing = {field.place: field.reason or row.meaning for field, row in fields}
    for place in todo_places(document, ()):
        comments = comments_of(document[str(place[0])])
        missing.setdefault(place, comments.get("".join(map(str, place[1:2])), ""))
    return missing


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


def shown(value: Any) -> str:
    """A value as the user types it; empty if all of it is TODO."""
    if value is None or value == TODO:
        return ""
    if isinstance(value, list):
        if all(each == TODO for each in value):
            return ""
        return ", ".join(f"[{shown(v)}]" if isinstance(v, list) else str(v) for v in value)
    return str(value).lower() if isinstance(value, bool) else str(value)
