"""Kinds of arms: `kind` of a study's `[arm]` -> what its links' parameters are, one file each.

A new kind is a file beside these, its name in `strainwave.domain.arm.ArmKind`, a line below, and
its equations in `rust/core/src/arm`.
"""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.arm import ArmDescription, ArmKind
from strainwave.domain.kinds.base import Fault, Key, Kind, RigidColumn, Row, Values
from strainwave.domain.kinds.planar_two_link import PlanarTwoLink
from strainwave.domain.kinds.single_joint import SingleJoint

__all__ = ["KINDS", "Fault", "Key", "Kind", "RigidColumn", "Row", "Values", "kind_of"]

KINDS: Mapping[ArmKind, Kind] = {
    "planar-two-link": PlanarTwoLink(),
    "single-joint": SingleJoint(),
}


def kind_of(arm: ArmDescription) -> Kind:
    """What an arm's kind says of its links."""
    return KINDS[arm.kind]
