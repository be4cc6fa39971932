"""Columns of named arrays, also within structs and records: in memory, Parquet and Arrow files.

The columns of a matrix are found whichever way it is stored. Arrow columns are numbers, stamps,
lists and structs; tables in memory are of pandas, polars or Arrow, or dictionaries of arrays.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs.clock_text import clock_of, stamp_seconds
from strainwave.io.logs.tables import Clock, LogTable, check_unique, check_unpacked_size, damaged

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


_TICKS_PER_SECOND = {"s": 1e0, "ms": 1e3, "us": 1e6, "ns": 1e9}


def arrow_reader(data: bytes | memoryview) -> Any:
    """Copy bytes into memory of Arrow and return a reader of them.

    Arrow's threads can release their input after the result is available. Releasing a Python object
    requires the interpreter; if it has shut down by then, the process crashes.
    """
    import pyarrow as pa

    buffer = pa.allocate_buffer(len(data))  # of a stream, it would grow by copies
    pa.FixedSizeBufferWriter(buffer).write(data)
    return pa.BufferReader(buffer)


def open_parquet(data: bytes, path: Path) -> LogTable:
    """Open a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet

    def read(name: str) -> Any:
        try:
            return file.read(columns=[name])
        except (pa.ArrowException, OSError, ValueError) as error:
            raise damaged("a Parquet file", error, path) from error

    try:
        file = pa.parquet.ParquetFile(arrow_reader(data))
        batches = [batch for batch, _ in zip(file.iter_batches(1), range(1), strict=False)]
        first = pa.Table.from_batches(batches, file.schema_arrow)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise damaged("a Parquet file", error, path) from error
    return _arrow_table(first, file.metadata.num_rows, read, path)


def open_ipc(data: bytes, path: Path) -> LogTable:
    """Open an Arrow IPC file or stream, or a Feather file of version 2."""
    import pyarrow as pa
    import pyarrow.ipc

    reader = arrow_reader(data)
    try:
        opener = pa.ipc.open_file if data[:6] == b"ARROW1" else pa.ipc.open_stream
        content = _flat(opener(reader).read_all())
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        raise damaged("an Arrow or Feather file", error, path) from error
    return _arrow_table(content, len(content), lambda name: content.select([name]), path)


def _arrow_table(first: Any, n_rows: int, read: Callable[[str], Any], path: Path) -> LogTable:
    """Make a table of the columns of an Arrow table, and of the members of its structs.

    `first` holds at least the first row, whose texts and lists decide; `read` returns an Arrow
    table of one column.
    """
    arrays = Arrays()
    first = _flat(first)
    names = first.column_names
    check_unique(names, str(path))

    def load(name: str) -> FloatArray:
        return _values(_flat(read(name))[name], f"{path}, column {name!r}")

    for name in names:
        kind, head = first[name].type, first[name][:1].drop_null().to_pylist()
        shape: tuple[int, ...] = (n_rows,)
        if _is(kind, "boolean"):
            arrays.omitted[name] = "flags"
        elif _is(kind, *_LISTS) and _is(kind.value_type, *_NUMBERS):
            shape = (n_rows, len(head[0]) if head else 0)
        elif _is(kind, *_TEXTS):
            if clock := clock_of(head[0].strip()) if head else None:
                arrays.clocks[name] = clock
            else:
                arrays.omitted[name] = "text"
        elif clocks := [clock for each, clock in _CLOCKS.items() if _is(kind, each)]:
            arrays.clocks[name] = clocks[0]
        elif not _is(kind, *_NUMBERS):
            arrays.omitted[name] = f"{str(kind).partition('<')[0]} values"
        if name not in arrays.omitted:
            arrays.sources[name] = Source(shape, np.dtype(float), partial(load, name))
    return array_table(path, arrays, n_rows, "row")


_LISTS = ("list", "large_list", "fixed_size_list")  # Arrow's names of types
_TEXTS = ("string", "large_string")
_CLOCKS: dict[str, Clock] = {"timestamp": "datetime", "date": "date", "time": "time"}
_NUMBERS = ("integer", "floating", "decimal", "duration")


def _is(kind: Any, *names: str) -> bool:
    import pyarrow as pa

    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    return any(getattr(pa.types, f"is_{name}")(kind) for name in names)


def _flat(content: Any) -> Any:
    """Replace structs by their members."""
    while any(_is(kind, "struct") for kind in content.schema.types):
        content = content.flatten()
    return content


def _values(column: Any, where: str) -> FloatArray:
    """Read a column (n_samples,) or lists (n_samples, n)."""
    if _is(column.type, *_TEXTS):
        return stamp_seconds(
            [(text or "").strip() for text in column.to_pylist()],
            lambda row: f"{where}, row {row + 1}",
        )
    if not _is(column.type, *_LISTS):
        return column_values(column)
    import pyarrow.compute as pc

    lengths = column_values(pc.list_value_length(column))
    is_valid = ~np.isnan(lengths)
    n = int(lengths[is_valid][0]) if is_valid.any() else 0
    differing = np.flatnonzero(is_valid & (lengths != n))
    if differing.size:
        row = int(differing[0])
        raise InvalidInput(
            f"the lists differ in length: {int(lengths[row])} values after {n}",
            where=f"{where}, row {row + 1}",
            remedy="store lists of one length",
        )
    values = np.full((len(lengths), n), np.nan)
    values[is_valid] = column_values(pc.list_flatten(column)).reshape(-1, n)
    return values


def column_values(column: Any) -> FloatArray:
    """Return the numbers of a chunked Arrow column; stamps in seconds, nulls as NaN.

    Arrow's `to_numpy` would import pandas (0.3 s).
    """
    import pyarrow as pa

    kind = column.type
    per_second = 1.0
    if pa.types.is_temporal(kind):
        unit = getattr(kind, "unit", "ms")  # date64 counts milliseconds
        per_second = 1.0 / 86400.0 if pa.types.is_date32(kind) else _TICKS_PER_SECOND[unit]
        column = column.cast(pa.int32() if kind.bit_width == 32 else pa.int64())
    elif pa.types.is_decimal(kind) or pa.types.is_float16(kind):
        column = column.cast(pa.float64())
    nulls = column.is_null() if column.null_count else None
    if nulls is not None:
        column = column.fill_null(0)
    values = np.concatenate([np.zeros(0), *(np.from_dlpack(chunk) for chunk in column.chunks)])
    if nulls is not None:
        values[column_values(nulls.cast(pa.uint8())) == 1.0] = np.nan
    return values if per_second == 1.0 else values / per_second


Data = Mapping[str, Any]
"""Name of an experiment -> its log: a table in memory, or the path of a file."""


def open_memory_table(data: Any, where: str) -> LogTable:
    """Open a table in memory: pandas, polars, Arrow, or a mapping of str to arrays.

    `where` is the name for messages. Float64 columns are not copied. Raises InvalidInput if `data`
    is not a table or contains no numbers.
    """
    names = _names(data)
    if names is None:
        raise InvalidInput(
            f"is not a table, but {type(data).__name__}",
            where=where,
            remedy="pass a pandas, polars or Arrow table, a dictionary of arrays, or a path",
        )
    for name in names:
        if not isinstance(name, str):
            raise InvalidInput(
                f"the column name {name!r} is not a string", where=where, remedy="rename the column"
            )
    check_unique(names, where)
    arrays = Arrays()
    for name in names:
        arrays.add(name, data[name])
    return array_table(Path(where), arrays, row="row")


def _names(data: Any) -> list[Any] | None:
    if isinstance(data, Mapping):
        return list(data)
    for attribute in ("column_names", "columns"):  # Arrow's `columns` are the arrays themselves
        names = getattr(data, attribute, None)
        if names is not None and not callable(names):
            return list(names)
    return None
