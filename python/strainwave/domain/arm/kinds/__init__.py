"""Arm kinds: a class for each value of `kind` in a study's `[arm]` table.

A new kind needs a class in this package and its entry in `KINDS`. It is simulated as a chain,
unless `strainwave.domain.arm.description` names a compiled program for it.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from strainwave.domain.arm.description import ArmDescription
from strainwave.domain.arm.kinds.base import Fault as Fault
from strainwave.domain.arm.kinds.base import Kind as Kind
from strainwave.domain.arm.kinds.base import RigidColumn as RigidColumn
from strainwave.domain.arm.kinds.base import SerialChain
from strainwave.domain.arm.kinds.planar import PlanarTwoLink, SingleJoint
from strainwave.domain.arm.kinds.planar import planar_two_link as planar_two_link
from strainwave.domain.arm.kinds.planar import single_joint as single_joint
from strainwave.errors import entry_of

KINDS: dict[str, Kind[Any]] = {
    kind.name: kind for kind in (PlanarTwoLink(), SingleJoint(), SerialChain())
}
"""Kinds of arms that study files describe, by name."""


def kind_of(arm: ArmDescription) -> Kind[Any]:
    """Kind of an arm. Raises InvalidInput if there is none of its name."""
    return entry_of(KINDS, arm.kind, "arm kind", "kind")


def arm_keys(arm: ArmDescription) -> tuple[str, ...]:
    """Keys of the `[arm]` table of an arm of this kind, without `kind`."""
    return tuple(field.name for field in fields(kind_of(arm).table))


def change_arm_keys(arm: ArmDescription, **values: Any) -> ArmDescription:
    """The arm with other values of keys of its `[arm]` table, such as `gravity`."""
    kind = kind_of(arm)
    changed = kind.construct(replace(kind.table_of(arm), **values), arm.joints, arm.servo)
    return replace(changed, coupling=arm.coupling, urdf=arm.urdf)
