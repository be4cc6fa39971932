"""Changes of single keys and tables of a study file; comments, order and layout stay."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from strainwave.domain.results.consistency import Correction
from strainwave.domain.study import KeyKind
from strainwave.errors import InvalidInput
from strainwave.init.draft import TODO
from strainwave.init.units import in_si
from strainwave.io.atomic_files import decode, read_bytes, write_whole

_TODO = re.compile(rf"(?<![\w\"]){TODO}(?![\w\"])")
_HEADER = re.compile(r"\s*\[\[?\s*([\w.-]+)\s*\]\]?\s*(#.*)?$")
_CODE = re.compile(r"""(?:[^#"']|"(?:[^"\\]|\\.)*"|'[^']*')*""")


@dataclass(frozen=True, slots=True)
class KeyChange:
    """One key of the file and its new value, or one table of an array.

    `place` has table names, and for arrays of tables their position from 0: ("joint", 0,
    "gear_ratio"), ("channels", "a1", "scale"), ("options", "links", "order"). At ("experiment", 2)
    a table is inserted, whose value is the text of its lines; at ("experiment", 0, "steps", 1), an
    entry of a list.
    """

    place: tuple[str | int, ...]
    value: Any  # None: the key or table is removed


def edit_study(path: Path, changes: Sequence[KeyChange]) -> None:
    """Apply the changes to a study file, which may still have TODO values.

    Raises InvalidInput if the file is not TOML, or if it has no such array of tables.
    """
    text = changed_text(read_study_text(path), changes, path)
    write_whole(path.parent, {path.name: text.encode()})


def changed_text(text: str, changes: Sequence[KeyChange], path: Path) -> str:
    """The text of a study file with the changes; `path` is for messages."""
    document = parse_draft(text, path)
    lines = text.split("\n")
    for change in changes:
        if len(change.place) == 2 and isinstance(change.place[1], int):
            document = _with_table(document, change, path)
            lines += str(change.value).split("\n")
        else:
            _apply(document, change, path)
    changed = tomlkit.dumps(document)
    is_draft = any(_TODO.search(_split(line)[0]) for line in lines)
    return changed.replace(f'"{TODO}"', TODO) if is_draft else changed


def parse_draft(text: str, path: Path) -> tomlkit.TOMLDocument:
    """A study file as tables; a value that is still TODO is the text "TODO"."""
    lines = [_TODO.sub(f'"{TODO}"', code) + note for code, note in map(_split, text.split("\n"))]
    try:
        return tomlkit.parse("\n".join(lines))
    except (TOMLKitError, ValueError, RecursionError) as error:
        raise InvalidInput(str(error), where=str(path), remedy="correct the text") from error


def read_study_text(path: Path) -> str:
    """The text of a study file; raises InvalidInput if it is not UTF-8."""
    return decode(read_bytes(path, "the study file"), path)


def read_draft(path: Path) -> tomlkit.TOMLDocument:
    """A study file as tables, like `parse_draft`."""
    return parse_draft(read_study_text(path), path)


def table_of(document: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """A table of a draft; empty if it is missing or no table, which the command line reports."""
    table = document.get(name)
    return table if isinstance(table, Mapping) else {}


def tables_of(document: Mapping[str, Any], name: str) -> Sequence[Mapping[str, Any]]:
    """An array of tables of a draft; empty if it is missing or none."""
    tables = document.get(name)
    is_array = isinstance(tables, list) and all(isinstance(each, Mapping) for each in tables)
    return tables if is_array else []  # type: ignore[return-value]


def columns_of(entry: object) -> list[str]:
    """Names of the columns of an entry of [channels]; two for time stamps in two columns."""
    table = entry if isinstance(entry, Mapping) else {"column": entry}
    column = table.get("column")
    if "topic" in table:
        name = f"[{table['name']}]" if "name" in table else ""
        column = f"{table['topic']}.{table.get('field')}{name}"
    return [str(each) for each in (column if isinstance(column, list) else [column]) if each]


def table_spans(lines: Sequence[str], name: str) -> list[tuple[int, int]]:
    """First line and end of each table of an array, with its subtables.

    Comments after a blank line at its end belong to what follows.
    """
    heads = [(k, match[1]) for k, line in enumerate(lines) if (match := _HEADER.match(line))]
    heads = [(k, head) for k, head in heads if not head.startswith(f"{name}.")]
    spans = []
    for (first, head), (following, _) in pairwise([*heads, (len(lines), "")]):
        if head == name:
            end = tail = following
            while not (line := lines[tail - 1].strip()) or line[0] == "#":
                tail -= 1
                end = end if line else tail
            spans.append((first, end))
    return spans


def table_texts(text: str, name: str) -> list[str]:
    """The lines of each table of an array, without its header."""
    lines = text.split("\n")
    return ["\n".join(lines[first + 1 : end]) for first, end in table_spans(lines, name)]


def _with_table(
    document: tomlkit.TOMLDocument, change: KeyChange, path: Path
) -> tomlkit.TOMLDocument:
    """The document with a table of an array inserted or removed; all other lines stay."""
    name, index, is_new = str(change.place[0]), int(change.place[1]), change.value is not None
    lines = tomlkit.dumps(document).rstrip("\n").split("\n")
    spans, tables = table_spans(lines, name), list(tables_of(document.unwrap(), name))
    if len(spans) != len(tables) or not 0 <= index < len(spans) + is_new:
        raise _no_place(change, path)
    if is_new:
        at = spans[index - 1][1] if index else spans[0][0] if spans else len(lines)
        block = [f"[[{name}]]", *str(change.value).strip().split("\n")]
        lines[at:at] = [*block, ""] if spans and not index else ["", *block]
    else:
        first, end = spans[index]
        del lines[first : end + (end < len(lines) and not lines[end].strip())], tables[index]
    changed = parse_draft("\n".join([*lines, ""]), path)
    rest = list(tables_of(changed.unwrap(), name))
    del rest[index : index + is_new]
    if rest != tables:  # a text of several lines that looks like a table
        raise _no_place(change, path)
    return changed


def _split(line: str) -> tuple[str, str]:
    """A line without its comment, and the comment."""
    match = _CODE.match(line)
    end = match.end() if match else 0
    return line[:end], line[end:]


def _apply(table: Any, change: KeyChange, path: Path) -> None:
    *parents, last = change.place
    for position, key in enumerate(parents):
        if isinstance(table, dict) and isinstance(key, str) and key not in table:
            if change.value is None:
                return
            is_list = isinstance(change.place[position + 1], int)
            table[key] = tomlkit.array() if is_list else tomlkit.table()
        try:
            entry = table[key]
        except (LookupError, TypeError) as error:
            raise _no_place(change, path) from error
        if isinstance(entry, str) and parents[0] == "channels" and position == 1:
            table[key] = _inline({"column": entry})  # which "column" stands for
        table = table[key]
    if isinstance(table, list) and isinstance(last, int) and last <= len(table):
        if change.value is not None:
            table.insert(last, change.value)
        elif last < len(table):
            del table[last]
        return
    if not isinstance(table, dict) or not isinstance(last, str):
        raise _no_place(change, path)
    if change.value is None:
        table.pop(last, None)
        return
    try:
        table[last] = _inline(change.value)
    except (TOMLKitError, RecursionError) as error:  # null in a list, or a deep one
        problem = f"{last} has a value that TOML does not have"
        raise InvalidInput(problem, where=str(path), remedy="correct the value") from error


def _inline(value: Any) -> Any:
    """A value whose tuples are lists, and whose tables are written on one line."""
    if isinstance(value, tuple):
        return [_inline(each) for each in value]
    if not isinstance(value, dict):
        return value
    table = tomlkit.inline_table()
    table.update({key: _inline(each) for key, each in value.items()})
    return table


def _no_place(change: KeyChange, path: Path) -> InvalidInput:
    return InvalidInput(f"has no {'.'.join(map(str, change.place))}", where=str(path))


def value_of(text: str, kind: KeyKind, unit: str = "", chosen: str = "") -> Any:
    """The value in an SI unit of a text that a user types; None if it is empty.

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


def correction_changes(text: str, corrections: Sequence[Correction]) -> list[KeyChange]:
    """Changes of a study file that make the corrections of its keys; others are left out."""
    experiments = [e.get("name") for e in tables_of(parse_draft(text, Path()), "experiment")]
    changes = []
    for each in corrections:
        entry: tuple[str | int, ...] = ()
        if each.table == "joint":
            entry = (int(each.entry) - 1,)
        elif each.table == "channels":
            entry = (each.entry,)
        elif each.table == "experiment" and each.entry in experiments:
            entry = (experiments.index(each.entry),)
        elif each.table not in ("arm", "transmission"):
            continue
        place = (each.table, *entry, *each.key.split("."))
        changes.append(KeyChange(place, each.value))
    return changes
