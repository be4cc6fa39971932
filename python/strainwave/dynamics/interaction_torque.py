"""What the other links, rates and gravity do to each link: (13), (14)."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, RigidModel, Study
from strainwave.dynamics.rigid_regressor import gear_ratios
from strainwave.dynamics.simulation import base_names, build_arm, inertia_matrix
from strainwave.errors import NotIdentifiable


def base_parameters(model: RigidModel, study: Study) -> FloatArray:
    """What the link-side inverse dynamics need, from the rigid model.

    In alpha's place stands alpha + m_M1/n1^2, because the rigid model cannot part them; see
    `interaction_torques` for why nothing is lost.

    Parameters
    ----------
    model : RigidModel
    study : Study

    Returns
    -------
    (n_base,)
        In the order of the core's parameters.

    Raises
    ------
    NotIdentifiable
        One of them is not known.
    """
    values = []
    for name, joint in base_names(study):
        if name.startswith("gravity") and study.arm.gravity is None:
            values.append(0.0)
        elif name == "alpha":
            values.append(known(model, "rigid_inertia", 1))
        elif study.arm.n_joints == 1 and not name.startswith("gravity"):
            # its share of the total cancels likewise
            values.append(known(model, "inertia", 1) / study.arm.joints[0].gear_ratio ** 2)
        else:
            values.append(known(model, name, joint))
    return np.array(values)


def interaction_torques(
    study: Study,
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

    Parameters
    ----------
    study : Study
    base : (n_base,)
        From `base_parameters`.
    angle, velocity, acceleration : (n_samples, n_joints) [rad, rad/s, rad/s^2]
        Of the links, relative.

    Returns
    -------
    (n_samples, n_joints) [N m] at the links
    """
    arm = build_arm(study)
    motion = tuple(np.ascontiguousarray(x) for x in (angle, velocity, acceleration))
    rigid = arm.base_regressor(*motion) @ base
    return np.asarray(own_inertias(study, base) * acceleration - rigid)


def base_variations(model: RigidModel, study: Study) -> FloatArray:
    """How the rigid model's errors move what `interaction_torques` needs: d base / d solution.

    The first inertia of a single joint, and alpha, cancel and do not move.

    Parameters
    ----------
    model : RigidModel
    study : Study

    Returns
    -------
    (n_base, n_parameters)
    """
    arm = build_arm(study)
    named = {(p.name, p.joint): k for k, p in enumerate(model.parameters)}
    moved = np.zeros((len(base_parameters(model, study)), len(model.parameters)))
    for row, key in enumerate(arm.parameter_names[: len(moved)]):
        if key in named and (study.arm.n_joints > 1 or key[0].startswith("gravity")):
            moved[row, named[key]] = 1.0
    return moved


def own_inertias(study: Study, base: FloatArray) -> FloatArray:
    """mbar, each link's own inertia with the arm stretched, out of the core's regressor.

    Parameters
    ----------
    study : Study
    base : (n_base,)

    Returns
    -------
    (n_joints,) [kg m^2]
    """
    return np.diagonal(inertia_matrix(study, base, np.zeros(study.arm.n_joints))).copy()


def total_inertias(model: RigidModel, study: Study) -> FloatArray:
    """c_1 = m_M + n^2 m_L of (18), at the motors.

    Parameters
    ----------
    model : RigidModel
    study : Study

    Returns
    -------
    (n_joints,) [kg m^2]

    Raises
    ------
    NotIdentifiable
        A parameter it is made of is not known.
    """
    own = own_inertias(study, base_parameters(model, study)) * gear_ratios(study) ** 2
    if study.arm.n_joints > 1:
        own[1] += known(model, "motor_inertia", 2)
    return np.asarray(own)


def known(model: RigidModel, name: str, joint: int | None) -> float:
    """A parameter of the rigid model that the torques cannot do without.

    Parameters
    ----------
    model : RigidModel
    name : str
    joint : int or None

    Returns
    -------
    float

    Raises
    ------
    NotIdentifiable
        The motion records do not identify it.
    """
    value = model.value(name, joint)
    if value is None:
        place = f" of joint {joint}" if joint else ""
        raise NotIdentifiable(
            f"decoupling needs {name}{place}, which the motion records do not identify"
        )
    return value
