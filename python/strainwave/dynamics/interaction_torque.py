"""Interaction torque: torque of the other links and of gravity on each link, (13), (14)."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, RigidModel
from strainwave.domain.combinations import total_inertia
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable


def base_parameters(model: RigidModel, arm: Arm) -> FloatArray:
    """Base parameters (n_base,) of the arm from the rigid model.

    An inertia that rigid motion does not separate, such as alpha + m_M1/n1^2, counts as the link's;
    see `interaction_torques`. Raises NotIdentifiable if a parameter is unknown.
    """
    rows = arm.links_of_rigid()
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
    """Torque of the other links, of velocities and of gravity on each link, (13), (14).

        tau_i = mbar_i ddq_i - [M(q) ddq + c(q, dq) + g(q)]_i
        mbar_1 = alpha + beta + 2 gamma,   mbar_2 = beta

    mbar_i is the inertia of link i with the arm stretched. For joint 1 this is 2 gamma (1 - cos q2)
    ddq1 - (beta + gamma cos q2) ddq2 - c_1 - g_1. It does not depend on alpha, which is part of
    both mbar_1 and M_11, so alpha + m_M1/n1^2 can replace alpha. Motions are those of the links,
    relative: (n_samples, n_joints). `base` is from `base_parameters`.
    """
    total = arm.link_torques(base, angle, velocity, acceleration)
    return np.asarray(arm.link_inertias(base) * acceleration - total)


def base_variations(model: RigidModel, arm: Arm) -> FloatArray:
    """Derivatives of the base parameters with respect to the rigid model's solution.

    Shape (n_links, n_parameters). Lumped inertias cancel in `interaction_torques` and have zero
    derivatives.
    """
    derivatives = np.zeros((len(arm.base_names), len(model.parameters)))
    derivatives[:, : arm.n_body] = arm.links_of_rigid(motor_share=1.0)
    return derivatives


def total_inertias(model: RigidModel, arm: Arm) -> FloatArray:
    """c_1 = m_M + n^2 m_L of (18), motor side: (n_joints,) [kg m^2].

    Raises NotIdentifiable if a parameter is unknown.
    """
    rows = [total_inertia(arm, joint) for joint in range(1, arm.n_joints + 1)]
    return np.array(
        [sum(weight * known(model, *key) for key, weight in row.items()) for row in rows]
    )


def known(model: RigidModel, name: str, joint: int | None) -> float:
    """Value of a parameter that decoupling needs.

    Raises NotIdentifiable if the motion records do not identify it.
    """
    value = model.value(name, joint)
    if value is None:
        place = f" of joint {joint}" if joint else ""
        raise NotIdentifiable(
            f"the decoupled step needs {name}{place}, which the motion records do not identify"
        )
    return value
