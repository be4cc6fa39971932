"""Arm kinds: one file for each value of `kind` in a study's `[arm]` table.

A new kind needs a file in this package, its name in `strainwave.domain.arm.ArmKind`, an entry in
`KINDS`, and its equations of motion in `rust/core/src/arm`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from strainwave.domain.arm import ArmDescription, ArmKind
from strainwave.domain.kinds.base import Fault, Kind, RigidColumn
from strainwave.domain.kinds.planar_two_link import PlanarTwoLink, planar_two_link
from strainwave.domain.kinds.single_joint import SingleJoint, single_joint

__all__ = [
    "KINDS",
    "Fault",
    "Kind",
    "RigidColumn",
    "change_arm_keys",
    "kind_of",
    "planar_two_link",
    "single_joint",
]

KINDS: Mapping[ArmKind, Kind[Any]] = {
    "planar-two-link": PlanarTwoLink(),
    "single-joint": SingleJoint(),
}


def kind_of(arm: ArmDescription) -> Kind[Any]:
    """Kind of an arm."""
    return KINDS[arm.kind]


def change_arm_keys(arm: ArmDescription, **values: Any) -> ArmDescription:
    """The arm with other values of keys of its `[arm]` table, such as `gravity`."""
    kind = kind_of(arm)
    return kind.construct(replace(kind.table_of(arm), **values), arm.joints, arm.servo)
