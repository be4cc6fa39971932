"""Inspect MAT files up to version 7 before SciPy reads them.

SciPy's reader crashes the process on some damaged level 5 files, because it looks up an unknown
element type beyond the end of a table. This module therefore checks the types first and passes
only real numeric arrays to SciPy. The layout follows MathWorks, "MAT-File Format". Level 4 files
contain only arrays and go directly to SciPy.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator, Sequence
from struct import unpack_from

import numpy as np

from strainwave.domain import FloatArray

_HEADER_BYTES = 128  # bytes of text, version and byte order
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_FLAGS, _DIMENSIONS, _NAME = 6, 5, 1  # types of a matrix's first three parts
_NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})  # data types of numbers
_NUMERIC = range(6, 16)  # classes from double to uint64
_COMPLEX = 0x800  # flag of a complex array
_HEAD_BYTES = 4096  # bytes of a compressed matrix that hold its flags, dimensions and name


def variables(data: bytes) -> dict[str, bool]:
    """Return the variables of a file, and whether each is a real numeric array.

    `data` is the content of the file. Raises ValueError if the file is damaged.
    """
    if 0 in data[:4]:
        return _variables_of_level_4(data)
    if len(data) < _HEADER_BYTES:
        raise ValueError("it ends within its header")
    order = "<" if data[126:128] == b"IM" else ">"
    is_real = {}
    for head in _matrices(data, order):
        name, real = _describe_matrix(head, order)
        if name and not name.startswith("__"):
            is_real[name] = real
    return is_real


def read(data: bytes, names: Sequence[str]) -> dict[str, FloatArray]:
    """Read real arrays by name in their stored types, without singleton dimensions.

    `data` is the content of the file; `names` are real numeric arrays according to `variables`.
    SciPy's reader raises arbitrary exceptions on a damaged file.
    """
    import scipy.io

    arrays = scipy.io.loadmat(io.BytesIO(data), squeeze_me=True, variable_names=list(names))
    return {name: np.asarray(arrays[name]) for name in names}


def _variables_of_level_4(data: bytes) -> dict[str, bool]:
    import scipy.io

    try:
        return {name: kind != "char" for name, _, kind in scipy.io.whosmat(io.BytesIO(data))}
    except Exception as error:  # SciPy's reader raises arbitrary exceptions
        raise ValueError(str(error)) from error


def _matrices(data: bytes, order: str) -> Iterator[bytes]:
    """Yield the decompressed beginning of each matrix."""
    at = _HEADER_BYTES
    while at < len(data):
        if at + 8 > len(data):
            raise ValueError("it ends within an element")
        kind, size = unpack_from(order + "II", data, at)
        at += 8
        if at + size > len(data):
            raise ValueError("it ends within an element")
        if kind == _COMPRESSED:
            head = zlib.decompressobj().decompress(data[at : at + size], _HEAD_BYTES)
            kind = unpack_from(order + "I", head)[0] if len(head) > 8 else kind
            head = head[8:]
        else:
            head = data[at : at + min(size, _HEAD_BYTES)]
        if kind != _MATRIX:
            raise ValueError(f"an element of type {kind}, not a matrix")
        yield head
        at += size


def _describe_matrix(head: bytes, order: str) -> tuple[str, bool]:
    """Return a matrix's name, and whether it contains real numbers that SciPy reads safely."""
    kind, start, size, at = _part(head, 0, order)
    if kind != _FLAGS or size != 8:
        raise ValueError("a matrix without its flags")
    flags = unpack_from(order + "I", head, start)[0]
    if flags & 0xFF not in _NUMERIC:
        # the order of parts of opaque classes is undocumented; they contain no channels
        return _name_of_other(head, at, order), False
    kind, _, _, at = _part(head, at, order)
    if kind != _DIMENSIONS:
        raise ValueError("an array without its dimensions")
    kind, start, size, at = _part(head, at, order)
    if kind != _NAME:
        raise ValueError("an array without its name")
    name = head[start : start + size].decode("latin-1")
    kind = _part(head, at, order)[0]
    if kind not in _NUMBERS:
        raise ValueError(f"an array with elements of type {kind}")
    return name, not flags & _COMPLEX


def _name_of_other(head: bytes, at: int, order: str) -> str:
    try:
        _, _, _, at = _part(head, at, order)
        kind, start, size, _ = _part(head, at, order)
    except ValueError:
        return ""
    return head[start : start + size].decode("latin-1") if kind == _NAME else ""


def _part(head: bytes, at: int, order: str) -> tuple[int, int, int, int]:
    """Return a part's type, data position and data size, and the position of the next part."""
    if at + 8 > len(head):
        raise ValueError("a matrix that ends within its description")
    kind, size = unpack_from(order + "II", head, at)
    if kind >> 16:  # up to four bytes are stored within the tag
        return kind & 0xFFFF, at + 4, kind >> 16, at + 8
    return kind, at + 8, size, at + 8 + -(-size // 8) * 8
