"""Motion of a payload on the last link of any arm."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, Payload
from strainwave.dynamics.arm import Arm


def payload_motion(
    model: Arm,
    payload: Payload,
    angle: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Jacobian (n, 3, n_joints) of a payload's position and its specific force (n, 3).

    Both in the frame of the last link; the motion has the shape (n, n_joints).
    """
    at = np.array(payload.xyz)

    def force(velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        motion = model.link_motion(angle, velocity, acceleration)[:, -1]
        rate, turning, origin = motion[:, :3], motion[:, 3:6], motion[:, 6:]
        return np.asarray(origin + np.cross(turning, at) + np.cross(rate, np.cross(rate, at)))

    rest = np.zeros_like(angle)
    load = force(rest, rest)
    units = (rest + unit for unit in np.eye(model.n_joints))
    jacobian = np.stack([force(rest, unit) - load for unit in units], axis=2)
    return jacobian, force(velocity, acceleration)


def payload_torques(
    model: Arm,
    payload: Payload,
    angle: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
) -> FloatArray:
    """Torques of the links that move a payload: (n, n_joints)."""
    jacobian, force = payload_motion(model, payload, angle, velocity, acceleration)
    return np.asarray(payload.mass * np.einsum("pxj,px->pj", jacobian, force))
