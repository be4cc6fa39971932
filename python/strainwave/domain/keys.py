"""Types that records share: arrays, and keys of parameters with mappings over them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int_]
ComplexArray = NDArray[np.complex128]


JointNumber: TypeAlias = int
"""A joint as people count: from 1, at the base. Study files, results and messages have these."""

JointIndex: TypeAlias = int
"""A joint as a column or an element of an array: from 0."""

Key = tuple[str, JointNumber | None]
"""Name of a parameter and its joint; None for parameters of the whole arm."""

Values = dict[Key, float]
"""Parameter values."""

Row = Mapping[Key, float]
"""Weights of a linear combination of parameters."""


def label_of(name: str, joint: int | None) -> str:
    """Name and joint, as in the verdict: "gear_stiffness 1", or "beta" for the whole arm."""
    return name if joint is None else f"{name} {joint}"


class Keyed:
    """Mixin of records about one parameter."""

    __slots__ = ()
    name: str
    joint: int | None

    @property
    def key(self) -> Key:
        """Name and joint."""
        return self.name, self.joint

    @property
    def label(self) -> str:
        """Name and joint, as in the verdict."""
        return label_of(self.name, self.joint)


def grouped_labels(keys: Iterable[Key]) -> tuple[str, ...]:
    """Labels of parameters, with all joints of a name in one: `link_inertia_xy 2-5,7`."""
    joints: dict[str, list[int]] = {}
    for name, joint in keys:
        joints.setdefault(name, []).extend([] if joint is None else [joint])
    return tuple(f"{name} {_ranges(each)}" if each else name for name, each in joints.items())


def _ranges(numbers: Iterable[int]) -> str:
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ",".join(
        f"{run[0]}-{run[-1]}" if len(run) > 2 else ",".join(map(str, run)) for run in runs
    )
