"""What the other links, rates and gravity do to each link: (13), (14)."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, RigidModel
from strainwave.domain.combinations import total_inertia
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable


def base_parameters(model: RigidModel, arm: Arm) -> FloatArray:
    """What the link-side inverse dynamics need, from the rigid model.

    Where rigid motion does not separate a motor's inertia from a link's, as m_M1/n1^2 from alpha,
    all of it counts as the link's; see `interaction_torques` for why nothing is lost.

    Returns (n_base,): In the order of the core's parameters. Raises `NotIdentifiable`: One of them
    is not known.
    """
    rows = arm.base_of_rigid()
    solution = [
        known(model, *column.key) if row.any() else 0.0
        for column, row in zip(arm.rigid_columns[: arm.n_body], rows.T, strict=True)
    ]
    return np.asarray(rows @ np.array(solution))


def interaction_torques(
    arm: Arm,
    base: FloatArray,
    angle: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
) -> FloatArray:
    """Torque of all the other links, of rates and of gravity on each link, (13), (14).

    tau_i = mbar_i ddq_i - [M(q) ddq + c(q, dq) + g(q)]_i,
    mbar_1 = alpha + beta + 2 gamma, mbar_2 = beta: each link's own inertia, the arm stretched.

    For joint 1 that is 2 gamma (1 - cos q2) ddq1 - (beta + gamma cos q2) ddq2 - c_1 - g_1. Here
    alpha has gone: it is in mbar_1 and, the same, in the (1,1) element of M. So any value may
    stand for it in both, and alpha + m_M1/n1^2 does. Gravity is a torque like the rest.

    `base` (n_base,): From `base_parameters`. `angle`, `velocity`, `acceleration` (n_samples,
    n_joints) [rad, rad/s, rad/s^2]: Of the links, relative. Returns (n_samples, n_joints) [N m].
    """
    rigid = arm.link_torques(base, angle, velocity, acceleration)
    return np.asarray(arm.link_inertias(base) * acceleration - rigid)


def base_variations(model: RigidModel, arm: Arm) -> FloatArray:
    """How the rigid model's errors move what `interaction_torques` needs: d base / d solution.

    Inertias that rigid motion does not separate from a motor's cancel and do not move.

    Returns (n_base, n_parameters).
    """
    moved = np.zeros((len(arm.base_names), len(model.parameters)))
    moved[:, : arm.n_body] = arm.base_of_rigid(motor_share=1.0)
    return moved


def total_inertias(model: RigidModel, arm: Arm) -> FloatArray:
    """c_1 = m_M + n^2 m_L of (18), at the motors.

    Returns (n_joints,) [kg m^2]. Raises `NotIdentifiable`: A parameter it is made of is not known.
    """
    rows = [total_inertia(arm, joint) for joint in range(1, arm.n_joints + 1)]
    return np.array(
        [sum(weight * known(model, *key) for key, weight in row.items()) for row in rows]
    )


def known(model: RigidModel, name: str, joint: int | None) -> float:
    """A parameter of the rigid model that the torques cannot do without.

    Raises `NotIdentifiable`: The motion records do not identify it.
    """
    value = model.value(name, joint)
    if value is None:
        place = f" of joint {joint}" if joint else ""
        raise NotIdentifiable(
            f"decoupling needs {name}{place}, which the motion records do not identify"
        )
    return value
