"""Columns of named arrays, also within structs and records.

The columns of a matrix are found whichever way it is stored.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs.clock_text import clock_of, stamp_seconds
from strainwave.io.logs.tables import Clock, LogTable, check_unpacked_size

_MAX_LIST_COLUMNS = 256  # of a list or matrix; images and point clouds have more
_MAX_STEP_CHANGE = 0.5  # of a clock, relative to its median step
_MIN_EVEN_SHARE = 0.9  # share of the steps of a clock within that range
# by kind of NumPy's types
_OTHER_KINDS = {"b": "flags", "c": "complex numbers", "m": "durations", "U": "text", "S": "text"}


class Source(NamedTuple):
    """An array that is loaded on demand."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    load: Callable[[], Any]


@dataclass(frozen=True, slots=True)
class Arrays:
    """Named arrays of structs, records and lists."""

    sources: dict[str, Source] = field(default_factory=dict)
    omitted: dict[str, str] = field(default_factory=dict)  # name -> content
    clocks: dict[str, Clock] = field(default_factory=dict)  # sources in seconds

    def add(self, name: str, value: Any) -> None:
        """Add the arrays of a value; members are named by `.`, elements of a row by `[k]`.

        A list is one column, or a list of records: of objects, or of lists of objects.
        """
        prefix = f"{name}." if name else ""
        if isinstance(value, dict) and value.keys() == {str(k) for k in range(len(value))}:
            value = list(value.values())  # of pandas
        if isinstance(value, Mapping):
            for key, member in value.items():
                self.add(prefix + key, member)
            return
        if not isinstance(value, list):
            array = np.asarray(value)
            if array.dtype.names:
                self.add(name, {key: array[key] for key in array.dtype.names})
                return
            if array.dtype != object:
                self.sources[name] = Source(array.shape, array.dtype, array.view)
                return
            value = list(array) if array.ndim else []
        given = [each for each in value if each is not None]
        if given and all(isinstance(each, dict) for each in given):
            for key in dict.fromkeys(key for each in given for key in each):
                self.add(prefix + key, [each and each.get(key) for each in value])
        elif (
            given
            and all(isinstance(each, list) for each in given)
            and any(isinstance(member, dict) for member in given[0])
        ):
            for k in range(len(given[0])):
                self.add(
                    f"{name}[{k}]", [each[k] if each and k < len(each) else None for each in value]
                )
        else:
            self._add_column(name, value, given[0] if given else None)

    def _add_column(self, name: str, rows: list[Any], first: Any) -> None:
        clock = clock_of(first.strip()) if isinstance(first, str) else None
        try:
            if clock:
                array = stamp_seconds([str(each or "").strip() for each in rows], str)
                self.clocks[name] = clock
            elif first is None or isinstance(first, bool | str):
                array = np.asarray([] if first is None else first)
            else:
                missing = np.full(np.shape(first), np.nan)
                filled = [missing if each is None else each for each in rows]
                array = np.array(filled, dtype=float)
        except (InvalidInput, TypeError, ValueError, OverflowError):
            self.omitted[name] = "text or lists of different lengths"
        else:
            self.sources[name] = Source(array.shape, array.dtype, array.view)


def array_table(
    path: Path, arrays: Arrays, length: int | None = None, row: str = "element"
) -> LogTable:
    """Make a table of arrays whose samples are along the axis of their common length.

    Unless `length` gives it, the common length is the most frequent length of the longest axes; of
    equally frequent ones, the most frequent of all axes, then the largest. A matrix without name,
    or the only array of a file if it contains its own time, is `data`. `row` is the word for a
    sample in messages. Raises InvalidInput if no array contains numbers.
    """
    omitted = dict(arrays.omitted)
    usable = {}
    for name, source in arrays.sources.items():
        if source.dtype.kind not in "fiuM":
            omitted[name] = _OTHER_KINDS.get(source.dtype.kind, "objects, cells or text")
        elif prod(source.shape) < 2:
            omitted[name] = "single values" if prod(source.shape) else "no values"
        else:
            usable[name] = source
    if not usable:
        names = ", ".join(f"{name} ({what})".lstrip() for name, what in list(omitted.items())[:20])
        raise InvalidInput(
            f"contains no array of numbers; it contains {names or 'nothing'}",
            where=str(path),
            remedy="store one array of numbers per channel, or a matrix",
        )
    votes = Counter(max(source.shape) for source in usable.values())
    shared = Counter(size for source in usable.values() for size in set(source.shape))
    length = length or max(votes, key=lambda size: (votes[size], shared[size], size))
    columns: dict[str, tuple[str, int]] = {}
    fitting = []
    for name, source in usable.items():
        if length not in source.shape:
            omitted[name] = f"a length other than {length}"
        elif prod(source.shape) > length * _MAX_LIST_COLUMNS:
            omitted[name] = f"more than {_MAX_LIST_COLUMNS} columns"
        else:
            fitting.append(name)
    for name in fitting:
        rest = [size for size in usable[name].shape if size > 1]
        rest.remove(length)
        label = (
            "data"
            if not name or (len(fitting) == 1 and rest and _has_time(usable[name], length))
            else name
        )
        for number, index in enumerate(np.ndindex(*rest)):
            columns[label + "".join(f"[{k}]" for k in index)] = (name, number)

    def read(column_names: Sequence[str]) -> dict[str, FloatArray]:
        check_unpacked_size(
            sum(8.0 * prod(usable[name].shape) for name in {columns[c][0] for c in column_names}),
            path,
        )
        matrices: dict[str, FloatArray] = {}
        result = {}
        for column in column_names:
            name, number = columns[column]
            if name not in matrices:
                matrices[name] = _rows(usable[name], length)
            values = matrices[name][:, number]
            if values.dtype.kind == "M":
                seconds = values.astype("datetime64[ns]").astype(np.int64) / 1e9
                values = np.where(np.isnat(values), np.nan, seconds)
            result[column] = np.ascontiguousarray(values, dtype=np.float64)
        return result

    clocks = {name: clock for name, clock in arrays.clocks.items() if name in columns}
    clocks |= {
        column: "datetime"
        for column, (name, _) in columns.items()
        if usable[name].dtype.kind == "M"
    }
    return LogTable(
        path, list(columns), read, lambda k: f"{row} {k + 1}", clocks=clocks, omitted=omitted
    )


def _rows(source: Source, length: int) -> Any:
    """Load an array as (n_samples, n_columns)."""
    array = np.asarray(source.load())
    return np.moveaxis(array, array.shape.index(length), 0).reshape(length, -1)


def _has_time(source: Source, length: int) -> bool:
    """Whether a column is a clock: the matrix contains different quantities."""
    steps = np.diff(_rows(source, length).astype(float), axis=0)
    median = np.median(steps, axis=0)
    is_even = np.abs(steps - median) <= _MAX_STEP_CHANGE * median
    return bool(((steps > 0.0).all(axis=0) & (is_even.mean(axis=0) >= _MIN_EVEN_SHARE)).any())
