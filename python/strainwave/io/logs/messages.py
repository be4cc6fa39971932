"""Numbers in ROS messages: what they are called, and how to get at them."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

Path = tuple[str, ...]
"""Steps into a message: a field's name, or an index or a joint's name after `[`."""

_LONGEST = 64  # elements of an array that are named one by one
_NOT_MEASURED = ("header", "layout")
_STEP = re.compile(r"([^.\[\]]+)|\[([^\]]*)\]")
_ELEMENT = "["


def parse(text: str) -> Path:
    """A field as written, taken apart.

    Parameters
    ----------
    text : str
        "position[joint1]", "data[0]" or "linear_acceleration.y"

    Returns
    -------
    Path
    """
    return tuple(name or _ELEMENT + inside for name, inside in _STEP.findall(text))


def number(message: Any, path: Path) -> float | None:
    """The number at a path, or None where this message has none there.

    Parameters
    ----------
    message : a deserialised message
    path : Path

    Returns
    -------
    float or None
    """
    value = message
    try:
        for step in path:
            if step.startswith(_ELEMENT):
                value = value[_index(message, value, step[1:])]
            else:
                value = getattr(value, step)
        return float(value)
    except (IndexError, ValueError, AttributeError, TypeError):
        return None


def _index(message: Any, array: Any, inside: str) -> int:
    names = joint_names(message) if isinstance(array, np.ndarray) else []
    return names.index(inside) if inside in names else int(inside)


def numbers(message: Any) -> list[str]:
    """The names of all numbers in a message.

    Parameters
    ----------
    message : a deserialised message

    Returns
    -------
    list of str
    """
    return list(_leaves(message, "", joint_names(message)))


def joint_names(message: Any) -> list[str]:
    """The joints' names, of a message that has them beside its arrays."""
    names = getattr(message, "name", None) or getattr(message, "joint_names", None) or []
    return [str(name) for name in names] if isinstance(names, (list, tuple)) else []


def stamp(message: Any) -> int:
    """The header's stamp [ns]; 0 where there is none, or nobody set it."""
    header = getattr(message, "header", None)
    if header is None:
        return 0
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _leaves(value: Any, prefix: str, joints: list[str]) -> Iterator[str]:
    if isinstance(value, (bool, int, float)):
        yield prefix
    elif isinstance(value, np.ndarray):
        if value.dtype.kind in "fiub":
            named = joints if len(joints) == len(value) else range(min(len(value), _LONGEST))
            yield from (f"{prefix}[{each}]" for each in named)
    elif isinstance(value, list):
        if len(value) <= _LONGEST:
            for k, each in enumerate(value):
                yield from _leaves(each, f"{prefix}[{k}]", [])
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if field.name in _NOT_MEASURED or field.name.endswith("covariance"):
                continue
            inner = f"{prefix}.{field.name}" if prefix else field.name
            yield from _leaves(getattr(value, field.name), inner, joints)
