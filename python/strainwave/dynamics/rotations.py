"""Rotation matrices from rotation vectors, and from roll, pitch and yaw as in URDF."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import FloatArray


def rotation(vector: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) of a rotation vector (3,) [rad], by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def attitude(rpy: Sequence[float]) -> FloatArray:
    """Rotation matrix (3, 3) of roll, pitch and yaw [rad], as in URDF: Rz(yaw) Ry(pitch) Rx(roll).

    Its columns are the sensor's axes in the link's frame.
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def angles(matrix: FloatArray) -> FloatArray:
    """Roll, pitch and yaw (3,) [rad] of a rotation matrix (3, 3)."""
    roll = np.arctan2(matrix[2, 1], matrix[2, 2])
    pitch = -np.arcsin(np.clip(matrix[2, 0], -1.0, 1.0))
    return np.array([roll, pitch, np.arctan2(matrix[1, 0], matrix[0, 0])])
