"""Linear combinations of an arm's parameters: unknowns of rigid motion and reported sums."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain.arm.base_parameters import (
    MOTOR_INERTIA,
    base_parameters,
    link_inertia,
    transmission,
)
from strainwave.domain.arm.description import ArmDescription, unit_in
from strainwave.domain.arm.kinds import RigidColumn
from strainwave.domain.arm.link_sensors.link_space import are_parallel, attitude
from strainwave.domain.arm.parameter_table import grouped_name
from strainwave.domain.keys import FloatArray, JointNumber, Key, Row, Values

LINK_INERTIA = "link_inertia"

FRICTION_COLUMNS = 3
"""Viscous friction, Coulomb friction, offset: columns of each joint, after base parameters."""

_MAX_ROUNDING_ERROR = 1e-8  # relative, of elements of viscous friction matrices
_MAX_SINE = 1e-3  # of the angle between an axis and gravity that count as parallel


def rigid_columns(arm: ArmDescription) -> tuple[RigidColumn, ...]:
    """Unknowns of the rigid model: base parameters, friction joint by joint, friction of links.

    The latter are those of `shared_viscous_friction`.
    """
    shared = shared_viscous_friction(arm)
    columns = list(base_parameters(arm).columns)
    for number, joint in enumerate(arm.joints, start=1):
        force = "N m" if joint.motion == "revolute" else "N"
        viscous = viscous_friction(arm)
        parts = total_viscous_friction(arm, number)
        if viscous == "motor_viscous_friction":
            parts = {(viscous, number): 1.0}
        grouped = sum_of(parts, shared.at_motors.get(number, {}))
        name = viscous if grouped == parts else grouped_name(viscous)
        columns.append(RigidColumn(name, number, unit_in(arm, (viscous, number)), grouped))
        for name in ("motor_coulomb_friction", "friction_offset"):
            columns.append(RigidColumn(name, number, force, {(name, number): 1.0}))
    return (*columns, *shared.columns)


@dataclass(frozen=True, slots=True)
class SharedViscousFriction:
    """Viscous friction of links that several motors turn, which rigid motion separates.

    The motor torques of all viscous friction are (D_M + T' D_L T) dtheta_M with T = C N. Its
    diagonal shows `total_viscous_friction`; the friction of a link that several motors turn has
    further elements.
    """

    columns: tuple[RigidColumn, ...]  # `link_viscous_friction`
    matrices: FloatArray  # (n_columns, n_joints, n_joints) torques per motor velocity
    at_motors: Mapping[int, Row]  # further parts of the joints' viscous friction, by joint


def shared_viscous_friction(arm: ArmDescription) -> SharedViscousFriction:
    """Viscous friction of links that rigid motion separates from that of motors.

    Links whose matrix depends on those of others, as in differential wrists, are grouped.
    """
    if arm.coupling is None:
        return SharedViscousFriction((), np.zeros((0, arm.n_joints, arm.n_joints)), {})
    T, n = transmission(arm), arm.n_joints
    own = np.array([np.diag(unit) for unit in np.eye(n)])
    # without n_j^2, which is part of the total viscous friction
    ratios = np.array([joint.gear_ratio for joint in arm.joints])
    further = T[:, :, None] * T[:, None, :] - own * ratios[:, None, None] ** 2
    sizes = np.linalg.norm(further, axis=(1, 2))
    basis, independent, groups = own.reshape(n, -1), [], []
    for j in np.flatnonzero(sizes > _MAX_ROUNDING_ERROR * np.max(T**2)).tolist():
        scaled = (further[j] / sizes[j]).ravel()
        weights = np.linalg.lstsq(basis.T, scaled)[0]
        if np.linalg.norm(scaled - weights @ basis) > _MAX_ROUNDING_ERROR:
            independent.append(j)
            basis = np.vstack([basis, further[j].ravel()])
        else:
            groups.append((j, weights * sizes[j]))
    parts: list[Values] = [{("link_viscous_friction", j + 1): 1.0} for j in independent]
    at_motors: dict[int, Row] = {}
    for j, weights in groups:
        key = ("link_viscous_friction", j + 1)
        for i in np.flatnonzero(np.abs(weights[:n]) > _MAX_ROUNDING_ERROR * sizes[j]).tolist():
            at_motors[i + 1] = sum_of(at_motors.get(i + 1, {}), {key: float(weights[i])})
        for row, weight in zip(parts, weights[n:].tolist(), strict=False):
            row[key] = weight
    columns = []
    for j, row in zip(independent, parts, strict=True):
        used = {key: weight for key, weight in row.items() if abs(weight) > _MAX_ROUNDING_ERROR}
        name = "link_viscous_friction"
        unit = unit_in(arm, (name, j + 1))
        columns.append(
            RigidColumn(name if len(used) == 1 else grouped_name(name), j + 1, unit, used)
        )
    return SharedViscousFriction(tuple(columns), further[independent], at_motors)


def is_rigid_drive(arm: ArmDescription) -> bool:
    """Whether the arm is one joint with a rigid gear."""
    return arm.n_joints == 1 and not arm.joints[0].elastic


def is_uncoupled(arm: ArmDescription) -> bool:
    """Whether only the gear acts on the link: one joint, no gravity."""
    return arm.n_joints == 1 and arm.gravity is None


def has_posture_free(arm: ArmDescription, number: JointNumber) -> bool:
    """Whether neither gravity nor the inertia of the arm depends on the angle of a motor.

    So it is for sliding joints behind sliding joints, and for the first joint if it slides or turns
    about an axis along gravity.
    """
    before = arm.joints[: number - 1]
    if arm.is_coupled or any(joint.motion != "prismatic" for joint in before):
        return False
    joint = arm.joints[number - 1]
    if joint.motion == "prismatic" or number > 1 or not arm.gravity:
        return joint.motion == "prismatic" or number == 1
    axis = attitude(joint.origin.rpy) @ joint.axis
    return are_parallel(axis, np.array(arm.gravity), _MAX_SINE)


def viscous_friction(arm: ArmDescription) -> str:
    """Name of the joints' viscous friction in the rigid model: c_0 of (18), or d_M."""
    return "motor_viscous_friction" if is_rigid_drive(arm) else "total_viscous_friction"


def total_viscous_friction(arm: ArmDescription, joint: JointNumber) -> Row:
    """c_0 = d_M + n^2 d_L of a joint (18)."""
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


def total_inertia(
    arm: ArmDescription, joint: JointNumber, posture: FloatArray | None = None
) -> Row:
    """c_1 = m_M + n^2 m_L of a joint (18), over the unknowns of `rigid_columns`.

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


def change_from(arm: ArmDescription, joint: JointNumber, posture: Sequence[float]) -> Row:
    """`link_inertia` of a joint at zero angles minus that in a posture, as a row."""
    row = dict(link_inertia(arm, joint))
    for key, weight in link_inertia(arm, joint, np.array(posture)).items():
        row[key] = row.get(key, 0.0) - weight
    return {key: weight for key, weight in row.items() if weight}


def sum_of(row: Row, other: Row) -> Row:
    """Sum of two combinations, without parameters that cancel."""
    pairs = {key: (row.get(key, 0.0), other.get(key, 0.0)) for key in (*row, *other)}
    return {
        key: a + b for key, (a, b) in pairs.items() if abs(a + b) > _MAX_ROUNDING_ERROR * abs(a)
    }


def value_of(row: Row, values: Mapping[Key, float]) -> float:
    """Value of a combination from the values of its parameters."""
    return sum((weight * values[key] for key, weight in row.items()), 0.0)
