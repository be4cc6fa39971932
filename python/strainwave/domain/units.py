"""Units of parameters."""

from __future__ import annotations

from strainwave.domain.arm import ArmDescription, Joint
from strainwave.domain.keys import Key
from strainwave.domain.parameter_table import base_name, parameter_table


def unit_of(name: str, joint: Joint | None = None) -> str:
    """SI unit of a parameter, by its name in docs/notation.md; None for a parameter of the arm.

    Raises KeyError if there is no parameter of that name.
    """
    return parameter_table()[base_name(name)].units[
        joint is not None and joint.motion == "prismatic"
    ]


def unit_in(arm: ArmDescription, key: Key) -> str:
    """SI unit of a parameter of an arm, by name and joint, from 1."""
    name, joint = key
    return unit_of(name, None if joint is None else arm.joints[joint - 1])
