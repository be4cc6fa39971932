"""Space in which a link moves, which limits what readings show of a sensor's mounting.

Rotation matrices from rotation vectors, and from roll, pitch and yaw as in URDF.

Readings of accelerometers and gyros at any place on a link, as weighted sums of link signals.

At r in the frame of its link, along the direction c, an accelerometer reads

    c . (f + dw x r + w x (w x r)) + bias

and a gyro c . w + bias. f is the specific force at the frame's origin, w and dw are the rate and
the angular acceleration of the link in space. The origin is on the link's own axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from strainwave.domain.arm.description import ArmDescription
from strainwave.domain.keys import FloatArray, JointNumber

_AccelerometerQuantity = Literal[
    "specific_force_x",
    "specific_force_y",
    "specific_force_z",
    "angular_acceleration_x",
    "angular_acceleration_y",
    "angular_acceleration_z",
    "rate_product_xx",
    "rate_product_yy",
    "rate_product_zz",
    "rate_product_xy",
    "rate_product_xz",
    "rate_product_yz",
]
_GyroQuantity = Literal["angular_rate_x", "angular_rate_y", "angular_rate_z"]

Quantity = Literal[
    "voltage",
    "motor_torque",
    "motor_angle",
    "motor_velocity",
    "link_angle",
    "link_velocity",
    "link_acceleration",
    "gear_torque",
    "torsion",
    "encoder",
    "accelerometer",
    "gyro",
    _AccelerometerQuantity,
    _GyroQuantity,
    "imu_a",
    "imu_ax",
    "imu_ay",
    "imu_az",
    "imu_gx",
    "imu_gy",
    "imu_gz",
    "sliding",
]
"""Quantities that a simulation can record.

`imu_ax` and the like are readings of a kind of sensor on each link: weighted sums of signals of the
link, whose weights the simulation is given.
"""


ACCELEROMETER_QUANTITIES: tuple[Quantity, ...] = get_args(_AccelerometerQuantity)
"""Signals of a link: f, dw and the products of w."""

GYRO_QUANTITIES: tuple[Quantity, ...] = get_args(_GyroQuantity)
"""The same for gyros: w."""

LINK_SIGNALS = (*ACCELEROMETER_QUANTITIES, *GYRO_QUANTITIES)
"""All signals of a link, in the order of the compiled core."""

_IN_PLANE: tuple[Quantity, ...] = (
    "specific_force_x",
    "specific_force_y",
    "angular_acceleration_z",
    "rate_product_zz",
    "angular_rate_z",
)
OUT_OF_PLANE = frozenset(LINK_SIGNALS).difference(_IN_PLANE)
"""Signals that are zero on a link that moves in the xy plane."""


def accelerometer_weights(direction: Sequence[float], position: Sequence[float]) -> FloatArray:
    """Weights (12,) of `ACCELEROMETER_QUANTITIES` in the reading of an accelerometer."""
    (a, b, c), (x, y, z) = direction, position
    along = a * x + b * y + c * z
    turning = (y * c - z * b, z * a - x * c, x * b - y * a)
    squares = (a * x - along, b * y - along, c * z - along)
    products = (a * y + b * x, a * z + c * x, b * z + c * y)
    return np.array([a, b, c, *turning, *squares, *products])


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


_MIN_SINE = 1e-9  # of the angle between two directions that are not parallel


@dataclass(frozen=True)
class LinkSpace:
    """Rotations and specific force of a link. The defaults are those of the xy plane."""

    axis: tuple[float, float, float] | None = (0.0, 0.0, 1.0)
    """Direction of all rotations in the link's frame; None: there are several."""

    is_axis_fixed: bool = False  # the link turns about an axis that does not move
    has_varying_force: bool = True  # at the origin of the link's frame
    is_flat: bool = True  # the simulation has only the signals of the xy plane

    @cached_property
    def directions(self) -> FloatArray:
        """Two directions across the axis and the axis in rows; those of the frame without axis."""
        return np.eye(3) if self.axis is None else axes_about(self.axis)

    @property
    def free_coordinates(self) -> tuple[int, ...]:
        """Coordinates of a position on the link, from 0, that change readings independently.

        A shift along the only axis changes no reading. The coordinate along which it is largest
        counts as zero.
        """
        dropped = None if self.axis is None else int(np.argmax(np.abs(self.axis)))
        return tuple(k for k in range(3) if k != dropped)

    def coordinates(self, position: FloatArray) -> list[float]:
        """The free coordinates of a position (3,) on the link."""
        if self.axis is not None:
            dropped = int(np.argmax(np.abs(self.axis)))
            position = position - position[dropped] / self.axis[dropped] * np.array(self.axis)
        return [float(position[k]) for k in self.free_coordinates]

    def has(self, quantity: Quantity) -> bool:
        """Whether the simulation has a quantity."""
        return not self.is_flat or quantity not in OUT_OF_PLANE


PLANE = LinkSpace()


def link_space(arm: ArmDescription, number: JointNumber) -> LinkSpace:
    """Space of the link of a joint."""
    attitude_in_base, axes = np.eye(3), []
    for joint in arm.joints[:number]:
        attitude_in_base = attitude_in_base @ attitude(joint.origin.rpy)
        if joint.motion == "revolute":
            axes.append(attitude_in_base @ joint.axis / np.linalg.norm(joint.axis))
    is_one_axis = bool(axes) and all(are_parallel(axes[-1], axis) for axis in axes[:-1])
    axis = attitude_in_base.T @ axes[-1] if is_one_axis else None
    is_axis_fixed = number == 1 and is_one_axis
    return LinkSpace(
        axis=None if axis is None else (float(axis[0]), float(axis[1]), float(axis[2])),
        is_axis_fixed=is_axis_fixed,
        has_varying_force=not is_axis_fixed
        or (arm.gravity is not None and not are_parallel(axes[0], np.array(arm.gravity))),
        is_flat=arm.has_planar_program,
    )


def are_parallel(a: FloatArray, b: FloatArray, sine: float = _MIN_SINE) -> bool:
    """Whether two vectors have the same or the opposite direction, or one is zero.

    `sine` is that of the largest angle between parallel directions.
    """
    limit = sine * np.linalg.norm(a) * np.linalg.norm(b)
    return bool(np.linalg.norm(np.cross(a, b)) <= limit)
