"""The form of a study file: its fields, the missing values, and the arm as far as it is known."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

from tomlkit import TOMLDocument
from tomlkit.items import Whitespace

from strainwave.domain import ArmDescription
from strainwave.domain.arm import gear_laws, kinds
from strainwave.domain.arm.description import Motion
from strainwave.domain.arm.link_sensors import key_texts
from strainwave.domain.study import KeyKind, StudyKey, study_keys
from strainwave.errors import InvalidInput
from strainwave.init.units import FormUnit, form_units, in_si
from strainwave.io.study.reader import Reader
from strainwave.workbench.study_edit import TODO, parse_draft, table_of, tables_of

Place = tuple[str | int, ...]
_MARKDOWN = re.compile(r"`|\[([^]]*)\]\([^)]*\)")  # code, or a link and its text
_SECTIONS = {"": "", "drive": "Gear and drive", "sensors": "Sensors", "placement": "Placement"}
_CHOICES = {
    ("arm", "kind"): tuple(kinds.KINDS),
    ("joint", "spring"): (gear_laws.AUTO, *gear_laws.LAWS),
    ("joint", "motion"): get_args(Motion),
    ("servo", "kind"): ("pi-velocity",),
}
_DRAWN = ("origin", "axis", "motion", "name", "accelerometer_distance", "imu")  # keys of a joint
_ASSUMED_LENGTH = 1.0  # [m] of link 1 in the picture while its length is missing


@dataclass(frozen=True, slots=True)
class Field:
    """The value of a key of one table."""

    place: Place
    value: str  # "" for TODO
    is_missing: bool
    reason: str  # comment of the file: why `init` guesses the value, or where to find it


@dataclass(frozen=True, slots=True)
class Row:
    """A key, with a field of each table."""

    key: StudyKey
    section: str  # heading of the rows that it belongs to
    meaning: str  # in plain text
    choices: tuple[str, ...]
    units: tuple[FormUnit, ...]  # SI first; empty if the unit has no others
    fields: tuple[Field, ...]


@dataclass(frozen=True, slots=True)
class Group:
    """Fields of one table, or of all joints."""

    title: str
    columns: tuple[str, ...]  # titles of the tables
    rows: tuple[Row, ...]


@dataclass(frozen=True, slots=True)
class Missing:
    """A value that the study needs."""

    place: Place
    title: str
    hint: str  # what it is, and where to find it


def form_groups(document: Mapping[str, Any]) -> list[Group]:
    """The form of a study file."""
    arm, joints = table_of(document, "arm"), tables_of(document, "joint")
    is_serial = arm.get("kind") == "serial"
    arm_keys = [
        key
        for key in study_keys()["arm"]
        if key.serial in (None, is_serial)
        and not (key.key == "link_length" and arm.get("kind") != "planar-two-link")
    ]
    is_placed = is_serial and "urdf" not in arm
    keys = {key.key: key for key in study_keys()["joint"] if not key.serial or is_placed}
    for name, (title, unit) in key_texts().items():  # of a link sensor: those of its type
        if any(key.startswith(f"{name}.") for key in keys):
            continue  # a table, whose keys have fields
        text = f"{title[:1].upper()}{title[1:]}"
        keys[name] = replace(keys.get(name, StudyKey(key=name)), title=text, unit=unit)
    if any(joint.get("motion") == "prismatic" for joint in joints):
        unit = "link rad (or m) per motor rad"
        keys["gear_ratio"] = replace(keys["gear_ratio"], unit=unit)
    groups = [_group("Arm", {("arm",): arm}, arm_keys)]
    if joints:
        tables: dict[Place, Any] = {("joint", index): joint for index, joint in enumerate(joints)}
        groups.append(_group("Joints" if len(joints) > 1 else "Joint", tables, keys.values()))
    for name, title in (("servo", "Servo"), ("transmission", "Transmission"), ("channels", "Logs")):
        if name != "transmission" or is_serial:
            groups.append(_group(title, {(name,): table_of(document, name)}, study_keys()[name]))
    return groups


def _group(
    title: str, tables: Mapping[Place, Mapping[str, Any]], keys: Iterable[StudyKey]
) -> Group:
    rows = [
        Row(
            key=key,
            section=_SECTIONS[key.group],
            meaning=_MARKDOWN.sub(r"\1", key.meaning),
            choices=_CHOICES.get((str(next(iter(tables))[0]), key.key), ()),
            units=form_units(si_unit(key)),
            fields=tuple(_field(table, place, key) for place, table in tables.items()),
        )
        for key in sorted(keys, key=lambda key: list(_SECTIONS).index(key.group))
        if key.title
    ]
    return Group(title, tuple(f"Joint {index + 1}" for index in range(len(tables))), tuple(rows))


def si_unit(key: StudyKey) -> str:
    """The unit of a key without its remarks."""
    return key.unit.partition(",")[0]


def _field(table: Mapping[str, Any], place: Place, key: StudyKey) -> Field:
    names = key.key.split(".")
    value: Any = table
    for name in names:
        value = value.get(name) if isinstance(value, Mapping) else None
    is_required = key.default == "required" and (bool(table) or place[0] != "servo")
    return Field(
        place=(*place, *names),
        value=shown(value),
        is_missing=_has_todo(value) or (is_required and value is None),
        reason=comments_of(table).get(names[0], ""),
    )


def missing_values(document: Mapping[str, Any], groups: Iterable[Group]) -> list[Missing]:
    """The required values that the form lacks, then values of other tables that are TODO."""
    missing = []
    for group in groups:
        for row in group.rows:
            for field, column in zip(row.fields, group.columns, strict=True):
                of = f" of {column[0].lower()}{column[1:]}" if len(group.columns) > 1 else ""
                hint = field.reason or row.meaning
                if field.is_missing:
                    missing.append(Missing(field.place, f"{row.key.title}{of}", hint))
    listed = {each.place for each in missing}
    others = (place for place in _todo_places(document, ()) if place not in listed)
    return missing + [_of_other_table(document, place) for place in others if len(place) > 1]


def _of_other_table(document: Mapping[str, Any], place: Place) -> Missing:
    """A missing value of a channel, an experiment or an option."""
    table, name, *inner = place
    entry, owner, key = document[str(table)], str(name), name
    if isinstance(name, int):
        entry, owner, key = entry[name], f"{table} {entry[name].get('name', name + 1)}", inner[0]
    if table == "channels" and not inner:
        inner = ["column"]
    title = " of ".join([*[".".join(map(str, inner))] * bool(inner), owner])
    return Missing((*place[:2], *inner), title, comments_of(entry).get(str(key), ""))


def _has_todo(value: Any) -> bool:
    return next(_todo_places(value, ()), None) is not None


def _todo_places(value: Any, place: Place) -> Iterator[Place]:
    """Places of TODO values; a list of values is one."""
    if isinstance(value, Mapping):
        for key, each in value.items():
            yield from _todo_places(each, (*place, key))
    elif isinstance(value, list) and any(isinstance(each, Mapping) for each in value):
        for index, each in enumerate(value):
            yield from _todo_places(each, (*place, index))
    elif value == TODO or (isinstance(value, list) and TODO in value):
        yield place


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


def value_of(text: str, kind: KeyKind, unit: str = "", chosen: str = "") -> Any:
    """The value in an SI unit of a field's text; None if it is empty.

    Numbers without a unit are in the chosen one. Raises InvalidInput if a number is needed and the
    text is none, or if it has another unit.
    """
    stripped = text.strip()
    if not stripped:
        return None
    if kind not in ("number", "numbers") or stripped in ("unknown", TODO):
        return stripped  # "unknown" is a torque per volt that the records determine
    stripped = in_si(stripped, unit, chosen)
    if kind == "numbers":
        return _numbers(stripped)
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


def drawn_arm(document: TOMLDocument, path: Path) -> tuple[ArmDescription, str]:
    """The arm as far as the study places it, and what its picture assumes.

    Raises InvalidInput if the kind is missing, or if a value that places a joint is wrong.
    """
    known = _known(document.unwrap())
    arm, joints, note = table_of(known, "arm"), tables_of(known, "joint"), ""
    if arm.get("kind") == "planar-two-link" and "link_length" not in arm:
        arm = {**arm, "link_length": _ASSUMED_LENGTH}
        note = f"Link 1 is drawn {_ASSUMED_LENGTH:g} m long: its length is missing."
    elif arm.get("kind") == "serial" and "urdf" not in arm:
        placeless = [k for k, joint in enumerate(joints, 1) if "xyz" not in joint.get("origin", {})]
        if placeless:
            note = f"No position is given of joint {', '.join(map(str, placeless))}: see Placement."
    drawn = [{key: joint[key] for key in _DRAWN if key in joint} for joint in joints]
    tables = [{"spring": gear_laws.RIGID, "gear_ratio": 1.0, **joint} for joint in drawn]
    reader = Reader(path, "")
    return reader.study({"arm": arm, "joint": tables}, "", experiments_exist=False).arm, note


def _known(value: Any) -> Any:
    """A value without the tables' keys that are TODO; None if it is TODO."""
    if isinstance(value, dict):
        return {key: each for key, old in value.items() if (each := _known(old)) is not None}
    if isinstance(value, list) and all(isinstance(each, dict) for each in value):
        return [_known(each) for each in value]
    return None if _has_todo(value) else value
