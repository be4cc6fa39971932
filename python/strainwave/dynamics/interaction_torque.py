"""Interaction torque: torque of the other links and of gravity on each link, (13), (14)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import FloatArray, LinkSignals, RigidModel
from strainwave.domain.arm.combinations import total_inertia
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
    postures: FloatArray | None = None,
) -> FloatArray:
    """Torque of the other links, of velocities and of gravity on each link, (13), (14).

        tau_i = mbar_i ddq_i - [M(q) ddq + c(q, dq) + g(q)]_i,   mbar_i = M(postures_i)_ii

    For two links mbar_1 = alpha + beta + 2 gamma cos q2 and mbar_2 = beta, so that tau_1 does not
    depend on alpha, which is part of both mbar_1 and M_11: alpha + m_M1/n1^2 can replace it.
    Motions are those of the links, relative: (n_samples, n_joints). Row i of `postures` (n_joints,
    n_joints) has the link angles at which mbar_i is taken; None: all are zero. `base` is from
    `base_parameters`.
    """
    at = np.zeros((arm.n_joints, arm.n_joints)) if postures is None else postures
    own = [arm.inertia_matrix(base, posture)[i, i] for i, posture in enumerate(at)]
    return np.asarray(own * acceleration - arm.link_torques(base, angle, velocity, acceleration))


def mean_postures(records: Sequence[LinkSignals]) -> FloatArray:
    """Posture of each joint in the records that excite it, (n_joints, n_joints) [rad].

    Row i is the mean of the link angles over the full-amplitude records that excite joint i, over
    its other records if there are none, or over all records.
    """
    postures = []
    for number in range(1, records[0].link_angle.shape[1] + 1):
        own = [r for r in records if r.experiment.joint in (None, number)]
        full = [r for r in own if r.experiment.use == "frequency"]
        chosen = full or own or records
        postures.append(np.mean([r.link_angle.mean(axis=0) for r in chosen], axis=0))
    return np.array(postures)


def base_variations(model: RigidModel, arm: Arm) -> FloatArray:
    """Derivatives of the base parameters with respect to the rigid model's solution.

    Shape (n_links, n_parameters). Lumped inertias cancel in `interaction_torques` and have zero
    derivatives.
    """
    derivatives = np.zeros((len(arm.base_names), len(model.parameters)))
    derivatives[:, : arm.n_body] = arm.links_of_rigid(motor_share=1.0)
    return derivatives


def total_inertias(model: RigidModel, arm: Arm, postures: FloatArray | None = None) -> FloatArray:
    """c_1 = m_M + n^2 m_L of (18), motor side: (n_joints,) [kg m^2].

    m_L is that of each joint in its posture; None: all angles are zero. Raises NotIdentifiable if
    a parameter is unknown.
    """
    at = np.zeros((arm.n_joints, arm.n_joints)) if postures is None else postures
    rows = [total_inertia(arm, joint, posture) for joint, posture in enumerate(at, start=1)]
    return np.array([sum(w * known(model, *key) for key, w in row.items()) for row in rows])


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
