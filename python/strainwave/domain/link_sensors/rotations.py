"""Rotation matrices from rotation vectors, and from roll, pitch and yaw as in URDF."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from strainwave.domain.arrays import FloatArray

_RIGHT_ANGLE = 1e-9  # cosine of a pitch below which roll and yaw turn about the same axis
_MAX_AXIAL_SHARE = 0.999  # of a direction along the link, as in the core


def rotation(vector: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) of a rotation vector (3,) [rad], by Rodrigues' formula."""
    # in scalars: searches evaluate it 10,000 times, and NumPy takes 10 us per operation
    x, y, z = vector.tolist()
    angle = math.hypot(x, y, z)
    a, b = _sinc(angle), 0.5 * _sinc(0.5 * angle) ** 2
    return np.array(
        [
            [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
        ]
    )


def _sinc(angle: float) -> float:
    """The quotient sin(angle) / angle, 1 at zero."""
    return math.sin(angle) / angle if angle else 1.0


def attitude(rpy: Sequence[float]) -> FloatArray:
    """Rotation matrix (3, 3) of roll, pitch and yaw [rad], as in URDF: Rz(yaw) Ry(pitch) Rx(roll).

    Its columns are the sensor's axes in the link's frame.
    """
    (cr, cp, cy), (sr, sp, sy) = map(math.cos, rpy), map(math.sin, rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def angles(matrix: FloatArray) -> FloatArray:
    """Roll, pitch and yaw (3,) [rad] of a rotation matrix (3, 3).

    The roll is zero where the pitch is a right angle, because only its sum with the yaw counts.
    """
    level = np.hypot(matrix[0, 0], matrix[1, 0])
    pitch = -np.arctan2(matrix[2, 0], level)
    if level < _RIGHT_ANGLE:
        return np.array([0.0, pitch, np.arctan2(-matrix[0, 1], matrix[1, 1])])
    roll = np.arctan2(matrix[2, 1], matrix[2, 2])
    return np.array([roll, pitch, np.arctan2(matrix[1, 0], matrix[0, 0])])


def axes_about(axis: Sequence[float]) -> FloatArray:
    """Directions x, y and z of a right-handed frame in rows, with z along an axis.

    x is the direction along the link as far as it is perpendicular to the axis.
    """
    z = np.array(axis) / np.linalg.norm(axis)
    across = (np.eye(3) - np.outer(z, z))[0 if abs(z[0]) < _MAX_AXIAL_SHARE else 1]
    x = across / np.linalg.norm(across)
    return np.array([x, np.cross(z, x), z])
