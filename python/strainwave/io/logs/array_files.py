"""Open files of named arrays: MAT, HDF5, NPZ, NPY and JSON."""

from __future__ import annotations

import codecs
import io
import json
import struct
import zipfile
import zlib
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from strainwave.errors import InvalidInput, import_optional
from strainwave.io.logs import mat
from strainwave.io.logs.arrays import Source, array_table, sources_of
from strainwave.io.logs.clock_text import clock_of, stamp_seconds
from strainwave.io.logs.table import Clock, Table, check_unpacked_size, damaged


def open_mat(data: bytes, path: Path) -> Table:
    """Open a MAT file; version 7.3 is HDF5."""
    if data[:4] == b"\x89HDF" or b"MATLAB 7.3" in data[:64]:
        return open_hdf5(data, path, separator=".")
    try:
        content = mat.read(data, partial(check_unpacked_size, path=path))
    except (ValueError, zlib.error, struct.error) as error:
        remedy = "save it again with -v7 or -v7.3"
        raise damaged("a MAT file", error, path, remedy) from error
    return array_table(path, sources_of(content.arrays), content.omitted)


# --- NumPy ------------------------------------------------------------------------------------


def open_npy(data: bytes, path: Path) -> Table:
    """Open a file of one NumPy array."""
    return array_table(path, sources_of({"": _npy(data, path)}), {})


def open_npz(data: bytes, path: Path) -> Table:
    """Open a file of named NumPy arrays."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            check_unpacked_size(sum(info.file_size for info in archive.infolist()), path)
            members = {name: archive.read(name) for name in archive.namelist()}
    except (OSError, ValueError, EOFError, zlib.error, zipfile.BadZipFile, RuntimeError) as error:
        raise damaged("an NPZ file", error, path) from error
    except NotImplementedError as error:
        raise damaged("an NPZ file", error, path) from error
    arrays = {name.removesuffix(".npy"): _npy(member, path) for name, member in members.items()}
    return array_table(path, sources_of(arrays), {})


def _npy(data: bytes, path: Path) -> np.ndarray[Any, Any]:
    """Read an array; one of objects is empty, because its values would be unpickled."""
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0
        if version != (1, 0):
            read_header = np.lib.format.read_array_header_2_0
        shape, is_fortran, dtype = read_header(stream)
        if dtype.hasobject:
            return np.empty(0, dtype=object)
        array = np.frombuffer(data, dtype, offset=stream.tell())
        return array.reshape(shape, order="F" if is_fortran else "C")
    except Exception as error:  # the header is a Python expression with arbitrary faults
        raise damaged("a NumPy file", error, path) from error


# --- HDF5 -------------------------------------------------------------------------------------


def open_hdf5(data: bytes, path: Path, separator: str = "/") -> Table:
    """Open an HDF5 file; groups are separated by `separator` in the names of columns.

    Raises InvalidInput if a link or a dataset refers to another file.
    """
    purpose = "reading HDF5 and MAT v7.3 files"
    h5py = import_optional("h5py", purpose, "'strainwave[hdf5]'", str(path))
    sources: dict[str, Source] = {}
    omitted: dict[str, str] = {}

    def visit(name: str, node: Any) -> None:
        if name.startswith("#"):
            return
        if isinstance(node, h5py.Group):
            for key in node:
                link = node.get(key, getlink=True)
                label = f"{name}/{key}".strip("/")
                if isinstance(link, h5py.ExternalLink):
                    raise _refers_elsewhere(label, path)
                if isinstance(link, h5py.SoftLink):
                    omitted[label.replace("/", separator)] = "links"
        elif isinstance(node, h5py.Dataset):
            if node.external or node.is_virtual:
                raise _refers_elsewhere(name, path)
            label = name.replace("/", separator)
            matlab_class = node.attrs.get("MATLAB_class", b"")
            if matlab_class in (b"char", b"cell", b"logical") or node.shape is None:
                omitted[label] = "text, cells or flags"
            else:
                sources[label] = Source(node.shape, node.dtype, partial(load, name))

    def load(name: str) -> Any:
        try:
            with h5py.File(io.BytesIO(data), "r") as file:
                return file[name][()]
        except Exception as error:  # HDF5 raises arbitrary exceptions on a damaged file
            raise damaged("an HDF5 file", error, path) from error

    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            visit("", file)
            file.visititems(visit)
    except InvalidInput:
        raise
    except Exception as error:
        raise damaged("an HDF5 file", error, path) from error
    return array_table(path, sources, omitted)


def _refers_elsewhere(name: str, path: Path) -> InvalidInput:
    return InvalidInput(
        f"{name!r} refers to another file, which is not read",
        where=str(path),
        remedy="store all data in this file: h5repack, or copy the datasets",
    )


# --- JSON -------------------------------------------------------------------------------------


def open_json(data: bytes, path: Path) -> Table:
    """Open a JSON file of records or columns."""
    try:
        document = json.loads(data.removeprefix(codecs.BOM_UTF8))
    except (ValueError, RecursionError) as error:
        if b"\n" in data.strip() and data.lstrip()[:1] == b"{":
            return open_json_lines(data, path)
        raise damaged("JSON", error, path) from error
    return _json_table(document, path)


def open_json_lines(data: bytes, path: Path) -> Table:
    """Open a file of one JSON object per line."""
    records = []
    lines = data.removeprefix(codecs.BOM_UTF8).rstrip().splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            if line.strip():
                records.append(json.loads(line))
        except (ValueError, RecursionError) as error:
            is_cut_off = number == len(lines)
            raise InvalidInput(
                f"{'the log is truncated: ' if is_cut_off else ''}the line is not JSON ({error})",
                where=f"{path}, line {number}",
                remedy="delete this line" if is_cut_off else "correct this line",
            ) from error
    return _json_table(records, path)


def _json_table(document: Any, path: Path) -> Table:
    content = _Json({}, {}, {})
    try:
        content.collect("", document)
    except RecursionError as error:
        raise damaged("JSON of a log", error, path) from error
    return array_table(path, sources_of(content.arrays), content.omitted, content.clocks)


class _Json(NamedTuple):
    """Arrays of a JSON document by name."""

    arrays: dict[str, np.ndarray[Any, Any]]
    omitted: dict[str, str]
    clocks: dict[str, Clock]

    def collect(self, name: str, value: Any) -> None:
        """Add the arrays of a value: of an object of columns, or of a list of records."""
        prefix = f"{name}." if name else ""
        if isinstance(value, dict) and {"columns", "data"} <= value.keys():  # pandas, "split"
            columns = zip(*value["data"], strict=False)
            value = dict(zip(map(str, value["columns"]), map(list, columns), strict=False))
        if isinstance(value, dict) and value.keys() == {str(k) for k in range(len(value))}:
            value = list(value.values())  # pandas, "columns"
        if isinstance(value, dict):
            for key, member in value.items():
                self.collect(prefix + key, member)
            return
        given = [each for each in value if each is not None] if isinstance(value, list) else []
        if given and all(isinstance(each, dict) for each in given):
            for key in dict.fromkeys(key for each in given for key in each):
                self.collect(prefix + key, [each and each.get(key) for each in value])
        elif (
            given
            and all(isinstance(each, list) and each for each in given)
            and any(isinstance(inner, dict) for inner in given[0])
        ):
            for index in range(len(given[0])):
                inner = [each[index] if each and index < len(each) else None for each in value]
                self.collect(f"{name}[{index}]", inner)
        else:
            self._add(name, value, given)

    def _add(self, name: str, value: Any, given: list[Any]) -> None:
        first = given[0] if given else None
        if not given:
            self.omitted[name] = "single values" if not isinstance(value, list) else "no values"
        elif isinstance(first, bool):
            self.omitted[name] = "flags"
        elif isinstance(first, str) and (clock := clock_of(first.strip())):
            try:
                self.arrays[name] = stamp_seconds([str(each or "").strip() for each in value])
                self.clocks[name] = clock
            except ValueError:
                self.omitted[name] = "text"
        elif isinstance(first, str):
            self.omitted[name] = "text"
        else:
            n = len(first) if isinstance(first, list) else 0
            rows = [[None] * n if each is None else each for each in value] if n else value
            try:
                self.arrays[name] = np.array(rows, dtype=float)
            except (TypeError, ValueError, OverflowError):
                self.omitted[name] = "text or lists of different lengths"
