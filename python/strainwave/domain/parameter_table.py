"""What is known of every parameter beforehand: symbol, description, units, range.

The core declares those of the equations of motion, beside the equations. Here stand those that
follow from them, and those of effects that change what the core is given.
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

_OF_RECORDS = (
    ParameterDescription(
        "friction_change",
        "phi",
        "relative change of a joint's Coulomb friction in one record",
        ("1", "1"),
        "any",
    ),
    ParameterDescription(
        "drive_gain_change",
        "g_r",
        "relative change of a joint's torque per volt in one record",
        ("1", "1"),
        "any",
    ),
    ParameterDescription(
        "encoder_zero",
        "q_0",
        "what a joint's angle is more than its encoder says",
        ("rad", "m"),
        "any",
    ),
)
"""What effects that the core does not know change in a record."""


def of_record(name: str, record: str) -> str:
    """The name of a parameter that each record has one of.

    `name`: As in docs/notation.md.
    """
    return f"{name}[{record}]"


def base_name(name: str) -> str:
    """The name of a parameter as in docs/notation.md, without that of a record."""
    return name.partition("[")[0]


@cache
def parameter_table() -> Mapping[str, ParameterDescription]:
    """Every parameter of arms and joints by name; of a name that several owners have, the first.

    Returns: In the core's order, then what follows from its parameters or changes them.
    """
    found: dict[str, ParameterDescription] = {}
    for _, name, symbol, description, units, values in declared_in_the_core():
        found.setdefault(name, ParameterDescription(name, symbol, description, units, values))
    for own in (*_DERIVED, *_OF_RECORDS):
        found[own.name] = own
    return MappingProxyType(found)
