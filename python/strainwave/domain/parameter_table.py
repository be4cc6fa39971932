"""Prior knowledge of every parameter: symbol, description, units and range.

The core declares the parameters of its equations of motion. This module adds combinations of them
and the parameters of effects that the core does not simulate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Literal

from strainwave._core import parameter_table as core_parameter_table

Range = Literal["positive", "non-negative", "any"]
"""Range of a parameter's values."""


@dataclass(frozen=True, slots=True)
class ParameterDescription:
    """One parameter under its name in docs/notation.md and in results."""

    name: str
    symbol: str  # plain text, `m_M` is m with the index M; empty: no symbol
    description: str  # in one line
    units: tuple[str, str]  # revolute joint, prismatic joint
    range: Range


_INERTIA = ("kg m^2", "kg")

_DERIVED = (
    ParameterDescription(
        "rigid_inertia",
        "",
        "alpha + m_M1/n1²: inertia of joint 1 with its motor, link side",
        _INERTIA,
        "positive",
    ),
    ParameterDescription(
        "inertia",
        "c_1",
        "m_M + n² m_L: inertia of motor and link, motor side",
        _INERTIA,
        "positive",
    ),
    ParameterDescription(
        "total_viscous_friction",
        "c_0",
        "d_M + n² d_L: viscous friction of the joint, motor side",
        ("N m s/rad", "N s/m"),
        "non-negative",
    ),
)
"""Combinations of the core's parameters that results report by name."""

_EFFECT_PARAMETERS = (
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
        "joint angle minus encoder reading",
        ("rad", "m"),
        "any",
    ),
)
"""Parameters of effects that the core does not simulate."""


def of_record(name: str, record: str) -> str:
    """Name of a parameter in one record, such as "friction_change[NAME]"."""
    return f"{name}[{record}]"


def base_name(name: str) -> str:
    """Name of a parameter without its record."""
    return name.partition("[")[0]


@cache
def parameter_table() -> Mapping[str, ParameterDescription]:
    """All parameters of arms and joints by name: those of the core, then the additional ones.

    If several parts of the core share a name, the first description counts.
    """
    table: dict[str, ParameterDescription] = {}
    for _, name, symbol, description, units, values in core_parameter_table():
        table.setdefault(name, ParameterDescription(name, symbol, description, units, values))
    for parameter in (*_DERIVED, *_EFFECT_PARAMETERS):
        table[parameter.name] = parameter
    return MappingProxyType(table)
