"""Read and write tables of float64 columns: CSV, gzip CSV, Parquet, MAT and HDF5.

Only a file that the fast reader rejects is read again line by line, to locate the invalid row and
column.
"""

from __future__ import annotations

import csv
import gzip
import io
import struct
import sys
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput, import_optional, suggest_name
from strainwave.io.atomic_files import decode, read_bytes, write_whole
from strainwave.io.logs import mat

DELIMITERS = (",", ";", "\t")
"""Delimiters of CSV files; the most frequent one in the header applies."""
MAX_MAGNITUDE = 1e60
"""Largest valid magnitude in any unit; sums of squares of smaller numbers do not overflow."""
_PROBE_BYTES = 1 << 16  # [bytes] that must contain the header and the first row


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of a file by name, read on demand.

    `read` maps names to arrays (n_samples,); `row_name` maps the index of a sample, from 0, to its
    location for messages.
    """

    path: Path  # or name of a table in memory, for messages
    names: Sequence[str]
    read: Callable[[Sequence[str]], dict[str, FloatArray]]
    row_name: Callable[[int], str] = lambda row: f"row {row + 1}"
    units: Mapping[str, str] = field(default_factory=dict)  # column -> unit of a units row

    def missing_column_error(
        self, column: str, what: str, used: Collection[str] = ()
    ) -> InvalidInput:
        """The error for a missing column; `what` states its purpose, `used` are other channels'."""
        available = ", ".join(self.names[:20]) + (", ..." if len(self.names) > 20 else "")
        available += suggest_name(column, [name for name in self.names if name not in used])
        return InvalidInput(
            f"there is no column '{column}', {what}",
            where=str(self.path),
            remedy=f"map it in [channels] of the study; the file has: {available}",
        )


def open_table(path: Path) -> Table:
    """Open a .csv, .csv.gz, .parquet, .mat, .h5 or .hdf5 file.

    Raises InvalidInput if the file is missing, has an unknown suffix, or does not match its suffix.
    """
    name = path.name.lower()
    for suffix, opener in _OPENERS.items():
        if name.endswith(suffix):
            return opener(path)
    raise InvalidInput(
        "has an unknown file type",
        where=str(path),
        remedy=f"use a file whose name ends in {', '.join(_OPENERS)}, or a bag",
    )


def write_table(path: Path, columns: Mapping[str, FloatArray]) -> None:
    """Write columns (n_samples,) to a .csv, .csv.gz or .parquet file in one atomic step.

    Raises InvalidInput if the suffix is unknown or the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    table = pa.table({name: np.asarray(values, dtype=float) for name, values in columns.items()})
    sink = io.BytesIO()
    name = path.name.lower()
    if name.endswith(".parquet"):
        pa.parquet.write_table(table, sink)
    elif name.endswith((".csv", ".csv.gz")):
        pa.csv.write_csv(table, sink, pa.csv.WriteOptions(quoting_style="none"))
    else:
        raise InvalidInput(
            "cannot be written", where=str(path), remedy="use .csv, .csv.gz or .parquet"
        )
    data = sink.getvalue()
    write_whole(path.parent, {path.name: gzip.compress(data) if name.endswith(".gz") else data})


def release_reader_memory() -> None:
    """Release the unused memory of Arrow's readers, which exceeds that of the columns."""
    arrow = sys.modules.get("pyarrow")
    if arrow is not None:
        arrow.default_memory_pool().release_unused()


# --- CSV --------------------------------------------------------------------------------------


def _open_csv(path: Path) -> Table:
    return _csv_table(read_bytes(path, "the log"), path)


def _open_csv_gz(path: Path) -> Table:
    packed = read_bytes(path, "the log")
    try:
        data = gzip.decompress(packed)
    except (OSError, EOFError, zlib.error) as error:
        raise InvalidInput(
            f"cannot be unpacked ({error})",
            where=str(path),
            remedy="the file is not a gzip file or is truncated; copy it again",
        ) from error
    return _csv_table(data, path)


def _csv_table(data: bytes, path: Path) -> Table:
    if not data.strip():
        raise InvalidInput("is empty", where=str(path), remedy="record the experiment again")
    if not data.isascii():
        data = decode(data, path).encode()
    skipped, header = _header_line(data, path)
    delimiter = max(DELIMITERS, key=header.count)
    names = _split(header, delimiter)
    _check_header(names, path, skipped + 1)
    file = _Csv(data, path, names, delimiter, skipped)
    return Table(path, names, file.read, lambda row: f"line {file.line_of(row)}")


def _header_line(data: bytes, path: Path) -> tuple[int, str]:
    """Return the number of lines before the header (empty or # comments), and the header."""
    lines = data[:_PROBE_BYTES].replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
    for number, line in enumerate(lines):
        if line.strip() and not line.lstrip().startswith(b"#"):
            return number, line.decode("utf-8", errors="replace")
    raise InvalidInput(
        "has no header line", where=str(path), remedy="write the column names in the first line"
    )


def _split(line: str, delimiter: str) -> list[str]:
    try:
        fields = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        fields = line.split(delimiter)
    return [field.strip() for field in fields]


def _check_header(names: Sequence[str], path: Path, line: int) -> None:
    where = f"{path}, line {line}"
    if all(_is_number(name) for name in names):
        raise InvalidInput(
            "the first line contains numbers, not column names",
            where=where,
            remedy="add a header line",
        )
    for index, name in enumerate(names):
        if name in names[:index]:
            raise InvalidInput(
                f"there are two columns named {name!r}", where=where, remedy="rename one of them"
            )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class _Csv:
    """Content of a CSV file."""

    data: bytes
    path: Path
    names: Sequence[str]
    delimiter: str
    skipped: int  # lines before the header

    def read(self, column_names: Sequence[str]) -> dict[str, FloatArray]:
        import pyarrow as pa
        import pyarrow.csv

        point = self._decimal_point()
        try:
            table = pa.csv.read_csv(
                _reader(self.data),
                read_options=pa.csv.ReadOptions(
                    skip_rows=self.skipped + 1, column_names=list(self.names), use_threads=True
                ),
                parse_options=pa.csv.ParseOptions(delimiter=self.delimiter),
                convert_options=pa.csv.ConvertOptions(
                    column_types={name: pa.float64() for name in column_names},
                    include_columns=list(column_names),
                    null_values=[],
                    decimal_point=point,
                ),
            )
            return {name: _values(table[name]) for name in column_names}
        except (pa.ArrowException, ValueError) as error:
            self._raise_first_fault(column_names, point)
            raise InvalidInput(
                f"cannot be read as CSV ({error})", where=str(self.path), remedy="write it again"
            ) from error

    def _decimal_point(self) -> str:
        numbers = b"".join(self.data[:_PROBE_BYTES].splitlines()[self.skipped + 1 :])
        return "," if self.delimiter != "," and b"," in numbers and b"." not in numbers else "."

    def _raise_first_fault(self, column_names: Sequence[str], point: str) -> None:
        """Read line by line, and raise InvalidInput at the first invalid line."""
        lines = self.data.decode("utf-8", errors="replace").rstrip().splitlines()
        columns = {name: self.names.index(name) for name in column_names}
        for number, line in enumerate(lines[self.skipped + 1 :], start=self.skipped + 2):
            if not line:
                continue
            where = f"{self.path}, line {number}"
            fields = _split(line, self.delimiter)
            if len(fields) != len(self.names):
                is_cut_off = number == len(lines)
                raise InvalidInput(
                    f"{'the log is truncated: ' if is_cut_off else ''}{len(fields)} values where "
                    f"the header names {len(self.names)} columns",
                    where=where,
                    remedy="delete this line" if is_cut_off else "correct this line",
                )
            for name, index in columns.items():
                _check_number(fields[index].replace(point, "."), f"{where}, column {name!r}")

    def line_of(self, row: int) -> int:
        """Return the line number of a sample; empty lines contain none."""
        lines = self.data.splitlines()
        numbers = [k + 1 for k in range(self.skipped + 1, len(lines)) if lines[k]]
        return numbers[row] if row < len(numbers) else row + self.skipped + 2


def _check_number(text: str, where: str) -> None:
    if not text:
        raise InvalidInput(
            "there is no value",
            where=where,
            remedy="delete this line, or exclude it with start and stop",
        )
    if not _is_number(text) or "_" in text:
        raise InvalidInput(
            f"{text[:40]!r} is not a number", where=where, remedy="correct the value"
        )


def _reader(data: bytes) -> Any:
    """Copy bytes into memory of Arrow and return a reader of them.

    Arrow's threads can release their input after the result is available. Releasing a Python object
    requires the interpreter; if it has shut down by then, the process crashes.
    """
    import pyarrow as pa

    sink = pa.BufferOutputStream()
    sink.write(data)
    return pa.BufferReader(sink.getvalue())


# --- Parquet ----------------------------------------------------------------------------------


def _open_parquet(path: Path) -> Table:
    import pyarrow as pa
    import pyarrow.parquet

    data = read_bytes(path, "the log")
    try:
        file = pa.parquet.ParquetFile(_reader(data))
        names = list(file.schema_arrow.names)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise _damaged("a Parquet file", error, path) from error

    def read(column_names: Sequence[str]) -> dict[str, FloatArray]:
        try:
            table = file.read(columns=list(column_names))
        except (pa.ArrowException, OSError, ValueError) as error:
            raise _damaged("a Parquet file", error, path) from error
        return {name: _numbers(table[name], f"{path}, column {name!r}") for name in column_names}

    _check_header(names, path, 1)
    return Table(path, names, read)


def _damaged(
    kind: str, error: Exception, path: Path, remedy: str = "write it again"
) -> InvalidInput:
    cause = str(error).partition("\n")[0][:100]
    return InvalidInput(f"is not {kind}, or is damaged ({cause})", where=str(path), remedy=remedy)


def _numbers(column: Any, where: str) -> FloatArray:
    import pyarrow as pa

    if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
        raise InvalidInput(
            f"contains {column.type}, not numbers", where=where, remedy="store it as float64"
        )
    if column.null_count:
        row = np.flatnonzero(column.is_null().to_numpy(zero_copy_only=False))[0]
        raise InvalidInput(
            "there is no value", where=f"{where}, row {row + 1}", remedy="remove this row"
        )
    return _values(column)


def _values(column: Any) -> FloatArray:
    """Return the numbers of an Arrow column without nulls.

    Arrow's `to_numpy` would import pandas (0.3 s).
    """
    return np.concatenate([np.zeros(0), *(np.from_dlpack(chunk) for chunk in column.chunks)])


# --- MAT and HDF5 -----------------------------------------------------------------------------


def _open_mat(path: Path) -> Table:
    data = read_bytes(path, "the log")
    if data[:4] == b"\x89HDF" or b"MATLAB 7.3" in data[:64]:
        return _open_hdf5(path)
    damaged = partial(_damaged, "a MAT file", path=path, remedy="save it again with -v7 or -v7.3")
    try:
        names = mat.variables(data)
    except (ValueError, zlib.error, struct.error) as error:
        raise damaged(error) from error

    def read(column_names: Sequence[str]) -> dict[str, FloatArray]:
        for name in column_names:
            if not names[name]:
                raise _no_vector("not an array of real numbers", f"{path}, variable {name!r}")
        try:
            variables = mat.read(data, column_names)
        except Exception as error:  # SciPy's reader raises arbitrary exceptions on a damaged file
            raise damaged(error) from error
        return vectors(variables, str(path), "variable")

    return Table(path, list(names), read, _element)


def _open_hdf5(path: Path) -> Table:
    purpose = "reading HDF5 and MAT v7.3 files"
    h5py = import_optional("h5py", purpose, "'strainwave[hdf5]'", str(path))
    data = read_bytes(path, "the log")
    datasets: dict[str, Any] = {}

    def visit(name: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset) and not name.startswith("#"):
            datasets[name] = np.squeeze(np.asarray(node[()]))

    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            file.visititems(visit)
    except Exception as error:  # HDF5 raises arbitrary exceptions on a damaged file
        raise _damaged("an HDF5 file", error, path) from error

    def read(names: Sequence[str]) -> dict[str, FloatArray]:
        return vectors({name: datasets[name] for name in names}, str(path), "variable")

    return Table(path, list(datasets), read, _element)


def _element(row: int) -> str:
    return f"element {row + 1}"


def _no_vector(what: str, where: str) -> InvalidInput:
    return InvalidInput(
        f"is not a vector of numbers, but {what}",
        where=where,
        remedy="store one number of each channel per sample",
    )


def vectors(values: Mapping[str, Any], where: str, noun: str) -> dict[str, FloatArray]:
    """Convert values by name to columns; each must be a numeric vector, all of one length.

    `where` and `noun` name the source and its columns in messages. Float64 vectors are not copied.
    """
    columns = {}
    for name, value in values.items():
        try:
            array = np.asarray(value)
        except (TypeError, ValueError):
            array = np.empty(0, dtype=object)
        if array.ndim != 1 or array.dtype.kind not in "fiu":
            what = f"{array.dtype} of shape {array.shape}"
            raise _no_vector(what, f"{where}, {noun} {name!r}")
        columns[name] = np.ascontiguousarray(array, dtype=np.float64)
    lengths = {len(column) for column in columns.values()}
    if len(lengths) > 1:
        raise InvalidInput(
            f"the {noun}s differ in length: {sorted(lengths)}",
            where=where,
            remedy="store one number of each channel per sample",
        )
    return columns


def find_invalid_value(values: FloatArray) -> int | None:
    """Return the index of the first NaN, infinity or value of at least LARGEST, or None."""
    is_valid = np.abs(values) < MAX_MAGNITUDE
    return None if is_valid.all() else int(np.argmin(is_valid))


_OPENERS: dict[str, Callable[[Path], Table]] = {  # suffix -> function
    ".csv": _open_csv,
    ".csv.gz": _open_csv_gz,
    ".parquet": _open_parquet,
    ".mat": _open_mat,
    ".h5": _open_hdf5,
    ".hdf5": _open_hdf5,
}

TABLE_SUFFIXES = tuple(_OPENERS)
"""Suffixes of tables."""
