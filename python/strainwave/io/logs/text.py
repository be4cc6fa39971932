"""Read delimited text: find its encoding, delimiter, decimal sign, header, units, body and end.

Only a text that the fast reader rejects is read again line by line; this also locates a fault.
"""

from __future__ import annotations

import codecs
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs.arrays import arrow_reader, column_values
from strainwave.io.logs.clock_text import stamp_seconds
from strainwave.io.logs.tables import Clock, LogTable
from strainwave.io.logs.text_layout import (
    MISSING,
    PROBE_BYTES,
    Layout,
    cell_kind,
    check_number,
    find_layout,
    split_line,
    text_lines,
)

_PIECE_BYTES = 1 << 25  # [bytes] of text that are read at a time
_OMITTED = {"empty": "no values", "flag": "flags", "text": "text"}  # kind of cells -> content


def open_text(data: bytes, path: Path) -> LogTable:
    """Open delimited text.

    Raises InvalidInput if the text has no rows of numbers, or if two columns have the same name.
    """
    data, assumptions = _to_utf8(data, path)
    if not data or data.isspace():
        raise InvalidInput("is empty", where=str(path), remedy="record the experiment again")
    layout = find_layout(data, path)
    footer, end = _find_footer(data, layout)
    body = _TextRows(data[:end], path, layout)
    names: dict[str, int] = {}
    clocks: dict[str, Clock] = {}
    omitted: dict[str, str] = {}
    for index, (name, kind) in enumerate(zip(layout.names, layout.kinds, strict=True)):
        if kind in ("number", "datetime", "date", "time"):
            names[name] = index
            if kind != "number":
                clocks[name] = kind
        elif name:
            omitted[name] = _OMITTED[kind]
    notes = [*assumptions, *layout.notes]
    if footer:
        notes.append(f"the last {footer} line(s) contain no numbers and are not read")
    units = {name: layout.units[k] for name, k in names.items() if layout.units.get(k)}
    return LogTable(path, list(names), body.read, body.row_name, units, clocks, omitted, notes)


def _to_utf8(data: bytes, path: Path) -> tuple[bytes, list[str]]:
    """Return the text in UTF-8 without byte order mark, and a note if its encoding is assumed."""
    if data.isascii():
        return data, []
    is_utf16 = data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    try:
        return data.decode("utf-16" if is_utf16 else "utf-8-sig").encode(), []
    except UnicodeError as error:
        if is_utf16:
            raise InvalidInput(
                f"is not valid UTF-16 ({error})", where=str(path), remedy="save it as UTF-8"
            ) from error
    return data.decode("latin-1").encode(), ["the text is not UTF-8; it is read as Latin-1"]


# --- Body -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _TextRows:
    data: bytes  # without a note at the end
    path: Path
    layout: Layout

    def read(self, column_names: Sequence[str]) -> dict[str, FloatArray]:
        """Read columns by name; missing values are NaN."""
        import pyarrow as pa
        import pyarrow.csv

        indices = [self.layout.names.index(name) for name in column_names]
        is_number = {k: self.layout.kinds[k] == "number" for k in indices}
        types = {str(k): pa.float64() if is_number[k] else pa.string() for k in indices}
        rows, start = self.data, self.layout.start
        if self.layout.delimiter == " ":
            lines = self.data[start:].splitlines()
            rows, start = b"\n".join(b" ".join(line.split()) for line in lines), 0
        read_options = pa.csv.ReadOptions(
            column_names=[str(k) for k in range(len(self.layout.names))], use_threads=True
        )
        parse_options = pa.csv.ParseOptions(delimiter=self.layout.delimiter)
        convert_options = pa.csv.ConvertOptions(
            column_types=types,
            include_columns=list(types),
            null_values=list(MISSING),
            decimal_point=self.layout.decimal,
        )
        columns: dict[int, Any]
        try:
            table = pa.concat_tables(
                pa.csv.read_csv(arrow_reader(piece), read_options, parse_options, convert_options)
                for piece in _pieces(rows, start)
            )
            columns = {
                k: column_values(column) if is_number[k] else column.to_pylist()
                for k, column in zip(indices, table.columns, strict=True)
            }
        except (pa.ArrowException, ValueError):
            columns = self._read_lines(indices)
        for k in indices:
            if not is_number[k]:
                stamps = [(cell or "").strip() for cell in columns[k]]
                stamps = ["" if stamp in MISSING else stamp for stamp in stamps]
                columns[k] = stamp_seconds(stamps, partial(self._place, k))
        return {
            name: np.asarray(columns[k], dtype=float)
            for name, k in zip(column_names, indices, strict=True)
        }

    def _lines(self) -> list[tuple[int, str]]:
        """Return the lines with rows, and their numbers from 1."""
        lines = text_lines(self.data.rstrip().splitlines())
        first = len(self.layout.head)
        return [(k, line) for k, line in enumerate(lines[first:], first + 1) if line.strip()]

    def _read_lines(self, indices: Sequence[int]) -> dict[int, Any]:
        """Read line by line, and raise InvalidInput at the first invalid line."""
        cells: dict[int, list[Any]] = {index: [] for index in indices}
        n_columns, lines = len(self.layout.names), self._lines()
        for number, line in lines:
            where = f"{self.path}, line {number}"
            fields = split_line(line, self.layout.delimiter)
            if len(fields) < self.layout.width or any(fields[n_columns:]):
                is_cut_off = number == lines[-1][0]
                raise InvalidInput(
                    f"{'the log is truncated: ' if is_cut_off else ''}{len(fields)} values where "
                    f"the header names {self.layout.width} columns",
                    where=where,
                    remedy="delete this line" if is_cut_off else "correct this line",
                )
            fields += [""] * (n_columns - len(fields))
            for index in indices:
                cell: Any = fields[index]
                if self.layout.kinds[index] == "number":
                    place = f"{where}, column {self.layout.names[index]!r}"
                    cell = check_number(cell, self.layout.decimal, place)
                cells[index].append(cell)
        return cells

    def _place(self, index: int, row: int) -> str:
        return f"{self.path}, {self.row_name(row)}, column {self.layout.names[index]!r}"

    def row_name(self, row: int) -> str:
        lines = self._lines()
        return f"line {lines[row][0] if row < len(lines) else row + len(self.layout.head) + 1}"


def _pieces(rows: bytes, start: int) -> Iterator[memoryview]:
    """Whole lines from a position, some MiB at a time; the reader holds a copy of its input."""
    while start < len(rows):
        end = rows.find(b"\n", start + _PIECE_BYTES) + 1 or len(rows)
        yield memoryview(rows)[start:end]
        start = end


def _find_footer(data: bytes, layout: Layout) -> tuple[int, int]:
    """Return the number of lines at the end that are a note, and their position [bytes].

    Blank lines above the note are included.
    """
    first = layout.kinds.index("number")
    end = data[max(layout.start, len(data) - PROBE_BYTES) :].rstrip().splitlines(keepends=True)
    count = 0
    for index, line in enumerate(reversed(text_lines(end[1:]))):
        cells = split_line(line, layout.delimiter)
        if not line.strip():
            continue
        kinds = [cell_kind(cell) for cell in cells]
        starts_as_row = len(cells) > first and kinds[first] in ("number", "empty")
        if layout.is_row(cells) or (
            starts_as_row and (len(cells) >= layout.width or "text" not in kinds)
        ):
            break
        count = index + 1
    size = sum(map(len, end[len(end) - count :]))
    return count, len(data.rstrip()) - size if count else len(data)
