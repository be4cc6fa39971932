"""Prior knowledge of every parameter: symbol, description, units and range.

The core declares the parameters of its equations of motion. `parameter_table.toml` adds
combinations of them and the parameters of effects that the core does not simulate.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from strainwave._core import parameter_table as core_parameter_table

Range = Literal["positive", "non-negative", "any"]
"""Range of a parameter's values."""

Family = Literal["inertia", "gravity", "dry friction", "damping", "stiffness", "other"]
"""Physical meaning of a parameter."""

COULOMB = "motor_coulomb_friction"
OFFSET = "friction_offset"
SETTLING = "friction_settling_time"
VISCOUS = ("motor_viscous_friction", "link_viscous_friction")


@dataclass(frozen=True, slots=True)
class ParameterDescription:
    """One parameter under its name in docs/notation.md and in results."""

    name: str
    symbol: str  # plain text, `m_M` is m with the index M; empty: no symbol
    description: str  # in one line
    units: tuple[str, str]  # revolute joint, prismatic joint
    range: Range
    owner: str = ""  # the part of the core that declares it; empty: none

    @property
    def family(self) -> Family:
        """Physical meaning, by unit; torques by the part of the arm that they act on."""
        torque = _TORQUES.get(self.owner, "other") if self.units[0] == "N m" else "other"
        return _FAMILIES.get(self.units[0], torque)


_FAMILIES: Mapping[str, Family] = {
    **dict.fromkeys(("kg m^2", "kg m", "kg"), "inertia"),
    "N m s/rad": "damping",
    "N m/rad": "stiffness",
    "N m/rad^3": "stiffness",
}
_TORQUES: Mapping[str, Family] = {
    "planar-two-link": "gravity",
    "single-joint": "gravity",
    "drive": "dry friction",
}
# of links that several motors turn, where rigid motion does not separate all of them
_GROUPED_FRICTION = ("link_viscous_friction", "total_viscous_friction")
_CHAIN = "serial"  # owner of the standard parameters of links


def of_record(name: str, record: str) -> str:
    """Name of a parameter in one record, such as "friction_change[NAME]"."""
    return f"{name}[{record}]"


def record_of(name: str) -> str:
    """Record of a parameter that belongs to one record; empty for other parameters."""
    return name.partition("[")[2][:-1]


def grouped_name(name: str) -> str:
    """Name of a link's parameter with the parameters that rigid motion groups with it."""
    return f"grouped_{name}"


def base_name(name: str) -> str:
    """Name of a parameter without its record."""
    return name.partition("[")[0]


def family_of(name: str) -> Family:
    """Physical meaning of a parameter; "other" if it is none of arms and joints."""
    described = parameter_table().get(base_name(name))
    return described.family if described else "other"


@cache
def parameter_table() -> Mapping[str, ParameterDescription]:
    """All parameters of arms and joints by name: those of the core, then the additional ones.

    If several parts of the core share a name, the first description counts.
    """
    table: dict[str, ParameterDescription] = {}
    for owner, name, symbol, description, units, values in core_parameter_table():
        declared = ParameterDescription(name, symbol, description, units, values, owner)
        table.setdefault(name, declared)
        if owner == _CHAIN:
            table[grouped_name(name)] = _grouped(declared)
    added = tomllib.loads(
        Path(__file__).with_name("parameter_table.toml").read_text(encoding="utf-8")
    )
    for group in added.values():
        for name, texts in group.items():
            more = {"symbol": texts.get("symbol", ""), "units": tuple(texts["units"])}
            table[name] = ParameterDescription(name, **texts | more)
    for name in _GROUPED_FRICTION:
        table[grouped_name(name)] = _grouped(table[name])
    return MappingProxyType(table)


def _grouped(declared: ParameterDescription) -> ParameterDescription:
    """A parameter with those that rigid motion groups with it; either sign is possible."""
    return replace(
        declared,
        name=grouped_name(declared.name),
        description=f"{declared.description}, with the parameters grouped with it",
        range="any",
    )
