"""Each joint on its own as a linear state-space model: two inertias and a spring between them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from strainwave.domain import Diagnostic, FloatArray
from strainwave.domain.kinds import kind_of
from strainwave.dynamics import two_inertia
from strainwave.dynamics.two_inertia import TwoInertia
from strainwave.errors import InvalidInput
from strainwave.export.source import Export, IdentifiedArm

STATES = ("torsion", "motor_velocity", "link_velocity")
INPUTS = ("motor_torque", "interaction_torque")
OUTPUTS = ("motor_velocity", "link_acceleration")
_SCHEMA = "strainwave/state-space/1"


def state_space(
    arm: IdentifiedArm, joint: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """dx/dt = A x + B u, y = C x + D u of one decoupled joint, (11), (12) in minimal form.

    States: torsion delta = n theta_M - theta_L [rad], motor velocity, link velocity [rad/s].
    Inputs: motor torque less Coulomb friction, interaction torque at the link (13) [N m]. Outputs:
    motor velocity [rad/s], link acceleration [rad/s^2]. The link has the inertia it has at q2 = 0;
    a gear has the stiffness of `GearLaw.linearised_by`; gravity is left out.

    Parameters
    ----------
    arm : IdentifiedArm
    joint : int
        From 1.

    Returns
    -------
    A : (3, 3)
    B : (3, 2)
    C : (2, 3)
    D : (2, 2)

    Raises
    ------
    InvalidInput
        There is no such joint, its gear is rigid, or a parameter is null or impossible.
    """
    A, B, C = two_inertia.state_space(joint_model(arm, joint))
    # the link's acceleration is the third state's derivative
    return A, B, np.vstack([C[0], A[2]]), np.vstack([np.zeros(2), B[2]])


def joint_model(arm: IdentifiedArm, joint: int) -> TwoInertia:
    """The six parameters of one joint, and its gear ratio.

    Parameters
    ----------
    arm : IdentifiedArm
    joint : int
        From 1.

    Returns
    -------
    TwoInertia

    Raises
    ------
    InvalidInput
        There is no such joint, its gear is rigid, or a parameter is null or impossible.
    """
    drive = arm.joint(joint)
    if not drive.elastic:
        raise InvalidInput(
            f"joint {joint} has a rigid gear, and no two inertias with a spring between them",
            where=str(arm.study.path),
            remedy="export to mjcf, urdf, json or c",
        )
    return TwoInertia(
        motor_inertia=arm.need("motor_inertia", joint),
        motor_viscous_friction=arm.need("motor_viscous_friction", joint),
        link_inertia=_link_inertia(arm, joint),
        link_viscous_friction=arm.need("link_viscous_friction", joint),
        gear_stiffness=arm.need(drive.law.linearised_by, joint),
        gear_damping=arm.need("gear_damping", joint),
        gear_ratio=drive.gear_ratio,
    )


def _link_inertia(arm: IdentifiedArm, joint: int) -> float:
    """m_L, or the sum of base parameters that it is, (3)."""
    own = ("link_inertia", joint)
    row = {own: 1.0} if own in arm.values else kind_of(arm.study.arm).link_inertia(joint)
    return sum(weight * arm.need(*key) for key, weight in row.items())


def linearised(arm: IdentifiedArm) -> tuple[Diagnostic, ...]:
    """What a linear model of a joint leaves out, and whoever uses it must know."""
    found = arm.warnings + arm.assumed()
    for number, joint in enumerate(arm.study.arm.joints, start=1):
        if joint.law.is_curved:
            note = joint.law.linearised_note
            found += (Diagnostic("linearised", f"joint {number}", note),)
    return found


def to_state_space(arm: IdentifiedArm) -> Export:
    """All joints' matrices as JSON.

    Parameters
    ----------
    arm : IdentifiedArm

    Returns
    -------
    Export

    Raises
    ------
    InvalidInput
        A gear is rigid, or a parameter is null or impossible.
    """
    joints: list[dict[str, Any]] = []
    for number in range(1, arm.study.arm.n_joints + 1):
        matrices = zip("ABCD", state_space(arm, number), strict=True)
        joints.append({"joint": number} | {name: matrix.tolist() for name, matrix in matrices})
    document = {
        "schema": _SCHEMA,
        "states": STATES,
        "inputs": INPUTS,
        "outputs": OUTPUTS,
        "joints": joints,
    }
    return Export((json.dumps(document, indent=2) + "\n").encode(), linearised(arm))
