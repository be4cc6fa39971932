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
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate

_MAX_AXIAL_SHARE = 0.999  # of a direction along the link, as in the core


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

    def without(self, i: int) -> Self:
        """The motion without rate and acceleration of joint i, from 0."""
        others = np.arange(self.angle.shape[1]) != i
        return replace(
            self, velocity=self.velocity * others, acceleration=self.acceleration * others
        )

    def links(self, arm: Arm) -> FloatArray:
        """Motion of the links in space: (n_samples, n_joints, 9)."""
        return arm.link_motion(self.angle, self.velocity, self.acceleration)


@dataclass(frozen=True, slots=True)
class AccelerometerParts:
    """Contributions to the reading of an accelerometer, each (n_samples,) [m/s^2]."""

    rotation: FloatArray  # of the link about its frame's origin
    translation: FloatArray  # acceleration of that origin
    gravity: FloatArray

    @property
    def sum(self) -> FloatArray:
        """The reading."""
        return self.rotation + self.translation + self.gravity


def read_accelerometer(arm: Arm, motion: JointMotion, i: int) -> AccelerometerParts:
    """Reading of the accelerometer on link i, from 0, at its distance from the axis."""
    joint, link = arm.joints[i], motion.links(arm)[:, i]
    x, y, z = _sensor_axes(joint)
    rotation, direction = np.zeros(len(link)), z
    if joint.motion == "revolute":
        rate, turning = link[:, :3], link[:, 3:6]
        distance = joint.accelerometer_distance or 1.0
        rotation, direction = distance * (turning @ z + (rate @ x) * (rate @ y)), y
    gravity = JointMotion.at_rest(motion.angle).links(arm)[:, i, 6:] @ direction
    return AccelerometerParts(rotation, link[:, 6:] @ direction - gravity, gravity)


def read_gyro(arm: Arm, motion: JointMotion, i: int) -> FloatArray:
    """Reading of the gyro on link i, from 0: (n_samples,) [rad/s]."""
    return np.asarray(motion.links(arm)[:, i, :3] @ _sensor_axes(arm.joints[i])[2])


def read_gravity(arm: Arm, angle: FloatArray, i: int, gravity: FloatArray) -> FloatArray:
    """Reading of an accelerometer at rest under any gravity (3,) [m/s^2] in the base's frame."""
    joint = arm.joints[i]
    direction = _sensor_axes(joint)[1 if joint.motion == "revolute" else 2]
    return -np.asarray(direction @ arm.link_attitudes(angle)[:, i] @ gravity)


def acceleration_gains(arm: Arm, angle: FloatArray, i: int, *, gyro: bool) -> FloatArray:
    """Derivatives of a reading by the accelerations of the joints: (n_samples, n_joints).

    Those of a gyro are derivatives of the slope of its reading.
    """
    gains = np.empty_like(angle)
    for j, unit in enumerate(np.eye(arm.n_joints)):
        rest = JointMotion.at_rest(angle)
        if gyro:
            gains[:, j] = read_gyro(arm, replace(rest, velocity=rest.velocity + unit), i)
        else:
            parts = read_accelerometer(arm, replace(rest, acceleration=rest.acceleration + unit), i)
            gains[:, j] = parts.rotation + parts.translation
    return gains


def angle_derivatives(arm: Arm, motion: JointMotion, i: int) -> FloatArray:
    """Derivatives of a reading of accelerometer i by the joint angles: (n_samples, n_joints)."""
    joint = arm.joints[i]
    x, y, z = _sensor_axes(joint)
    states = motion.angle, motion.velocity, motion.acceleration
    slope = np.swapaxes(arm.link_motion_derivatives(*states)[0][:, i], 1, 2)
    if joint.motion == "prismatic":
        return np.asarray(slope[..., 6:] @ z)
    rate, rate_slope = motion.links(arm)[:, None, i, :3], slope[..., :3]
    products = (rate @ x) * (rate_slope @ y) + (rate @ y) * (rate_slope @ x)
    rotation = slope[..., 3:6] @ z + products
    return np.asarray(slope[..., 6:] @ y + (joint.accelerometer_distance or 1.0) * rotation)


def _sensor_axes(joint: Joint) -> FloatArray:
    """Directions x, y and z of a link's sensors in the frame of the link, in rows."""
    z = np.array(joint.axis) / np.linalg.norm(joint.axis)
    across = (np.eye(3) - np.outer(z, z))[0 if abs(z[0]) < _MAX_AXIAL_SHARE else 1]
    x = across / np.linalg.norm(across)
    return np.array([x, np.cross(z, x), z])
