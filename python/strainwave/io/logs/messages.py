"""Name and access the numbers in ROS messages."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

Path = tuple[str, ...]
"""Access path in a message: field names, and indices or joint names after `[`."""

_MAX_ARRAY_ELEMENTS = 64  # maximum number of array elements that become columns
_IGNORED_FIELDS = ("header", "layout")  # fields that are not columns
_STEP = re.compile(r"([^.\[\]]+)|\[([^\]]*)\]")
_ELEMENT = "["  # prefix of an index or joint name in a path


def parse_field(text: str) -> Path:
    """Parse a field such as "position[joint1]", "data[0]" or "linear_acceleration.y"."""
    return tuple(name or _ELEMENT + inside for name, inside in _STEP.findall(text))


def read_number(message: Any, path: Path) -> float | None:
    """Return the number at a path, or None if the message has none."""
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


def list_numbers(message: Any) -> list[str]:
    """Return the names of all numbers in a message."""
    return list(_number_names(message, "", joint_names(message)))


def joint_names(message: Any) -> list[str]:
    """Return the joint names that a message contains, or an empty list."""
    names = getattr(message, "name", None) or getattr(message, "joint_names", None) or []
    return [str(name) for name in names] if isinstance(names, (list, tuple)) else []


def read_stamp(message: Any) -> int:
    """Return the stamp of the header [ns], or 0 if it is missing or not set."""
    header = getattr(message, "header", None)
    if header is None:
        return 0
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _number_names(value: Any, prefix: str, joints: list[str]) -> Iterator[str]:
    if isinstance(value, (bool, int, float)):
        yield prefix
    elif isinstance(value, np.ndarray):
        if value.dtype.kind in "fiub":
            named = (
                joints if len(joints) == len(value) else range(min(len(value), _MAX_ARRAY_ELEMENTS))
            )
            yield from (f"{prefix}[{each}]" for each in named)
    elif isinstance(value, list):
        if len(value) <= _MAX_ARRAY_ELEMENTS:
            for k, each in enumerate(value):
                yield from _number_names(each, f"{prefix}[{k}]", [])
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if field.name in _IGNORED_FIELDS or field.name.endswith("covariance"):
                continue
            inner = f"{prefix}.{field.name}" if prefix else field.name
            yield from _number_names(getattr(value, field.name), inner, joints)
