"""Columns of named arrays: vectors, and the columns of matrices whichever way they are stored."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs.arrow import MAX_LIST_COLUMNS
from strainwave.io.logs.table import Clock, Table, check_unpacked_size

_MAX_STEP_CHANGE = 0.5  # of a clock, relative to its median step
_MIN_EVEN_SHARE = 0.9  # share of the steps of a clock within that range
_OTHER_KINDS = {"b": "flags", "c": "complex numbers", "m": "durations"}  # of NumPy's types


class Source(NamedTuple):
    """An array that is loaded on demand."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    load: Callable[[], Any]


def sources_of(arrays: Mapping[str, np.ndarray[Any, Any]]) -> dict[str, Source]:
    """Describe arrays in memory; the fields of a structured array are members by `.`."""
    sources: dict[str, Source] = {}
    for name, array in arrays.items():
        if array.dtype.names:
            prefix = f"{name}." if name else ""
            sources |= sources_of({prefix + field: array[field] for field in array.dtype.names})
        else:
            sources[name] = Source(array.shape, array.dtype, array.view)
    return sources


def array_table(
    path: Path,
    sources: Mapping[str, Source],
    omitted: Mapping[str, str],
    stamps: Mapping[str, Clock] | None = None,
) -> Table:
    """Make a table of arrays whose samples are along the axis of their common length.

    The common length is the most frequent length of the longest axes; of equally frequent ones, the
    most frequent of all axes, then the largest. A matrix without name, or the only array of a file
    if it contains its own time, is `data`. `stamps` are the names of sources in seconds. Raises
    InvalidInput if no array contains numbers.
    """
    omitted = dict(omitted)
    usable = {}
    for name, source in sources.items():
        if source.dtype.kind not in "fiuM":
            omitted[name] = _OTHER_KINDS.get(source.dtype.kind, "text or objects")
        elif prod(source.shape) < 2:
            omitted[name] = "single values" if prod(source.shape) else "no values"
        else:
            usable[name] = source
    if not usable:
        names = ", ".join(f"{name} ({what})" for name, what in list(omitted.items())[:20])
        raise InvalidInput(
            f"contains no array of numbers; it contains {names or 'nothing'}",
            where=str(path),
            remedy="store one array of numbers per channel, or a matrix",
        )
    votes = Counter(max(source.shape) for source in usable.values())
    shared = Counter(size for source in usable.values() for size in set(source.shape))
    length = max(votes, key=lambda size: (votes[size], shared[size], size))
    columns: dict[str, tuple[str, int]] = {}
    fitting = []
    for name, source in usable.items():
        if length not in source.shape:
            omitted[name] = f"a length other than {length}"
        elif prod(source.shape) > length * MAX_LIST_COLUMNS:
            omitted[name] = f"more than {MAX_LIST_COLUMNS} columns"
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
            result[column] = _numbers(matrices[name][:, number])
        return result

    clocks = {name: clock for name, clock in (stamps or {}).items() if name in columns}
    clocks |= {
        column: "datetime"
        for column, (name, _) in columns.items()
        if usable[name].dtype.kind == "M"
    }
    return Table(
        path, list(columns), read, lambda row: f"element {row + 1}", clocks=clocks, omitted=omitted
    )


def _rows(source: Source, length: int) -> Any:
    """Load an array as (n_samples, n_columns)."""
    array = np.asarray(source.load())
    return np.moveaxis(array, array.shape.index(length), 0).reshape(length, -1)


def _numbers(values: Any) -> FloatArray:
    if values.dtype.kind != "M":
        return np.ascontiguousarray(values, dtype=np.float64)
    seconds = values.astype("datetime64[ns]").astype(np.int64) / 1e9
    return np.where(np.isnat(values), np.nan, seconds)


def _has_time(source: Source, length: int) -> bool:
    """Whether a column is a clock: the matrix contains different quantities."""
    steps = np.diff(_rows(source, length).astype(float), axis=0)
    median = np.median(steps, axis=0)
    is_even = np.abs(steps - median) <= _MAX_STEP_CHANGE * median
    return bool(((steps > 0.0).all(axis=0) & (is_even.mean(axis=0) >= _MIN_EVEN_SHARE)).any())
