"""The rigid arm's torques, linear in the base parameters: (5)-(7), (S2), (S3)."""

from __future__ import annotations

import numpy as np

from strainwave.records import FloatArray

TWO_LINK = ("rigid_inertia", "motor_inertia", "beta", "gamma")
GRAVITY = ("gravity_torque_1", "gravity_torque_2")


def two_link(
    angle: FloatArray, velocity: FloatArray, acceleration: FloatArray, gear_ratio: FloatArray
) -> FloatArray:
    """Motor torques of the two-link arm per base parameter, friction left out.

    (S2), (S3) with Q = n q_M.

    Parameters
    ----------
    angle, velocity, acceleration : (n_samples, 2) [rad, rad/s, rad/s^2]
        Of the links, the second relative to the first.
    gear_ratio : (2,)
        n, link turns per motor turn.

    Returns
    -------
    (n_samples, 2, 6)
        Columns: rigid_inertia, motor_inertia of joint 2, beta, gamma, gravity_torque_1,
        gravity_torque_2.
    """
    q1, q2 = angle.T
    v1, v2 = velocity.T
    a1, a2 = acceleration.T
    n1, n2 = gear_ratio
    cos, sin = np.cos(q2), np.sin(q2)
    phi = np.zeros((len(angle), 2, 6))
    phi[:, 0, 0] = n1 * a1
    phi[:, 1, 1] = a2 / n2
    phi[:, 0, 2] = n1 * (a1 + a2)
    phi[:, 1, 2] = n2 * (a1 + a2)
    phi[:, 0, 3] = n1 * (cos * (2.0 * a1 + a2) - (2.0 * v1 + v2) * v2 * sin)
    phi[:, 1, 3] = n2 * (cos * a1 + v1**2 * sin)
    phi[:, 0, 4] = n1 * np.cos(q1)
    phi[:, 0, 5] = n1 * np.cos(q1 + q2)
    phi[:, 1, 5] = n2 * np.cos(q1 + q2)
    return phi


def single_joint(angle: FloatArray, acceleration: FloatArray, gear_ratio: float) -> FloatArray:
    """Motor torque of one joint per base parameter, friction left out.

    torque = inertia ddq_M + n G1 cos(n q_M)

    Parameters
    ----------
    angle, acceleration : (n_samples, 1) [rad, rad/s^2]
        Of the link.
    gear_ratio : float

    Returns
    -------
    (n_samples, 1, 2)
        Columns: inertia (motor side), gravity_torque_1 (link side).
    """
    return np.stack([acceleration / gear_ratio, gear_ratio * np.cos(angle)], axis=2)
