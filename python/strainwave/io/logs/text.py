"""Read delimited text: find its encoding, delimiter, decimal sign, header, units, body and end.

Only a text that the fast reader rejects is read again line by line; this also locates a fault.
"""

from __future__ import annotations

import codecs
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs.arrow import arrow_reader, column_values
from strainwave.io.logs.clock_text import stamp_seconds
from strainwave.io.logs.table import Clock, Table
from strainwave.io.logs.text_layout import (
    MISSING,
    PROBE_BYTES,
    Layout,
    cell_kind,
    check_number,
    find_layout,
    read_header,
    split_line,
    text_lines,
)

_OMITTED = {"empty": "no values", "flag": "flags", "text": "text"}  # kind of cells -> content


def open_text(data: bytes, path: Path) -> Table:
    """Open delimited text.

    Raises InvalidInput if the text has no rows of numbers, or if two columns have the same name.
    """
    data, assumptions = _to_utf8(data, path)
    if not data or data.isspace():
        raise InvalidInput("is empty", where=str(path), remedy="record the experiment again")
    layout = find_layout(data, path)
    header = read_header(layout, path)
    body = _Body(data, path, layout, header.names, _count_footer(data, layout))
    names: dict[str, int] = {}
    clocks: dict[str, Clock] = {}
    omitted: dict[str, str] = {}
    for index, (name, kind) in enumerate(zip(header.names, layout.kinds, strict=True)):
        if kind in ("number", "datetime", "date", "time"):
            names[name] = index
            if kind != "number":
                clocks[name] = kind
        elif name:
            omitted[name] = _OMITTED[kind]
    notes = [*assumptions, *header.notes]
    if body.footer:
        notes.append(f"the last {body.footer} line(s) contain no numbers and are not read")
    units = {name: header.units[k] for name, k in names.items() if header.units.get(k)}
    return Table(path, list(names), body.read, body.row_name, units, clocks, omitted, notes)


def _to_utf8(data: bytes, path: Path) -> tuple[bytes, list[str]]:
    """Return the text in UTF-8 without byte order mark, and a note if its encoding is assumed."""
    if data.startswith(codecs.BOM_UTF8):
        data = data[3:]
    encoding = "utf-16" if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else ""
    if not encoding and len(data) % 2 == 0 and data[:4:2].count(0) + data[1:4:2].count(0) == 2:
        # without byte order mark: every other byte is zero
        encoding = {b"\0\0": "utf-16-be"}.get(data[:4:2], "utf-16-le")
    if encoding:
        try:
            return data.decode(encoding).encode(), []
        except UnicodeError as error:
            raise InvalidInput(
                f"is not valid UTF-16 ({error})", where=str(path), remedy="save it as UTF-8"
            ) from error
    if data.isascii():
        return data, []
    try:
        data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1").encode(), ["the text is not UTF-8; it is read as Latin-1"]
    return data, []


# --- Body -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Body:
    """Rows of a text."""

    data: bytes
    path: Path
    layout: Layout
    names: Sequence[str]
    footer: int  # lines at the end without numbers

    def read(self, column_names: Sequence[str]) -> dict[str, FloatArray]:
        """Read columns by name; missing values are NaN."""
        import pyarrow as pa
        import pyarrow.csv

        indices = [self.names.index(name) for name in column_names]
        numbers = [index for index in indices if self.layout.kinds[index] == "number"]
        types = {str(k): pa.float64() if k in numbers else pa.string() for k in indices}
        try:
            table = pa.csv.read_csv(
                arrow_reader(self._rows()),
                read_options=pa.csv.ReadOptions(
                    column_names=[str(k) for k in range(len(self.names))], use_threads=True
                ),
                parse_options=pa.csv.ParseOptions(delimiter=self.layout.delimiter),
                convert_options=pa.csv.ConvertOptions(
                    column_types=types,
                    include_columns=list(types),
                    null_values=list(MISSING),
                    decimal_point=self.layout.decimal,
                ),
            )
            columns = {k: column_values(table[str(k)]) for k in numbers}
            texts = {k: table[str(k)].to_pylist() for k in indices if k not in numbers}
        except (pa.ArrowException, ValueError):
            columns, texts = self._read_lines(indices, numbers)
        for k, cells in texts.items():
            stamps = ["" if cell is None or cell in MISSING else cell.strip() for cell in cells]
            columns[k] = stamp_seconds(stamps, partial(self._place, k))
        return {name: columns[k] for name, k in zip(column_names, indices, strict=True)}

    def _rows(self) -> Any:
        """Return the bytes of the rows, with single delimiters."""
        end = _footer_start(self.data, self.footer)
        rows = memoryview(self.data)[self.layout.start : end]
        if self.layout.delimiter != " ":
            return rows
        text = bytes(rows).replace(b"\t", b" ")
        while b"  " in text:
            text = text.replace(b"  ", b" ")
        for mark in (b"\n", b"\r"):
            text = text.replace(b" " + mark, mark).replace(mark + b" ", mark)
        return text.strip(b" ")

    def _lines(self) -> list[tuple[int, str]]:
        """Return the lines with rows, and their numbers from 1."""
        lines = text_lines(self.data.rstrip().splitlines())
        first = len(self.layout.head)
        last = len(lines) - self.footer if self.footer else len(lines)
        return [(k + 1, lines[k]) for k in range(first, last) if lines[k].strip()]

    def _read_lines(
        self, indices: Sequence[int], numbers: Sequence[int]
    ) -> tuple[dict[int, FloatArray], dict[int, list[str]]]:
        """Read line by line, and raise InvalidInput at the first invalid line."""
        cells: dict[int, list[Any]] = {index: [] for index in indices}
        n_columns, lines = len(self.names), self._lines()
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
                if index in numbers:
                    place = f"{where}, column {self.names[index]!r}"
                    cell = check_number(cell, self.layout.decimal, place)
                cells[index].append(cell)
        return (
            {k: np.asarray(column, dtype=float) for k, column in cells.items() if k in numbers},
            {k: column for k, column in cells.items() if k not in numbers},
        )

    def _place(self, index: int, row: int) -> str:
        return f"{self.path}, {self.row_name(row)}, column {self.names[index]!r}"

    def row_name(self, row: int) -> str:
        """Return the line of a sample."""
        lines = self._lines()
        return f"line {lines[row][0] if row < len(lines) else row + len(self.layout.head) + 1}"


def _count_footer(data: bytes, layout: Layout) -> int:
    """Return the number of lines at the end that are a note, blank lines above it included."""
    first = layout.kinds.index("number")
    lines = text_lines(data[max(layout.start, len(data) - PROBE_BYTES) :].rstrip().splitlines())
    count = 0
    for index, line in enumerate(reversed(lines[1:])):
        cells = split_line(line, layout.delimiter)
        if not line.strip():
            continue
        if layout.is_row(cells):
            break
        kinds = [cell_kind(cell) for cell in cells]
        starts_as_row = len(cells) > first and kinds[first] in ("number", "empty")
        if starts_as_row and (len(cells) >= layout.width or "text" not in kinds):
            break
        count = index + 1
    return count


def _footer_start(data: bytes, n_lines: int) -> int:
    """Return the position of the last lines [bytes]."""
    if not n_lines:
        return len(data)
    end = data[-PROBE_BYTES:]
    size = len(end) - len(end.rstrip())
    return len(data) - size - sum(map(len, end.rstrip().splitlines(keepends=True)[-n_lines:]))
