"""Arm kinds: one file for each value of `kind` in a study's `[arm]` table.

A new kind needs a file in this package, its name in `strainwave.domain.arm.ArmKind`, an entry in
`KINDS`, and its equations of motion in `rust/core/src/arm`.
"""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.arm import ArmDescription, ArmKind
from strainwave.domain.kinds.base import Fault, Kind, RigidColumn
from strainwave.domain.kinds.planar_two_link import PlanarTwoLink
from strainwave.domain.kinds.single_joint import SingleJoint

__all__ = ["KINDS", "Fault", "Kind", "RigidColumn", "kind_of"]

KINDS: Mapping[ArmKind, Kind] = {
    "planar-two-link": PlanarTwoLink(),
    "single-joint": SingleJoint(),
}


def kind_of(arm: ArmDescription) -> Kind:
    """Kind of an arm."""
    return KINDS[arm.kind]
