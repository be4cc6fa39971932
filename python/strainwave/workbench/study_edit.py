"""Changes of single keys of a study file; comments, order and layout stay."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from strainwave.domain.results.consistency import Correction
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import decode, read_bytes, write_whole

TODO = "TODO"
"""What `strainwave init` writes in place of a value that it cannot know."""

_TODO = re.compile(rf"(?<![\w\"]){TODO}(?![\w\"])")
_CODE = re.compile(r"""(?:[^#"']|"(?:[^"\\]|\\.)*"|'[^']*')*""")


@dataclass(frozen=True, slots=True)
class KeyChange:
    """One key of the file and its new value.

    `place` has table names, and for arrays of tables their position from 0: ("joint", 0,
    "gear_ratio"), ("channels", "a1", "scale"), ("options", "links", "order").
    """

    place: tuple[str | int, ...]
    value: Any  # None: the key is removed


def edit_study(path: Path, changes: Sequence[KeyChange]) -> None:
    """Apply the changes to a study file, which may still have TODO values.

    Raises InvalidInput if the file is not TOML, or if it has no such array of tables.
    """
    text = decode(read_bytes(path, "the study file"), path)
    write_whole(path.parent, {path.name: changed_text(text, changes, path).encode()})


def changed_text(text: str, changes: Sequence[KeyChange], path: Path) -> str:
    """The text of a study file with the changes; `path` is for messages."""
    document = parse_draft(text, path)
    for change in changes:
        _apply(document, change, path)
    changed = tomlkit.dumps(document)
    is_draft = any(_TODO.search(_split(line)[0]) for line in text.split("\n"))
    return changed.replace(f'"{TODO}"', TODO) if is_draft else changed


def parse_draft(text: str, path: Path) -> tomlkit.TOMLDocument:
    """A study file as tables; a value that is still TODO is the text "TODO"."""
    lines = [_TODO.sub(f'"{TODO}"', code) + note for code, note in map(_split, text.split("\n"))]
    try:
        return tomlkit.parse("\n".join(lines))
    except (TOMLKitError, ValueError, RecursionError) as error:
        raise InvalidInput(str(error), where=str(path), remedy="correct the text") from error


def table_of(document: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """A table of a draft; empty if it is missing or no table, which the command line reports."""
    table = document.get(name)
    return table if isinstance(table, Mapping) else {}


def tables_of(document: Mapping[str, Any], name: str) -> Sequence[Mapping[str, Any]]:
    """An array of tables of a draft; empty if it is missing or none."""
    tables = document.get(name)
    is_array = isinstance(tables, list) and all(isinstance(each, Mapping) for each in tables)
    return tables if is_array else []  # type: ignore[return-value]


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
            table[key] = tomlkit.table()
        try:
            entry = table[key]
        except (LookupError, TypeError) as error:
            raise _no_place(change, path) from error
        if isinstance(entry, str) and parents[0] == "channels" and position == 1:
            table[key] = tomlkit.inline_table()  # "column" stands for { column = "column" }
            table[key]["column"] = entry
            entry = table[key]
        table = entry
    if not isinstance(table, dict) or not isinstance(last, str):
        raise _no_place(change, path)
    if change.value is None:
        table.pop(last, None)
    else:
        table[last] = change.value


def _no_place(change: KeyChange, path: Path) -> InvalidInput:
    return InvalidInput(f"has no {'.'.join(map(str, change.place))}", where=str(path))


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
        changes.append(KeyChange(place, _plain(each.value)))
    return changes


def _plain(value: Any) -> Any:
    """Tuples as lists."""
    return [_plain(one) for one in value] if isinstance(value, tuple) else value
