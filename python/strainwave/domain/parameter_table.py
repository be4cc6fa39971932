"""What is known of every parameter beforehand: symbol, description, units, range.

The core declares those of the equations of motion, beside the equations. Here stand those that
follow from them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Literal

from strainwave._core import parameter_table as declared_in_the_core

Range = Literal["positive", "non-negative", "any"]
"""Values that a parameter of an arm can have."""


@dataclass(frozen=True, slots=True)
class ParameterDescription:
    """One parameter, by the name that it has in docs/notation.md and in results."""

    name: str
    symbol: str  # as plain text: `m_M` is m with the index M; empty: none
    description: str  # in one line
    units: tuple[str, str]  # of a revolute joint, of a prismatic one
    range: Range


_INERTIA = ("kg m^2", "kg")

_DERIVED = (
    ParameterDescription(
        "rigid_inertia",
        "",
        "alpha + m_M1/n1²: inertia of joint 1 with its motor, at the link",
        _INERTIA,
        "positive",
    ),
    ParameterDescription(
        "inertia",
        "c_1",
        "m_M + n² m_L: motor and link together, at the motor",
        _INERTIA,
        "positive",
    ),
    ParameterDescription(
        "total_viscous_friction",
        "c_0",
        "d_M + n² d_L: viscous friction of the joint, at the motor",
        ("N m s/rad", "N s/m"),
        "non-negative",
    ),
)
"""Combinations of the core's parameters that are reported by a name of their own."""


@cache
def parameter_table() -> Mapping[str, ParameterDescription]:
    """Every parameter of arms and joints by name; of a name that several owners have, the first.

    Returns
    -------
    dict
        In the core's order, then what follows from its parameters.
    """
    found: dict[str, ParameterDescription] = {}
    for _, name, symbol, description, units, values in declared_in_the_core():
        found.setdefault(name, ParameterDescription(name, symbol, description, units, values))
    for derived in _DERIVED:
        found[derived.name] = derived
    return MappingProxyType(found)
