"""Open files of named arrays: MAT, HDF5, NPZ, NPY and JSON.

The layout of MAT files follows MathWorks, "MAT-File Format". SciPy's reader crashes the process on
some damaged level 5 files, because it looks up an unknown element type beyond the end of a table.
Every position and type is checked here instead. SciPy reads level 4 files, which are only arrays.
"""

from __future__ import annotations

import codecs
import io
import json
import math
import struct
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from struct import unpack_from
from typing import Any

import numpy as np

from strainwave.errors import InvalidInput, import_optional
from strainwave.io.logs.arrays import Arrays, Source, array_table
from strainwave.io.logs.tables import LogTable, check_unpacked_size, damaged

_HEADER_BYTES = 128  # bytes of text, version and byte order
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_FLAGS, _DIMENSIONS, _NAME = 6, 5, 1  # types of a matrix's first three parts
_INT8, _INT32 = 1, 5
_TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "", "f8", "", "", "i8", "u8")
_NUMBERS = {number: name for number, name in enumerate(_TYPES, start=1) if name}
_STRUCT, _NUMERIC = 2, range(6, 16)  # classes; numeric ones from double to uint64
_OTHERS = {1: object, 4: str, 5: object}  # cells, text and sparse matrices contain no channels
_COMPLEX, _LOGICAL = 0x800, 0x200  # flags of an array
_MAX_DEPTH = 16  # of structs in structs
_MAX_STRUCTS = 256  # elements of an array of structs whose members are columns


def read_mat(
    data: bytes, check_size: Callable[[float], None]
) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """Yield the arrays of a file by name in their stored types.

    A member of a struct is named by `.`; of text, cells, flags, complex numbers and objects, only
    the type is kept, in an empty array. `check_size` refuses a total of unpacked bytes. Raises
    ValueError, zlib.error or struct.error if the file is damaged.
    """
    if 0 in data[:4]:
        import scipy.io

        try:
            variables = scipy.io.loadmat(io.BytesIO(data))
        except Exception as error:  # SciPy's reader raises arbitrary exceptions
            raise ValueError(str(error)) from error
        yield from ((name, v) for name, v in variables.items() if not name.startswith("__"))
        return
    if len(data) < _HEADER_BYTES:
        raise ValueError("it ends within its header")
    order = "<" if data[126:128] == b"IM" else ">"
    unpacked = 0.0
    for element in _parts(memoryview(data)[_HEADER_BYTES:], order, is_top=True):
        kind, part = element
        if kind == _COMPRESSED:
            stream, chunks = zlib.decompressobj(), []
            rest: Any = part
            while chunk := stream.decompress(rest, 1 << 24):
                unpacked += len(chunk)
                check_size(unpacked)
                chunks.append(chunk)
                rest = stream.unconsumed_tail
            kind, part = next(_parts(memoryview(b"".join(chunks)), order), element)
        if kind != _MATRIX:
            raise ValueError(f"an element of type {kind}, not a matrix")
        yield from _arrays(part, order, "", 0)


def _parts(
    data: memoryview, order: str, *, is_top: bool = False
) -> Iterator[tuple[int, memoryview]]:
    """Yield the type and the data of the elements of a block."""
    at = 0
    while at < len(data):
        if at + 8 > len(data):
            raise ValueError("it ends within an element")
        kind, size = unpack_from(order + "II", data, at)
        start = at + 8
        if kind >> 16:  # up to four bytes are stored within the tag
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            at += 8
        else:  # the elements of a file are not padded, those of a matrix are
            at = start + (size if is_top else -(-size // 8) * 8)
        if start + size > len(data):
            raise ValueError("it ends within an element")
        yield kind, data[start : start + size]


def _arrays(
    data: memoryview, order: str, name: str, depth: int
) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """Yield the arrays of a matrix; `name` is that of a member of a struct, else empty."""
    parts = _parts(data, order)

    def take(expected: int, what: str) -> memoryview:
        kind, part = next(parts, (0, data))
        if kind != expected:
            raise ValueError(f"a matrix without its {what}")
        return part

    if not data:  # a member without value
        yield name, np.empty(0)
        return
    flags = unpack_from(order + "I", take(_FLAGS, "flags"))[0]
    kind = flags & 0xFF
    if kind != _STRUCT and kind not in _NUMERIC and kind not in _OTHERS:
        # the order of parts of opaque classes is undocumented; they contain no channels
        kind, part = next(parts, (0, data))
        yield name or (_text(part) if kind == _NAME else "an object"), np.empty(0, dtype=object)
        return
    sizes = take(_DIMENSIONS, "dimensions")
    shape = unpack_from(f"{order}{len(sizes) // 4}i", sizes)
    label = take(_NAME, "name")
    name = name or _text(label)
    if min(shape, default=0) < 0:
        raise ValueError("an array of negative size")
    if name.startswith("__"):
        return
    if kind in _OTHERS or flags & (_COMPLEX | _LOGICAL):
        yield name, np.empty(0, _OTHERS.get(kind, complex if flags & _COMPLEX else bool))
    elif kind == _STRUCT:
        size = unpack_from(order + "i", take(_INT32, "length of names"))[0]
        labels = take(_INT8, "names of members")
        if size < 1 or depth > _MAX_DEPTH:
            raise ValueError("a struct without its members")
        count = math.prod(shape)
        if count > _MAX_STRUCTS:
            yield name, np.empty(0, dtype=object)
            return
        for index in range(count):
            prefix = name if count == 1 else f"{name}[{index}]"
            for k in range(0, len(labels), size):
                member = take(_MATRIX, "members")
                member_name = f"{prefix}.{_text(labels[k : k + size])}"
                yield from _arrays(member, order, member_name, depth + 1)
    else:
        kind, values = next(parts, (0, data))
        if kind not in _NUMBERS:
            raise ValueError(f"an array with elements of type {kind}")
        array = np.frombuffer(values, np.dtype(order + _NUMBERS[kind]))
        yield name, array.reshape(shape, order="F")


def _text(data: memoryview) -> str:
    return bytes(data).split(b"\0")[0].decode("latin-1")


def open_mat(data: bytes, path: Path) -> LogTable:
    """Open a MAT file; version 7.3 is HDF5."""
    if data[:4] == b"\x89HDF" or b"MATLAB 7.3" in data[:64]:
        return open_hdf5(data, path, separator=".")
    arrays = Arrays()
    try:
        for name, array in read_mat(data, partial(check_unpacked_size, path=path)):
            arrays.add(name, array)
    except (ValueError, zlib.error, struct.error) as error:
        remedy = "save it again with -v7 or -v7.3"
        raise damaged("a MAT file", error, path, remedy) from error
    return array_table(path, arrays)


def open_numpy(data: bytes, path: Path) -> LogTable:
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


def open_hdf5(data: bytes, path: Path, separator: str = "/") -> LogTable:
    """Open an HDF5 file; groups are separated by `separator` in the names of columns.

    Raises InvalidInput if a link or a dataset refers to another file.
    """
    purpose = "reading HDF5 and MAT v7.3 files"
    h5py = import_optional("h5py", purpose, "h5py", str(path))
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


def open_json(data: bytes, path: Path) -> LogTable:
    """Open a JSON file of records or columns."""
    try:
        document = json.loads(data.removeprefix(codecs.BOM_UTF8))
    except (ValueError, RecursionError) as error:
        if b"\n" in data.strip() and data.lstrip()[:1] == b"{":
            return open_json_lines(data, path)
        raise damaged("JSON", error, path) from error
    return _json_table(document, path)


def open_json_lines(data: bytes, path: Path) -> LogTable:
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


def _json_table(document: Any, path: Path) -> LogTable:
    arrays = Arrays()
    try:
        arrays.add("", document)
    except RecursionError as error:
        raise damaged("JSON of a log", error, path) from error
    return array_table(path, arrays)
