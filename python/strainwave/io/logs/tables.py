"""Open a log file of any supported type, and write tables of float64 columns."""

from __future__ import annotations

import gzip
import io
import stat
import sys
import zlib
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import read_bytes, write_whole
from strainwave.io.logs.table import (
    MAX_MAGNITUDE,
    Clock,
    Table,
    check_unpacked_size,
    find_invalid_value,
)

__all__ = [
    "MAX_MAGNITUDE",
    "TABLE_SUFFIXES",
    "Clock",
    "Table",
    "find_invalid_value",
    "open_table",
    "release_reader_memory",
    "write_table",
]

_CHUNK_BYTES = 1 << 24  # [bytes] that are unpacked at a time


def open_table(path: Path) -> Table:
    """Open a log file; its suffix, before .gz or .zst, is one of TABLE_SUFFIXES.

    Raises InvalidInput if the file is missing or no regular file, has an unknown suffix, does not
    match its suffix, or exceeds the limit of the unpacked size.
    """
    name = path.name.lower()
    packing = next((suffix for suffix in _UNPACKERS if name.endswith(suffix)), "")
    suffix = Path(name.removesuffix(packing)).suffix
    if suffix not in _OPENERS:
        raise _unknown_type(path, suffix)
    _check_regular(path)
    data = read_bytes(path, "the log")
    if packing:
        data = _unpack(_UNPACKERS[packing], data, path, packing[1:])
    module, function = _OPENERS[suffix]
    opener: Callable[[bytes, Path], Table] = getattr(
        import_module(f"strainwave.io.logs.{module}"), function
    )
    return opener(data, path)


def _unknown_type(path: Path, suffix: str) -> InvalidInput:
    remedy = f"use a file whose name ends in {', '.join(_OPENERS)}, or a bag"
    if suffix in _SPREADSHEETS:
        remedy = "save the sheet as CSV"
    return InvalidInput("has an unknown file type", where=str(path), remedy=remedy)


def _check_regular(path: Path) -> None:
    """Refuse pipes and devices, which may never end; `read_bytes` reports other faults."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InvalidInput(
            "is not a regular file", where=str(path), remedy="copy the log to a file on a disk"
        )


def _unpack(open_stream: Callable[[bytes], Any], data: bytes, path: Path, kind: str) -> bytes:
    chunks = []
    size = 0
    try:
        with open_stream(data) as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                size += len(chunk)
                check_unpacked_size(size, path)
                chunks.append(chunk)
    except (OSError, EOFError, zlib.error) as error:
        raise InvalidInput(
            f"cannot be unpacked ({error})",
            where=str(path),
            remedy=f"the file is not a {kind} file or is truncated; copy it again",
        ) from error
    return b"".join(chunks)


def _open_gzip(data: bytes) -> Any:
    return gzip.GzipFile(fileobj=io.BytesIO(data))


def _open_zstd(data: bytes) -> Any:
    import pyarrow as pa

    return pa.CompressedInputStream(pa.BufferReader(data), "zstd")


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
    ".parquet": ("arrow", "open_parquet"),
    ".feather": ("arrow", "open_ipc"),
    ".arrow": ("arrow", "open_ipc"),
    ".mat": ("array_files", "open_mat"),
    ".h5": ("array_files", "open_hdf5"),
    ".hdf5": ("array_files", "open_hdf5"),
    ".npz": ("array_files", "open_numpy"),
    ".npy": ("array_files", "open_numpy"),
    ".json": ("array_files", "open_json"),
    ".jsonl": ("array_files", "open_json_lines"),
    ".ndjson": ("array_files", "open_json_lines"),
}
_UNPACKERS: dict[str, Callable[[bytes], Any]] = {".gz": _open_gzip, ".zst": _open_zstd}
_SPREADSHEETS = (".xlsx", ".xls", ".xlsm", ".ods")

TABLE_SUFFIXES = tuple(suffix + packing for suffix in _OPENERS for packing in ("", *_UNPACKERS))
"""Suffixes of tables."""
