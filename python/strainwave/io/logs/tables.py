"""The columns of a log file, read on demand; open files of any supported type, and write tables."""

from __future__ import annotations

import gzip
import io
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Literal

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput, suggest_name
from strainwave.io.atomic_files import read_bytes, write_whole

Clock = Literal["datetime", "date", "time"]
"""Type of a column of time stamps: seconds since 1970 UTC, or since midnight for "time"."""
MAX_MAGNITUDE = 1e60
"""Largest valid magnitude in any unit; sums of squares of smaller numbers do not overflow."""
MAX_UNPACKED_BYTES = 1 << 31
"""[bytes] Largest unpacked size of a compressed log: 20 channels for 3 h at 1 kHz."""
MAX_UNPACKED_RATIO = 200
"""Largest ratio of the unpacked to the packed size.

CSV of a clock and 20 constant columns reaches 62 by gzip and 156 by zstd, of 7 moving ones among 37
it is 12.
"""
_MIN_REFUSED_BYTES = 1 << 26  # [bytes] a smaller log is read whatever its ratio
_MAX_NAMES = 20  # names in a message
_CHUNK_BYTES = 1 << 24  # [bytes] that are unpacked at a time


@dataclass(frozen=True, slots=True)
class LogTable:
    """Columns of a file by name, read on demand.

    `read` maps names to arrays (n_samples,), with NaN for a missing value; `row_name` maps the
    index of a sample, from 0, to its location for messages.
    """

    path: Path  # or name of a table in memory, for messages
    names: Sequence[str]
    read: Callable[[Sequence[str]], dict[str, FloatArray]]
    row_name: Callable[[int], str] = lambda row: f"row {row + 1}"
    units: Mapping[str, str] = field(default_factory=dict)  # from a row of units: name -> unit
    clocks: Mapping[str, Clock] = field(default_factory=dict)  # columns of time stamps
    omitted: Mapping[str, str] = field(default_factory=dict)  # unusable column -> its content
    assumptions: Sequence[str] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader assumed, and the columns that it leaves out."""
        by_content: dict[str, list[str]] = {}
        for name, content in self.omitted.items():
            by_content.setdefault(content, []).append(name)
        return (
            *self.assumptions,
            *(f"left out, because of {what}: {_list(names)}" for what, names in by_content.items()),
        )

    def missing_column_error(
        self, column: str, what: str, used: Collection[str] = ()
    ) -> InvalidInput:
        """The error for a missing column; `what` states its purpose, `used` are other channels'."""
        if column in self.omitted:
            return InvalidInput(
                f"the column '{column}', {what}, is not usable: {self.omitted[column]}",
                where=str(self.path),
                remedy="store one number per sample, or map another column in [channels]",
            )
        available = _list(self.names)
        available += suggest_name(column, [name for name in self.names if name not in used])
        return InvalidInput(
            f"there is no column '{column}', {what}",
            where=str(self.path),
            remedy=f"map it in [channels] of the study; the file has: {available}",
        )


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:_MAX_NAMES]) + (", ..." if len(names) > _MAX_NAMES else "")


def damaged(
    kind: str, error: Exception, path: Path, remedy: str = "write it again"
) -> InvalidInput:
    """The error for a file that its reader rejects."""
    cause = (str(error) or type(error).__name__).partition("\n")[0][:100]
    return InvalidInput(f"is not {kind}, or is damaged ({cause})", where=str(path), remedy=remedy)


def check_unpacked_size(size: float, path: Path) -> None:
    """Raise InvalidInput if a log of this unpacked size [bytes] exceeds a limit."""
    if size > MAX_UNPACKED_BYTES:
        raise InvalidInput(
            f"unpacks to more than {MAX_UNPACKED_BYTES >> 20} MiB, the limit of a log",
            where=str(path),
            remedy="split the log, or store fewer columns",
        )
    packed = path.stat().st_size if path.is_file() else size  # a table in memory
    if size > max(_MIN_REFUSED_BYTES, MAX_UNPACKED_RATIO * packed):
        raise InvalidInput(
            f"unpacks to more than {MAX_UNPACKED_RATIO} times its size, as no log does",
            where=str(path),
            remedy="store the log without compression",
        )


def find_invalid_value(values: FloatArray) -> int | None:
    """Return the index of the first NaN, infinity or value of at least LARGEST, or None."""
    is_valid = np.abs(values) < MAX_MAGNITUDE
    return None if is_valid.all() else int(np.argmin(is_valid))


def check_unique(names: Sequence[str], where: str) -> None:
    """Raise InvalidInput if two columns have the same name."""
    for index, name in enumerate(names):
        if name in names[:index]:
            raise InvalidInput(
                f"there are two columns named {name!r}", where=where, remedy="rename one of them"
            )


def open_table(path: Path) -> LogTable:
    """Open a log file; its suffix, before .gz or .zst, is one of TABLE_SUFFIXES.

    Raises InvalidInput if the file is missing or no regular file, has an unknown suffix, does not
    match its suffix, or exceeds the limit of the unpacked size.
    """
    name = path.name.lower()
    packing = next((suffix for suffix in _PACKINGS if name.endswith(suffix)), "")
    suffix = Path(name.removesuffix(packing)).suffix
    if suffix not in _OPENERS:
        remedy = f"use a file whose name ends in {', '.join(_OPENERS)}, or a bag"
        remedy = "save the sheet as CSV" if suffix in _SPREADSHEETS else remedy
        raise InvalidInput("has an unknown file type", where=str(path), remedy=remedy)
    data = read_bytes(path, "the log")
    if packing:
        data = _unpack(data, path, _PACKINGS[packing])
    module, function = _OPENERS[suffix]
    opener: Callable[[bytes, Path], LogTable] = getattr(
        import_module(f"strainwave.io.logs.{module}"), function
    )
    return opener(data, path)


def _unpack(data: bytes, path: Path, kind: str) -> bytes:
    import pyarrow as pa

    chunks = []
    size = 0
    try:
        with pa.CompressedInputStream(pa.BufferReader(data), kind) as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                size += len(chunk)
                check_unpacked_size(size, path)
                chunks.append(chunk)
    except (OSError, pa.ArrowException) as error:
        raise InvalidInput(
            f"cannot be unpacked ({error})",
            where=str(path),
            remedy=f"the file is not a {kind} file or is truncated; copy it again",
        ) from error
    return b"".join(chunks)


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


_OPENERS = {  # suffix -> module and function, imported on use
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".log", ".lvm"), ("text", "open_text")),
    ".parquet": ("arrays", "open_parquet"),
    ".feather": ("arrays", "open_ipc"),
    ".arrow": ("arrays", "open_ipc"),
    ".mat": ("array_files", "open_mat"),
    ".h5": ("array_files", "open_hdf5"),
    ".hdf5": ("array_files", "open_hdf5"),
    ".npz": ("array_files", "open_numpy"),
    ".npy": ("array_files", "open_numpy"),
    ".json": ("array_files", "open_json"),
    ".jsonl": ("array_files", "open_json_lines"),
    ".ndjson": ("array_files", "open_json_lines"),
}
_PACKINGS = {".gz": "gzip", ".zst": "zstd"}  # suffix -> name in Arrow
_SPREADSHEETS = (".xlsx", ".xls", ".xlsm", ".ods")

TABLE_SUFFIXES = tuple(suffix + packing for suffix in _OPENERS for packing in ("", *_PACKINGS))
"""Suffixes of tables."""
