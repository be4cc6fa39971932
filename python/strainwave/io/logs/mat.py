"""Read real arrays, also within structs, from MAT files up to version 7.

The layout follows MathWorks, "MAT-File Format". SciPy's reader crashes the process on some damaged
level 5 files, because it looks up an unknown element type beyond the end of a table. Every position
and type is checked here instead. Level 4 files contain only arrays; SciPy reads them.
"""

from __future__ import annotations

import io
import math
import zlib
from collections.abc import Callable, Iterator
from struct import unpack_from
from typing import Any, NamedTuple

import numpy as np

_HEADER_BYTES = 128  # bytes of text, version and byte order
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_FLAGS, _DIMENSIONS, _NAME = 6, 5, 1  # types of a matrix's first three parts
_NUMBERS = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
_STRUCT, _NUMERIC = 2, range(6, 16)  # classes; numeric ones from double to uint64
_OTHERS = {1: "cells", 4: "text", 5: "sparse matrices"}  # classes without channels
_COMPLEX, _LOGICAL = 0x800, 0x200  # flags of an array
_MAX_DEPTH = 16  # of structs in structs
_MAX_STRUCTS = 256  # elements of an array of structs whose members are columns


class Content(NamedTuple):
    """Variables of a file, with members of structs by `.`."""

    arrays: dict[str, np.ndarray[Any, Any]]  # in their stored types
    omitted: dict[str, str]  # name of another variable -> what it holds


class _Part(NamedTuple):
    kind: int
    data: memoryview


def read(data: bytes, check_size: Callable[[float], None]) -> Content:
    """Read a file from its bytes; `check_size` refuses a total of unpacked bytes.

    Raises ValueError, zlib.error or struct.error if the file is damaged.
    """
    content = Content({}, {})
    if 0 in data[:4]:
        return _read_level_4(data)
    if len(data) < _HEADER_BYTES:
        raise ValueError("it ends within its header")
    order = "<" if data[126:128] == b"IM" else ">"
    unpacked = 0.0
    for part in _parts(memoryview(data)[_HEADER_BYTES:], order, is_top=True):
        matrix = part
        if part.kind == _COMPRESSED:
            stream, chunks = zlib.decompressobj(), []
            rest: Any = part.data
            while chunk := stream.decompress(rest, 1 << 24):
                unpacked += len(chunk)
                check_size(unpacked)
                chunks.append(chunk)
                rest = stream.unconsumed_tail
            matrix = next(_parts(memoryview(b"".join(chunks)), order), part)
        if matrix.kind != _MATRIX:
            raise ValueError(f"an element of type {matrix.kind}, not a matrix")
        _collect(matrix.data, order, "", content, 0)
    return content


def _read_level_4(data: bytes) -> Content:
    import scipy.io

    try:
        variables = scipy.io.loadmat(io.BytesIO(data))
    except Exception as error:  # SciPy's reader raises arbitrary exceptions
        raise ValueError(str(error)) from error
    is_array = {
        name: isinstance(v, np.ndarray) and v.dtype.kind in "fiu" for name, v in variables.items()
    }
    return Content(
        {name: value for name, value in variables.items() if is_array[name]},
        {name: "text" for name in variables if not (is_array[name] or name.startswith("__"))},
    )


def _parts(data: memoryview, order: str, *, is_top: bool = False) -> Iterator[_Part]:
    """Yield the elements of a block of data."""
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
        yield _Part(kind, data[start : start + size])


def _collect(data: memoryview, order: str, name: str, content: Content, depth: int) -> None:
    """Add the arrays of a matrix; `name` is that of a member of a struct, else empty."""
    parts = _parts(data, order)
    flags_part = next(parts, _Part(0, data))
    if flags_part.kind != _FLAGS or len(flags_part.data) != 8:
        if not data:
            content.omitted[name] = "no values"
            return
        raise ValueError("a matrix without its flags")
    flags = unpack_from(order + "I", flags_part.data)[0]
    kind = flags & 0xFF
    if kind != _STRUCT and kind not in _NUMERIC and kind not in _OTHERS:
        # the order of parts of opaque classes is undocumented; they contain no channels
        label = next(parts, None)
        name = name or (_text(label.data) if label and label.kind == _NAME else "")
        content.omitted[name or "an object"] = "objects; export their arrays"
        return
    dimensions, label = next(parts, None), next(parts, None)
    if dimensions is None or dimensions.kind != _DIMENSIONS:
        raise ValueError("an array without its dimensions")
    if label is None or label.kind != _NAME:
        raise ValueError("an array without its name")
    name = name or _text(label.data)
    shape = unpack_from(f"{order}{len(dimensions.data) // 4}i", dimensions.data)
    if min(shape, default=0) < 0:
        raise ValueError("an array of negative size")
    if name.startswith("__"):
        return
    if kind == _STRUCT:
        _collect_members(parts, order, name, math.prod(shape), content, depth)
    elif kind in _OTHERS or flags & (_COMPLEX | _LOGICAL):
        numbers = "complex numbers" if flags & _COMPLEX else "flags"
        content.omitted[name] = _OTHERS.get(kind, numbers)
    else:
        values = next(parts, _Part(0, data[:0]))
        if values.kind not in _NUMBERS:
            raise ValueError(f"an array with elements of type {values.kind}")
        array = np.frombuffer(values.data, np.dtype(order + _NUMBERS[values.kind]))
        content.arrays[name] = array.reshape(shape, order="F")


def _collect_members(
    parts: Iterator[_Part], order: str, name: str, n_structs: int, content: Content, depth: int
) -> None:
    length, labels = next(parts, None), next(parts, None)
    if length is None or labels is None or len(length.data) < 4 or depth > _MAX_DEPTH:
        raise ValueError("a struct without its members")
    size = unpack_from(order + "i", length.data)[0]
    if size < 1:
        raise ValueError("a struct without its members")
    if n_structs > _MAX_STRUCTS:
        content.omitted[name] = f"arrays of more than {_MAX_STRUCTS} structs"
        return
    members = [_text(labels.data[k : k + size]) for k in range(0, len(labels.data), size)]
    for index in range(n_structs):
        prefix = name if n_structs == 1 else f"{name}[{index}]"
        for member in members:
            part = next(parts, None)
            if part is None or part.kind != _MATRIX:
                raise ValueError("a struct that ends within its members")
            _collect(part.data, order, f"{prefix}.{member}", content, depth + 1)


def _text(data: memoryview) -> str:
    return bytes(data).split(b"\0")[0].decode("latin-1")
