"""Linear combinations of an arm's parameters: unknowns of rigid motion and reported sums."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from strainwave.domain.arm import ArmDescription
from strainwave.domain.arrays import FloatArray
from strainwave.domain.base_parameters import MOTOR_INERTIA, base_parameters, link_inertia
from strainwave.domain.keys import Key, Row
from strainwave.domain.kinds import RigidColumn

LINK_INERTIA = "link_inertia"

FRICTION_COLUMNS = 3
"""Viscous friction, Coulomb friction and offset: the last columns of each joint."""


def rigid_columns(arm: ArmDescription) -> tuple[RigidColumn, ...]:
    """Unknowns of the rigid model: base parameters, then friction joint by joint."""
    columns = list(base_parameters(arm).columns)
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
    lumped, links = lumped_inertias(arm), base_parameters(arm).links
    rows: dict[Key, Row] = {}
    for number in range(1, arm.n_joints + 1):
        rows["total_viscous_friction", number] = total_viscous_friction(arm, number)
        if (LINK_INERTIA, number) not in links:
            rows[LINK_INERTIA, number] = link_inertia(arm, number)
        rows |= {key: row for key, row in lumped.items() if key[1] == number}
    return rows


def lumped_inertias(arm: ArmDescription) -> dict[Key, Row]:
    """Inertias that rigid motion does not separate into motor and link.

    They are `rigid_inertia`, alpha + m_M1/n_1^2, for two links, and `inertia`, m_M + n^2 m_L, for
    one joint.
    """
    columns = base_parameters(arm).columns
    return {column.key: column.parts for column in columns if len(column.parts) > 1}


def total_inertia(arm: ArmDescription, joint: int, posture: FloatArray | None = None) -> Row:
    """c_1 = m_M + n^2 m_L of a joint, from 1, (18), over the unknowns of `rigid_columns`.

    `posture` (n_joints,) are link angles; None: all are zero.
    """
    n2 = arm.joints[joint - 1].gear_ratio ** 2
    row = {key: n2 * weight for key, weight in link_inertia(arm, joint, posture).items()}
    return base_parameters(arm).weights({(MOTOR_INERTIA, joint): 1.0, **row})


def inertias_of_links(arm: ArmDescription) -> tuple[tuple[Key, Row], ...]:
    """Parameters of links that follow from the joints' `link_inertia`, last joint first.

    Each row may use the parameters before it and other parameters of links. For two links, beta =
    m_L2 and alpha = m_L1 - beta - 2 gamma. None follow where only combinations are determined.
    """
    if base_parameters(arm).has_groups:
        return ()
    derived: dict[Key, Row] = {}
    for joint in range(arm.n_joints, 0, -1):
        row = dict(link_inertia(arm, joint))
        key = next((part for part in row if part not in derived), None)
        if key is not None:
            weight = row.pop(key)
            rest = {part: -w / weight for part, w in row.items()}
            derived[key] = {(LINK_INERTIA, joint): 1.0 / weight, **rest}
    return tuple(derived.items())


def change_from(arm: ArmDescription, joint: int, posture: Sequence[float]) -> Row:
    """`link_inertia` of a joint, from 1, at zero angles minus that in a posture, as a row."""
    row = dict(link_inertia(arm, joint))
    for key, weight in link_inertia(arm, joint, np.array(posture)).items():
        row[key] = row.get(key, 0.0) - weight
    return {key: weight for key, weight in row.items() if weight}


def value_of(row: Row, values: Mapping[Key, float]) -> float:
    """Value of a combination from the values of its parameters."""
    return sum((weight * values[key] for key, weight in row.items()), 0.0)
