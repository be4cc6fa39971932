"""Find the delimiter, decimal sign, columns, first row, names and units of a delimited text."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

from strainwave.errors import InvalidInput
from strainwave.io.logs.clock_text import clock_of
from strainwave.io.logs.tables import Clock, check_unique

DELIMITERS = ("\t", ";", ",", "|", " ")
"""Delimiters of columns; the one that gives the most numbers applies, the first of similar ones."""
PROBE_BYTES = 1 << 14  # [bytes] in which the first rows are expected; longer preambles take more
_SAMPLE_LINES = 60  # lines from which the delimiter and the types of the columns are found
_MIN_GAIN = 1.25  # ratio of numbers for which a later delimiter applies; a preamble has few
_LOOKAHEAD_LINES = 3  # lines of which one must be a row for the body to start above
_NUMBER = re.compile(
    r"[+-]?(?:(?:\d+(?:\.\d*|,\d+)?|[.,]\d+)(?:[eE][+-]?\d+)?|inf(?:inity)?)", re.I
)
_SEVERAL = re.compile(r"[-+.\d]+[;,|\s]+[-+.\d]")
MISSING: tuple[str, ...] = ("", "nan", "NaN", "NAN", "-nan", "-nan(ind)", "-1.#IND", "1.#QNAN")
MISSING += ("NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "---", "--", "-")
_FLAGS = frozenset({"true", "false", "on", "off", "yes", "no"})
_MAX_UNIT = 24  # characters of a unit
_COMMENT = re.compile(r"\s*(?:#+\s*|//\s*|%\s+)")
_UNIT_KEYS = re.compile(r"(?:[xy]_)?(?:vertical )?(?:units?|einheit(?:en)?)(?:_label)?:?", re.I)
_UNIT_WORD = (
    r"(?:[numµμkM]?(?:s|m|g|A|V|W|N|Nm|rad|Hz|Pa|J)|cm|us|min|h|deg(?:rees?)?|°|°C|K|rev|rpm|RPM|rps"
    r"|turns?|counts?|cnts?|inc|ticks?|pulses?|LSB|bits?|%|‰|bar|bool|int|kgf|lb|in|samples?"
    r"|(?:milli|micro|nano)?[sS]ec(?:ond)?s?|[sS]equence|[vV]olts?|[aA]mp(?:ere)?s?"
    r"|[nN]ewtons?|[rR]adians?|[cC]elsius|[mM]eters?|Sekunden|Grad)"
)
_UNIT = (
    rf"(?:1/)?{_UNIT_WORD}(?:\s?[*·./^ -]?\s?(?:{_UNIT_WORD}|\^?-?[23²³]))*|[-1]"  # compiled on use
)
_BRACKETED = re.compile(r"^[\[(<](.*)[\])>]$")
CellKind = Clock | Literal["number", "text", "flag", "empty"]


# --- Layout ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Layout:
    """Division of a text into a head and rows of columns."""

    head: Sequence[str]  # lines before the first row
    start: int  # position of the first row [bytes]
    delimiter: str
    decimal: str
    kinds: Sequence[CellKind]  # of each column
    names: Sequence[str] = ()  # of each column; empty for a column without name and values
    units: Mapping[int, str] = field(default_factory=dict)  # of columns
    notes: Sequence[str] = ()  # on the head

    @property
    def width(self) -> int:
        """Number of columns that hold anything."""
        return max(k for k, kind in enumerate(self.kinds) if kind != "empty") + 1

    def is_row(self, cells: Sequence[str]) -> bool:
        """Whether cells are a row of the body: numbers or nothing in each column of numbers."""
        n = len(self.kinds)
        if len(cells) < n or any(cells[n:]):
            return False
        kinds = [
            cell_kind(c) for c, kind in zip(cells, self.kinds, strict=False) if kind == "number"
        ]
        return "number" in kinds and all(kind in ("number", "empty") for kind in kinds)


def find_layout(data: bytes, path: Path) -> Layout:
    """Find the columns, their names and the first row; a long preamble needs more of the text."""
    size = PROBE_BYTES
    while True:
        probe = data[:size].splitlines(keepends=True)
        end: list[bytes] = []
        if size < len(data):  # without the first and last line, which may be cut
            probe.pop()
            end = data[-PROBE_BYTES // 4 :].splitlines()[1:]
        layout = _layout_of(probe, text_lines(end[-_SAMPLE_LINES // 2 :]))
        if layout is not None:
            return _with_names(layout, path)
        if size >= len(data):
            break
        size *= 8
    filled = [number for number, line in enumerate(probe, start=1) if line.strip()]
    raise InvalidInput(
        "there is no row of numbers; rows of numbers that are separated by commas, semicolons, "
        "tabs or blanks are expected here or below",
        where=f"{path}, line {filled[-1] if filled else 1}",
        remedy="export the log as CSV with one row per sample",
    )


def text_lines(lines: Sequence[bytes]) -> list[str]:
    """Decode lines, without their ends."""
    return [line.decode("utf-8", errors="replace").rstrip("\r\n") for line in lines]


def _layout_of(probe: Sequence[bytes], end: Sequence[str]) -> Layout | None:
    lines = text_lines(probe)
    sample = [*filter(str.strip, lines)][-_SAMPLE_LINES:]
    sample += filter(str.strip, end)
    best: list[list[str]] = []
    delimiter, max_numbers = ",", 0
    for candidate in DELIMITERS:
        if not any(candidate in line for line in sample) and candidate != ",":
            continue
        rows = [split_line(line, candidate) for line in sample]
        numbers: Counter[int] = Counter()
        for row in rows:
            numbers[len(row)] += sum(map(_weight, row))
        width, count = max(numbers.items(), key=lambda item: item[1], default=(0, 0))
        if count > _MIN_GAIN * max_numbers:
            best = [row for row in rows if len(row) == width]
            delimiter, max_numbers = candidate, count
    if not best:
        return None
    cells = [cell for row in best for cell in row if _NUMBER.fullmatch(cell)]
    has_comma = any("," in cell for cell in cells) and not any("." in cell for cell in cells)
    layout = Layout((), 0, delimiter, "," if has_comma else ".", _column_kinds(best))
    first = _first_row(lines, layout)
    if first is None:
        return None
    body = [split_line(line, delimiter) for line in [*lines[first : first + _SAMPLE_LINES], *end]]
    kinds = _column_kinds([row for row in body if layout.is_row(row)])
    return replace(layout, head=lines[:first], start=sum(map(len, probe[:first])), kinds=kinds)


def _weight(cell: str) -> int:
    """1 for a number, -1 for several numbers, which need another delimiter."""
    if cell_kind(cell) == "number":
        return 1
    return -1 if _SEVERAL.match(cell) and clock_of(cell) is None else 0


def _first_row(lines: Sequence[str], layout: Layout) -> int | None:
    """Return the index of the first line that is a row and is followed by another one."""
    filled = [index for index, line in enumerate(lines) if line.strip()]
    for place, index in enumerate(filled):
        if layout.is_row(split_line(lines[index], layout.delimiter)):
            following = filled[place + 1 : place + 1 + _LOOKAHEAD_LINES]
            rows = (split_line(lines[other], layout.delimiter) for other in following)
            if not following or any(layout.is_row(row) for row in rows):
                is_header = _is_numbering(split_line(lines[index], layout.delimiter))
                return following[0] if is_header and following else index
    return None


def _is_numbering(cells: Sequence[str]) -> bool:
    """Whether cells are a header of column numbers: 0, 1, 2, ..."""
    numbers = [cell for cell in cells if cell]
    return len(numbers) > 2 and numbers == [str(k) for k in range(len(numbers))]


def _column_kinds(rows: Sequence[Sequence[str]]) -> tuple[CellKind, ...]:
    """Return the most frequent kind in each column, apart from missing values."""
    kinds = []
    for column in zip(*rows, strict=False):
        counts = Counter(cell_kind(cell) for cell in column)
        counts["empty"] = 0
        counts["number"] += 0  # the first of equal counts
        kinds.append(
            max(("number", *counts), key=counts.__getitem__) if any(counts.values()) else "empty"
        )
    return tuple(kinds)


@lru_cache(maxsize=4096)  # the same cells are asked for several times
def cell_kind(cell: str) -> CellKind:
    """Return the kind of a cell's content."""
    if _NUMBER.fullmatch(cell):
        return "number"
    if cell in MISSING:
        return "empty"
    return clock_of(cell) or ("flag" if cell.casefold() in _FLAGS else "text")


def split_line(line: str, delimiter: str) -> list[str]:
    """Split a line into cells without blanks and quotes around them."""
    if delimiter == " ":
        line = " ".join(line.split())
    if '"' not in line:
        return [field.strip() for field in line.split(delimiter)]
    try:
        fields = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        fields = line.split(delimiter)
    return [field.strip() for field in fields]


# --- Header ---------------------------------------------------------------------------------


def _with_names(layout: Layout, path: Path) -> Layout:
    """Find the names and units of the columns in the lines above the first row."""
    units, notes, names = dict[int, str](), list[str](), list[str]()
    for line in layout.head:
        cells = _fit(line, layout, shorter=True) or [""]
        keys = cells[: layout.width : 2]
        if _UNIT_KEYS.fullmatch(cells[0]) and len(layout.kinds) > 1:
            units = {k: cell for k, cell in enumerate(cells) if cell and cell != cells[0]}
        elif cells[0].casefold() == "name" and len(keys) > 1 and len(set(keys)) == 1:
            # pairs of time and value, each below a key, of a TwinCAT scope
            names = [c if k % 2 or not c else f"{cells[k + 1]}.time" for k, c in enumerate(cells)]
            names[0] = "time"
    if not names:
        names, unit_row = _names_of(layout, path, notes)
        units |= unit_row
    names = [
        name or ("" if kind == "empty" else f"data[{k}]")
        for k, (name, kind) in enumerate(zip(names, layout.kinds, strict=True))
    ]
    return replace(layout, names=names, units=units, notes=notes)


def _names_of(layout: Layout, path: Path, notes: list[str]) -> tuple[list[str], dict[int, str]]:
    """Return the names of the columns, empty if they have none, and the units of a row of units."""
    rows, units = _header_rows(layout, path), dict[int, str]()
    if len(rows) > 1 and _is_unit_row(rows[0][1], layout) and _is_name_row(rows[1][1], layout):
        for k, cell in enumerate(rows[0][1]):
            if unit := _BRACKETED.sub(r"\1", cell).strip():
                units[k] = unit
        notes.append(f"line {rows[0][0]} is read as the units")
        rows = rows[1:]
    if not rows:
        notes.append("there is no header; the columns are data[0], data[1], ...")
        return [""] * len(layout.kinds), units
    number, names = rows[0][0], list(rows[0][1])
    counts = Counter(names)
    if len(rows) > 1 and any(counts[name] > 1 for name in names if name):
        group = ""
        for index, upper in enumerate(rows[1][1]):
            group = upper or group  # a merged cell
            if counts[names[index]] > 1 and names[index]:
                names[index] = f"{group} {names[index]}".strip()
    check_unique(list(filter(None, names)), f"{path}, line {number}")
    return names, units


def _header_rows(layout: Layout, path: Path) -> list[tuple[int, list[str]]]:
    """Return the lines above the first row that have its columns, from below; none without header.

    Each has its number in the file and one cell for each column. Raises InvalidInput if the lowest
    is a row with a fault, or has another number of columns.
    """
    rows: list[tuple[int, list[str]]] = []
    for number in range(len(layout.head), 0, -1):
        line = layout.head[number - 1]
        cells = _fit(line, layout, shorter=bool(rows))
        if cells is not None:
            rows.append((number, cells))
        elif line.strip() and not _COMMENT.match(line):
            names = _trimmed(split_line(line, layout.delimiter))
            is_header = number == len(layout.head) and all(
                cell_kind(name) == "text" for name in names
            )
            if is_header and len(names) > 1 and 2 * len(names) >= layout.width:
                raise InvalidInput(
                    f"{len(names)} columns are named, but the rows have {layout.width} values",
                    where=f"{path}, line {number}",
                    remedy="correct this line: one name for each column",
                )
            break
    while rows and not _is_name_row(rows[0][1], layout):
        if len(rows) > 1 and _is_unit_row(rows[0][1], layout):
            break
        number, cells = rows.pop(0)
        if _is_numbering(cells) or number < len(layout.head):
            return []
        for index, kind in enumerate(layout.kinds):
            if kind == "number":
                check_number(
                    cells[index], layout.decimal, f"{path}, line {number}, column {index + 1}"
                )
    return rows


def _fit(line: str, layout: Layout, *, shorter: bool) -> list[str] | None:
    """Split a line of the head into the columns of the body, or return None if it has others."""
    comment = _COMMENT.match(line)
    text = line[comment.end() :] if comment else line
    joined = re.sub(r"\s+(?=[\[(])", "\0", text)  # blanks within `angle [rad]` separate no names
    for delimiter in (layout.delimiter, *DELIMITERS):
        cells = _trimmed(split_line(text, delimiter))
        if delimiter == " " and len(cells) > layout.width:
            cells = [cell.replace("\0", " ") for cell in _trimmed(split_line(joined, delimiter))]
        if cells[-1:] == ["Comment"] and len(cells) == layout.width + 1:  # of LabVIEW
            cells.pop()
        if delimiter == layout.delimiter:
            fits = bool(cells) and len(cells) <= len(layout.kinds)
            fits = fits and (shorter or len(cells) >= layout.width)
        else:
            fits = len(cells) == layout.width > 1 and bool(comment)
        if fits:
            return cells + [""] * (len(layout.kinds) - len(cells))
    return None


def _trimmed(cells: list[str]) -> list[str]:
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def _used(row: Sequence[str], layout: Layout) -> list[str]:
    """Return the cells above columns of values."""
    return [cell for cell, kind in zip(row, layout.kinds, strict=True) if kind != "empty"]


def _is_name_row(row: Sequence[str], layout: Layout) -> bool:
    cells = _used(row, layout)
    texts = [cell for cell in cells if cell_kind(cell) not in ("number", "empty")]
    return 2 * len(texts) >= len(cells) and not any(cell_kind(cell) == "number" for cell in cells)


def _is_unit_row(row: Sequence[str], layout: Layout) -> bool:
    cells = [cell for cell in _used(row, layout) if cell]
    units = [c for c in cells if re.fullmatch(_UNIT, c) or _BRACKETED.match(c)]
    return bool(cells) and 2 * len(units) >= len(cells) and max(map(len, cells)) <= _MAX_UNIT


def check_number(text: str, decimal: str, where: str) -> float:
    """Convert a cell to a number; a missing value is NaN."""
    if text in MISSING:
        return float("nan")
    if not _NUMBER.fullmatch(text) or ("," in text and decimal != ","):
        raise InvalidInput(
            f"{text[:40]!r} is not a number", where=where, remedy="correct the value"
        )
    return float(text.replace(",", "."))
