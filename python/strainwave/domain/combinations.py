"""Linear combinations of an arm's parameters: what rigid motion identifies, what is reported."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.arm import ArmDescription
from strainwave.domain.kinds import Key, RigidColumn, Row, kind_of

FRICTION_COLUMNS = 3
"""Viscous, Coulomb, offset: the last columns of each joint."""


def rigid_columns(arm: ArmDescription) -> tuple[RigidColumn, ...]:
    """The rigid model's unknowns: inertias and gravity first, then friction joint by joint."""
    found = list(rigid_body_columns(arm))
    for number, joint in enumerate(arm.joints, start=1):
        revolute = joint.motion == "revolute"
        force = "N m" if revolute else "N"
        viscous = viscous_friction(arm)
        parts = total_viscous_friction(arm, number)
        if viscous == "motor_viscous_friction":
            parts = {(viscous, number): 1.0}
        found.append(RigidColumn(viscous, number, "N m s/rad" if revolute else "N s/m", parts))
        for name in ("motor_coulomb_friction", "friction_offset"):
            found.append(RigidColumn(name, number, force, {(name, number): 1.0}))
    return tuple(found)


def rigid_body_columns(arm: ArmDescription) -> tuple[RigidColumn, ...]:
    """Of these, those that are not friction."""
    found = list(kind_of(arm).rigid_inertias(arm))
    if arm.gravity is not None:
        for number, joint in enumerate(arm.joints, start=1):
            key: Key = (f"gravity_torque_{number}", None)
            found.append(
                RigidColumn(*key, "N m" if joint.motion == "revolute" else "N", {key: 1.0})
            )
    return tuple(found)


def is_rigid_drive(arm: ArmDescription) -> bool:
    """Whether the arm is a motor and a link that a rigid gear makes one body."""
    return arm.n_joints == 1 and not arm.joints[0].elastic


def is_uncoupled(arm: ArmDescription) -> bool:
    """Whether nothing acts on a link but its own gear: no other link, and no gravity."""
    return arm.n_joints == 1 and arm.gravity is None


def viscous_friction(arm: ArmDescription) -> str:
    """By what name rigid motion identifies the joints' viscous friction: c_0 of (18), or d_M."""
    return "motor_viscous_friction" if is_rigid_drive(arm) else "total_viscous_friction"


def total_viscous_friction(arm: ArmDescription, joint: int) -> Row:
    """c_0 = d_M + n^2 d_L of a joint, (18).

    `joint`: From 1.
    """
    ratio = arm.joints[joint - 1].gear_ratio
    return {("motor_viscous_friction", joint): 1.0, ("link_viscous_friction", joint): ratio**2}


def reported(arm: ArmDescription) -> dict[Key, Row]:
    """Combinations that stand in results beside the parameters themselves, by name and joint.

    `total_viscous_friction` of each joint; where links share their inertias, `link_inertia`; and
    the inertia that rigid motion does not separate into motor and link.
    """
    kind, lumped = kind_of(arm), lumped_inertias(arm)
    found: dict[Key, Row] = {}
    for number in range(1, arm.n_joints + 1):
        found["total_viscous_friction", number] = total_viscous_friction(arm, number)
        if ("link_inertia", number) not in kind.inertias:
            found["link_inertia", number] = kind.link_inertia(number)
        found |= {key: row for key, row in lumped.items() if key[1] == number}
    return found


def lumped_inertias(arm: ArmDescription) -> dict[Key, Row]:
    """Inertias that rigid motion does not separate into motor and link.

    `rigid_inertia`, alpha + m_M1/n_1^2, of two links; `inertia`, m_M + n^2 m_L, of one joint.
    """
    columns = kind_of(arm).rigid_inertias(arm)
    return {column.key: column.parts for column in columns if len(column.parts) > 1}


def total_inertia(arm: ArmDescription, joint: int) -> Row:
    """c_1 = m_M + n^2 m_L of a joint, (18), of the rigid model's unknowns.

    `joint`: From 1. Returns: Over `rigid_columns`.
    """
    kind, motor = kind_of(arm), ("motor_inertia", joint)
    n2 = arm.joints[joint - 1].gear_ratio ** 2
    rest: dict[Key, float] = {key: n2 * weight for key, weight in kind.link_inertia(joint).items()}
    rest[motor] = 1.0
    found: dict[Key, float] = {}
    for column in kind.rigid_inertias(arm):
        if motor in column.parts:
            found[column.key] = 1.0 / column.parts[motor]
            rest = {key: weight for key, weight in rest.items() if key not in column.parts}
    return found | rest


def value_of(row: Row, values: Mapping[Key, float]) -> float:
    """A combination's value.

    `values`: (name, joint) -> value of every parameter in it.
    """
    return sum((weight * values[key] for key, weight in row.items()), 0.0)
