"""Readings of ideal sensors on the links of a chain, from the motion of its joints.

f, dw and w are the specific force, the angular acceleration and the rate of a link in its own
frame. A tangential accelerometer sits at a distance l from the axis, along x, and reads along y

    y . f + l (z . dw + (x . w) (y . w)),

a gyro reads z . w. z is the axis of the joint, x the direction along the link as far as it is
perpendicular to the axis, y = z x x. The accelerometer of a prismatic joint reads z . f.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from strainwave.domain import FloatArray, Joint
from strainwave.domain.arm.link_sensors import sensor_of
from strainwave.domain.arm.link_sensors.imu import ImuGyros
from strainwave.domain.arm.link_sensors.link_space import attitude, axes_about
from strainwave.domain.keys import JointIndex
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate


@dataclass(frozen=True, slots=True)
class JointMotion:
    """Motion of the links relative to the links before them, each (n_samples, n_joints)."""

    angle: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    @classmethod
    def of_motors(cls, motors: FloatArray, arm: Arm, sample_time: float) -> Self:
        """Motion of links behind rigid gears from motor angles."""
        angle = arm.links_of(motors)
        velocity = differentiate(angle, sample_time)
        return cls(angle, velocity, differentiate(velocity, sample_time))

    @classmethod
    def at_rest(cls, angle: FloatArray) -> Self:
        """Links at rest."""
        rest = np.zeros_like(angle)
        return cls(angle, rest, rest)

    def without(self, i: JointIndex) -> Self:
        """The motion without rate and acceleration of joint i."""
        others = np.arange(self.angle.shape[1]) != i
        return replace(
            self, velocity=self.velocity * others, acceleration=self.acceleration * others
        )

    def links(self, arm: Arm) -> FloatArray:
        """Motion of the links in space: (n_samples, n_joints, 9)."""
        return arm.link_motion(self.angle, self.velocity, self.acceleration)


def accelerometer_parts(arm: Arm, motion: JointMotion, i: JointIndex) -> dict[str, FloatArray]:
    """Parts of the reading of the accelerometer on link i, each (n_samples,) [m/s^2].

    "own-joint" is the rotation of the link about its frame's origin, or the motion of a slide;
    "origin-motion" is the acceleration of that origin.
    """
    joint, link = arm.joints[i], motion.links(arm)[:, i]
    force, gravity = link[:, 6:] @ _direction(joint), np.zeros(len(link))
    if arm.gravity_size:
        gravity = JointMotion.at_rest(motion.angle).links(arm)[:, i, 6:] @ _direction(joint)
    if joint.motion == "prismatic":
        return {"own-joint": force - gravity, "gravity": gravity}
    rotation = _rotation(joint, link)
    return {"own-joint": rotation, "origin-motion": force - gravity, "gravity": gravity}


def imu_parts(
    arm: Arm, motion: JointMotion, kind: str, i: JointIndex
) -> dict[str, FloatArray] | None:
    """Parts of the reading of one axis of the IMU on link i: of motion and of gravity.

    A gyro reads w . e, an accelerometer (f + dw x r + w x (w x r)) . e, where r is the place and e
    the axis of the sensor. None if the study does not give them.
    """
    case, sensor = arm.joints[i].imu, sensor_of(arm.joints[i], kind)
    if case is None or case.rpy is None or sensor is None:
        return None
    axis = attitude(case.rpy)[:, sensor.channel_kinds.index(kind)]
    link = motion.links(arm)[:, i]
    rate, turning, force = link[:, :3], link[:, 3:6], link[:, 6:]
    if isinstance(sensor, ImuGyros):
        return {"own-joint": rate @ axis}
    if case.xyz is None:
        return None
    place = np.array(case.xyz)
    rotation = np.cross(turning, place) + np.cross(rate, np.cross(rate, place))
    gravity = JointMotion.at_rest(motion.angle).links(arm)[:, i, 6:] @ axis
    return {"own-joint": (force + rotation) @ axis - gravity, "gravity": gravity}


def read_accelerometer(arm: Arm, motion: JointMotion, i: JointIndex) -> FloatArray:
    """Reading of the accelerometer on link i: (n_samples,) [m/s^2]."""
    joint, link = arm.joints[i], motion.links(arm)[:, i]
    return np.asarray(link[:, 6:] @ _direction(joint) + _rotation(joint, link))


def read_rotation(arm: Arm, motion: JointMotion, i: JointIndex) -> FloatArray:
    """Contribution of the rotation of link i to the reading of its accelerometer."""
    return _rotation(arm.joints[i], motion.links(arm)[:, i])


def read_gyro(arm: Arm, motion: JointMotion, i: JointIndex) -> FloatArray:
    """Reading of the gyro on link i: (n_samples,) [rad/s]."""
    return np.asarray(motion.links(arm)[:, i, :3] @ axes_about(arm.joints[i].axis)[2])


def read_gravity(arm: Arm, angle: FloatArray, i: int, gravity: FloatArray) -> FloatArray:
    """Readings of accelerometer i at rest under any gravity (n, 3) [m/s^2] of the base's frame.

    Returns (n_samples, n).
    """
    return -np.asarray(_direction(arm.joints[i]) @ arm.link_attitudes(angle)[:, i] @ gravity.T)


def acceleration_gain(joint: Joint) -> float:
    """Derivative of the reading of a link's accelerometer by the acceleration of its own joint."""
    return 1.0 if joint.motion == "prismatic" else joint.accelerometer_distance or 1.0


def preceding_gains(arm: Arm, angle: FloatArray, i: int, *, gyro: bool) -> FloatArray:
    """Derivatives of a reading by the accelerations of the joints before i: (n_samples, i).

    Those of a gyro are derivatives of the slope of its reading.
    """
    joint, rest = arm.joints[i], JointMotion.at_rest(angle)
    start = 0.0 if gyro else read_accelerometer(arm, rest, i)
    gains = np.empty((len(angle), i))
    for j in range(i):
        unit = replace(rest, acceleration=rest.acceleration + np.eye(arm.n_joints)[j])
        if gyro:
            gains[:, j] = unit.links(arm)[:, i, 3:6] @ axes_about(joint.axis)[2]
        else:
            gains[:, j] = read_accelerometer(arm, unit, i) - start
    return gains


def angle_derivatives(arm: Arm, motion: JointMotion, i: int) -> FloatArray:
    """Derivatives of a reading of accelerometer i by the joint angles: (n_samples, n_joints)."""
    joint = arm.joints[i]
    x, y, z = axes_about(joint.axis)
    states = motion.angle, motion.velocity, motion.acceleration
    slope = np.swapaxes(arm.link_motion_derivatives(*states)[0][:, i], 1, 2)
    if joint.motion == "prismatic":
        return np.asarray(slope[..., 6:] @ z)
    rate, rate_slope = motion.links(arm)[:, None, i, :3], slope[..., :3]
    products = (rate @ x) * (rate_slope @ y) + (rate @ y) * (rate_slope @ x)
    rotation = slope[..., 3:6] @ z + products
    return np.asarray(slope[..., 6:] @ y + acceleration_gain(joint) * rotation)


def _direction(joint: Joint) -> FloatArray:
    return np.asarray(axes_about(joint.axis)[2 if joint.motion == "prismatic" else 1])


def _rotation(joint: Joint, link: FloatArray) -> FloatArray:
    """Contribution of the rotation of a link (n_samples, 9) to the reading of its accelerometer."""
    if joint.motion == "prismatic":
        return np.zeros(len(link))
    x, y, z = axes_about(joint.axis)
    rate, turning = link[:, :3], link[:, 3:6]
    return np.asarray(acceleration_gain(joint) * (turning @ z + (rate @ x) * (rate @ y)))
