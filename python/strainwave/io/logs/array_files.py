"""Open files of named arrays: MAT, HDF5, NPZ, NPY and JSON."""

from __future__ import annotations

import codecs
import io
import json
import struct
import zlib
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.errors import InvalidInput, import_optional
from strainwave.io.logs import mat
from strainwave.io.logs.arrays import Arrays, Source, array_table
from strainwave.io.logs.tables import Table, check_unpacked_size, damaged


def open_mat(data: bytes, path: Path) -> Table:
    """Open a MAT file; version 7.3 is HDF5."""
    if data[:4] == b"\x89HDF" or b"MATLAB 7.3" in data[:64]:
        return open_hdf5(data, path, separator=".")
    arrays = Arrays()
    try:
        for name, array in mat.read(data, partial(check_unpacked_size, path=path)):
            arrays.add(name, array)
    except (ValueError, zlib.error, struct.error) as error:
        remedy = "save it again with -v7 or -v7.3"
        raise damaged("a MAT file", error, path, remedy) from error
    return array_table(path, arrays)


def open_numpy(data: bytes, path: Path) -> Table:
    """Open a NumPy file of one or of named arrays; objects are not unpickled."""
    arrays = Arrays()
    try:
        content = np.load(io.BytesIO(data), allow_pickle=False)
        if isinstance(content, np.ndarray):
            content = {"": content}
        else:
            check_unpacked_size(sum(info.file_size for info in content.zip.infolist()), path)
    except InvalidInput:
        raise
    except Exception as error:  # the header is a Python expression with arbitrary faults
        raise damaged("a NumPy file", error, path) from error
    for name in content:
        try:
            arrays.add(name, content[name])
        except Exception as error:
            arrays.omitted[name] = f"unreadable data ({error})"
    return array_table(path, arrays)


# --- HDF5 -------------------------------------------------------------------------------------


def open_hdf5(data: bytes, path: Path, separator: str = "/") -> Table:
    """Open an HDF5 file; groups are separated by `separator` in the names of columns.

    Raises InvalidInput if a link or a dataset refers to another file.
    """
    purpose = "reading HDF5 and MAT v7.3 files"
    h5py = import_optional("h5py", purpose, "'strainwave[hdf5]'", str(path))
    arrays = Arrays()

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
                    arrays.omitted[label.replace("/", separator)] = "links"
        elif isinstance(node, h5py.Dataset):
            if node.external or node.is_virtual:
                raise _refers_elsewhere(name, path)
            label = name.replace("/", separator)
            matlab_class = node.attrs.get("MATLAB_class", b"")
            if matlab_class in (b"char", b"cell", b"logical") or node.shape is None:
                arrays.omitted[label] = "text, cells or flags"
            else:
                arrays.sources[label] = Source(node.shape, node.dtype, partial(load, name))

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
    return array_table(path, arrays)


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
    arrays = Arrays()
    try:
        arrays.add("", document)
    except RecursionError as error:
        raise damaged("JSON of a log", error, path) from error
    return array_table(path, arrays)
