"""Read Parquet and Arrow files, and columns of Arrow tables: numbers, stamps, lists and structs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs.clock_text import clock_of, stamp_seconds
from strainwave.io.logs.table import Clock, Table, check_unpacked_size, damaged

MAX_LIST_COLUMNS = 256
"""Largest number of columns of a list or matrix; images and point clouds have more."""
_TICKS_PER_SECOND = {"s": 1e0, "ms": 1e3, "us": 1e6, "ns": 1e9}


def arrow_reader(data: bytes | memoryview) -> Any:
    """Copy bytes into memory of Arrow and return a reader of them.

    Arrow's threads can release their input after the result is available. Releasing a Python object
    requires the interpreter; if it has shut down by then, the process crashes.
    """
    import pyarrow as pa

    sink = pa.BufferOutputStream()
    sink.write(data)
    return pa.BufferReader(sink.getvalue())


def open_parquet(data: bytes, path: Path) -> Table:
    """Open a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet

    try:
        file = pa.parquet.ParquetFile(arrow_reader(data))
        schema = file.schema_arrow
        lists = [field.name for field in schema if _has_list(field.type)]
        first = next(file.iter_batches(1, columns=lists), None) if lists else None
    except (pa.ArrowException, OSError, ValueError) as error:
        raise damaged("a Parquet file", error, path) from error

    def read(names: Sequence[str]) -> Any:
        check_unpacked_size(8.0 * file.metadata.num_rows * len(names), path)
        try:
            return file.read(columns=list(names))
        except (pa.ArrowException, OSError, ValueError) as error:
            raise damaged("a Parquet file", error, path) from error

    return arrow_table(schema, first, read, path)


def open_ipc(data: bytes, path: Path) -> Table:
    """Open an Arrow IPC file or stream, or a Feather file of version 2."""
    import pyarrow as pa
    import pyarrow.ipc

    reader = arrow_reader(data)
    try:
        opener = pa.ipc.open_file if data[:6] == b"ARROW1" else pa.ipc.open_stream
        content = opener(reader).read_all()
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        raise damaged("an Arrow or Feather file", error, path) from error
    return arrow_table(content.schema, content, content.select, path)


def arrow_table(
    schema: Any, first: Any, read_fields: Callable[[Sequence[str]], Any], path: Path
) -> Table:
    """Make a table of the fields of an Arrow schema.

    `first` holds at least the first row of the lists, whose lengths name the columns; `read_fields`
    returns an Arrow table of fields by name.
    """
    columns: dict[str, _Column] = {}
    omitted: dict[str, str] = {}
    for field in schema:
        values = first[field.name] if first is not None and _has_list(field.type) else None
        _collect(field.name, field.type, values, (field.name,), columns, omitted)
    names = list(schema.names)
    for index, name in enumerate(names):
        if name in names[:index]:
            raise InvalidInput(
                f"there are two columns named {name!r}", where=str(path), remedy="rename one"
            )

    def read(column_names: Sequence[str]) -> dict[str, FloatArray]:
        fields = list(dict.fromkeys(columns[name].path[0] for name in column_names))
        content = read_fields(fields)
        arrays: dict[tuple[Any, ...], FloatArray] = {}
        result = {}
        for name in column_names:
            column = columns[name]
            if column.path not in arrays:
                arrays[column.path] = _values_at(content, column.path, f"{path}, column {name!r}")
            array = arrays[column.path]
            result[name] = array if column.element is None else array[:, column.element].copy()
        return result

    clocks = {name: column.clock for name, column in columns.items() if column.clock}
    return Table(path, list(columns), read, clocks=clocks, omitted=omitted)


class _Column(NamedTuple):
    path: tuple[str, ...]  # field and members of structs
    element: int | None  # of a list
    clock: Clock | None


def _has_list(kind: Any) -> bool:
    """Whether the names or the type of a field's columns depend on its values."""
    import pyarrow as pa

    if pa.types.is_struct(kind):
        return any(_has_list(field.type) for field in kind)
    return _is_list(kind) or _is_text(kind)


def _is_list(kind: Any) -> bool:
    import pyarrow as pa

    tests = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
    return any(test(kind) for test in tests)


def _is_text(kind: Any) -> bool:
    import pyarrow as pa

    if pa.types.is_dictionary(kind):
        return _is_text(kind.value_type)
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _is_number(kind: Any) -> bool:
    import pyarrow as pa

    types = pa.types
    tests = (types.is_integer, types.is_floating, types.is_decimal, types.is_duration)
    return any(test(kind) for test in tests)


def _clock(kind: Any, values: Any) -> Clock | None:
    import pyarrow as pa

    if pa.types.is_timestamp(kind):
        return "datetime"
    if pa.types.is_date(kind):
        return "date"
    if pa.types.is_time(kind):
        return "time"
    texts = values.drop_null().to_pylist()[:1] if _is_text(kind) and values is not None else []
    return clock_of(texts[0].strip()) if texts else None


def _collect(
    name: str,
    kind: Any,
    values: Any,
    path: tuple[str, ...],
    columns: dict[str, _Column],
    omitted: dict[str, str],
) -> None:
    """Name the columns of a field; `values` are its first rows where its type needs them."""
    import pyarrow as pa

    clock = _clock(kind, values)
    if pa.types.is_struct(kind):
        for index, member in enumerate(kind):
            inner = None if values is None else values.flatten()[index]
            inner_path = (*path, member.name)
            _collect(f"{name}.{member.name}", member.type, inner, inner_path, columns, omitted)
    elif _is_list(kind) and _is_number(kind.value_type):
        rows = [] if values is None else values.drop_null().to_pylist()
        length = len(rows[0]) if rows else 0
        if 0 < length <= MAX_LIST_COLUMNS:
            columns |= {f"{name}[{k}]": _Column(path, k, None) for k in range(length)}
        else:
            omitted[name] = (
                f"lists of more than {MAX_LIST_COLUMNS} values" if length else "no values"
            )
    elif clock or _is_number(kind):
        columns[name] = _Column(path, None, clock)
    elif pa.types.is_boolean(kind):
        omitted[name] = "flags"
    else:
        omitted[name] = "text" if _is_text(kind) else f"{str(kind).partition('<')[0]} values"


def _values_at(content: Any, path: tuple[str, ...], where: str) -> FloatArray:
    """Read a column (n_samples,) or lists (n_samples, n)."""
    column = content[path[0]]
    for member in path[1:]:
        column = column.flatten()[column.type.get_field_index(member)]
    if _is_text(column.type):
        texts = ["" if text is None else text.strip() for text in column.to_pylist()]
        try:
            return stamp_seconds(texts)
        except ValueError as error:
            row = int(error.args[0])
            raise InvalidInput(
                f"{texts[row][:40]!r} is not a date or time",
                where=f"{where}, row {row + 1}",
                remedy="correct the value",
            ) from error
    if not _is_list(column.type):
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
