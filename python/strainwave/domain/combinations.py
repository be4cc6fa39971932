"""Linear combinations of an arm's parameters: unknowns of rigid motion and reported sums."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.arm import ArmDescription
from strainwave.domain.keys import Key, Row
from strainwave.domain.kinds import RigidColumn, kind_of

FRICTION_COLUMNS = 3
"""Viscous friction, Coulomb friction and offset: the last columns of each joint."""


def rigid_columns(arm: ArmDescription) -> tuple[RigidColumn, ...]:
    """Unknowns of the rigid model: inertias and gravity, then friction joint by joint."""
    columns = list(rigid_body_columns(arm))
    for number, joint in enumerate(arm.joints, start=1):
        revolute = joint.motion == "revolute"
        force = "N m" if revolute else "N"
        viscous = viscous_friction(arm)
        parts = total_viscous_friction(arm, number)
        if viscous == "motor_viscous_friction":
            parts = {(viscous, number): 1.0}
        columns.append(RigidColumn(viscous, number, "N m s/rad" if revolute else "N s/m", parts))
        for name in ("motor_coulomb_friction", "friction_offset"):
            columns.append(RigidColumn(name, number, force, {(name, number): 1.0}))
    return tuple(columns)


def rigid_body_columns(arm: ArmDescription) -> tuple[RigidColumn, ...]:
    """Unknowns of the rigid model without friction: inertias and gravity."""
    columns = list(kind_of(arm).rigid_inertias(arm))
    if arm.gravity is not None:
        for number, joint in enumerate(arm.joints, start=1):
            key: Key = (f"gravity_torque_{number}", None)
            columns.append(
                RigidColumn(*key, "N m" if joint.motion == "revolute" else "N", {key: 1.0})
            )
    return tuple(columns)


def is_rigid_drive(arm: ArmDescription) -> bool:
    """Whether the arm is one joint with a rigid gear."""
    return arm.n_joints == 1 and not arm.joints[0].elastic


def is_uncoupled(arm: ArmDescription) -> bool:
    """Whether only the gear acts on the link: one joint, no gravity."""
    return arm.n_joints == 1 and arm.gravity is None


def viscous_friction(arm: ArmDescription) -> str:
    """Name of the joints' viscous friction in the rigid model: c_0 of (18), or d_M."""
    return "motor_viscous_friction" if is_rigid_drive(arm) else "total_viscous_friction"


def total_viscous_friction(arm: ArmDescription, joint: int) -> Row:
    """c_0 = d_M + n^2 d_L of a joint, from 1, (18)."""
    ratio = arm.joints[joint - 1].gear_ratio
    return {("motor_viscous_friction", joint): 1.0, ("link_viscous_friction", joint): ratio**2}


def reported(arm: ArmDescription) -> dict[Key, Row]:
    """Combinations that results report in addition to the parameters.

    They are `total_viscous_friction` of each joint, `link_inertia` if the links share inertias, and
    the inertia that rigid motion does not separate into motor and link.
    """
    kind, lumped = kind_of(arm), lumped_inertias(arm)
    rows: dict[Key, Row] = {}
    for number in range(1, arm.n_joints + 1):
        rows["total_viscous_friction", number] = total_viscous_friction(arm, number)
        if ("link_inertia", number) not in kind.inertias:
            rows["link_inertia", number] = kind.link_inertia(number)
        rows |= {key: row for key, row in lumped.items() if key[1] == number}
    return rows


def lumped_inertias(arm: ArmDescription) -> dict[Key, Row]:
    """Inertias that rigid motion does not separate into motor and link.

    They are `rigid_inertia`, alpha + m_M1/n_1^2, for two links, and `inertia`, m_M + n^2 m_L, for
    one joint.
    """
    columns = kind_of(arm).rigid_inertias(arm)
    return {column.key: column.parts for column in columns if len(column.parts) > 1}


def total_inertia(arm: ArmDescription, joint: int) -> Row:
    """c_1 = m_M + n^2 m_L of a joint, from 1, (18), over the unknowns of `rigid_columns`."""
    kind, motor = kind_of(arm), ("motor_inertia", joint)
    n2 = arm.joints[joint - 1].gear_ratio ** 2
    rest: dict[Key, float] = {key: n2 * weight for key, weight in kind.link_inertia(joint).items()}
    rest[motor] = 1.0
    combination: dict[Key, float] = {}
    for column in kind.rigid_inertias(arm):
        if motor in column.parts:
            combination[column.key] = 1.0 / column.parts[motor]
            rest = {key: weight for key, weight in rest.items() if key not in column.parts}
    return combination | rest


def value_of(row: Row, values: Mapping[Key, float]) -> float:
    """Value of a combination from the values of its parameters."""
    return sum((weight * values[key] for key, weight in row.items()), 0.0)
