"""Readings of link sensors: ideal ones from the motion of the joints, then mount, delay and scale.

f, dw and w are the specific force, the angular acceleration and the rate of a link in its own
frame. A tangential accelerometer sits at a distance l from the axis, along x, and reads along y

    y . f + l (z . dw + (x . w) (y . w)),

a gyro reads z . w. z is the axis of the joint, x the direction along the link as far as it is
perpendicular to the axis, y = z x x. The accelerometer of a prismatic joint reads z . f.

The resonance of a sensor's mount is (S31),

    H(s) = w^2 / (s^2 + 2 zeta w s + w^2)

The frequency response is applied to the spectrum of the samples, which is exact if the samples
resolve the motion. A recursive filter would assume straight lines between samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Self

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, Joint
from strainwave.domain.arm.link_sensors import ConstantKind, SensorAxis, sensor_of
from strainwave.domain.arm.link_sensors.imu import ImuGyros
from strainwave.domain.arm.link_sensors.link_space import (
    ACCELEROMETER_QUANTITIES,
    GYRO_QUANTITIES,
    attitude,
    axes_about,
)
from strainwave.domain.keys import JointIndex, Key
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate, fast_length

_DECAY_TIME_CONSTANTS = 7.0  # the response has then decayed to 1/1000
_MAX_PADDING = 10.0  # [s] after a record


@dataclass(frozen=True, slots=True)
class MountResonance:
    """Natural frequency and damping ratio of a sensor's mount."""

    frequency: float  # [Hz], above zero
    damping: float  # above zero

    def response(self, hz: FloatArray) -> ComplexArray:
        """H at frequencies [Hz]: (n_frequencies,)."""
        w, s = math.tau * self.frequency, 2j * np.pi * hz
        return np.asarray(w**2 / (s**2 + 2.0 * self.damping * w * s + w**2))

    def response_slopes(self, hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Derivatives of H with respect to frequency [1/Hz] and damping ratio.

        d ln H / d ln w = 2 - (2 zeta s / w + 2) H,   d ln H / d zeta = -2 (s / w) H
        """
        ratio, H = 1j * hz / self.frequency, self.response(hz)
        by_frequency = (2.0 - 2.0 * (self.damping * ratio + 1.0) * H) * H / self.frequency
        return np.asarray(by_frequency), np.asarray(-2.0 * ratio * H**2)

    def read(self, motion: FloatArray, sample_time: float) -> FloatArray:
        """Sensor reading of a motion (n_samples, ...) that is at rest before its first sample."""
        (reading,) = self._filtered(motion, sample_time, lambda hz: (self.response(hz),))
        return np.asarray(reading + motion[:1])

    def slopes(self, motion: FloatArray, sample_time: float) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the reading with respect to frequency [1/Hz] and damping ratio."""
        by_frequency, by_damping = self._filtered(motion, sample_time, self.response_slopes)
        return by_frequency, by_damping

    def _filtered(
        self,
        motion: FloatArray,
        sample_time: float,
        responses: Callable[[FloatArray], tuple[ComplexArray, ...]],
    ) -> list[FloatArray]:
        """Change since the first sample after each response: (n_samples, ...) each.

        A discrete spectrum implies a periodic signal. The motion is therefore extended by a return
        to its start and a pause in which the response decays.
        """
        decay = _DECAY_TIME_CONSTANTS / (math.tau * self.frequency * self.damping)
        n, padding = len(motion), math.ceil(min(decay, _MAX_PADDING) / sample_time)
        shape = (-1, *(1 for _ in motion.shape[1:]))
        change = motion - motion[:1]
        back = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, padding + 1) / padding).reshape(shape)
        size = fast_length(n + 2 * padding)
        spectrum = np.fft.rfft(np.concatenate([change, change[-1:] * back]), size, axis=0)
        factors = responses(np.asarray(np.fft.rfftfreq(size, sample_time)))
        return [np.fft.irfft(spectrum * H.reshape(shape), size, axis=0)[:n] for H in factors]


MAX_SENSOR_DELAY = 5e-3
"""Largest delay [s] of a sensor: logger, bus and internal filter."""

MAX_SCALE_ERROR = 0.1
"""Largest relative scale error: data sheets state 1 to 3 %, a distance adds a few per cent."""

_INTERPOLATION_TAPS = 16  # samples on each side of an interpolated sample
_KAISER_BETA = 9.0  # of the interpolation window
_DIFFERENCE_REACH = 10  # rows on each side of a difference


def mount_resonance(axis: SensorAxis, values: Mapping[Key, float]) -> MountResonance | None:
    """Resonance of the mount of a sensor; None if the mount is rigid."""
    names = axis.mount
    if names is None or names[0] not in values:
        return None
    return MountResonance(*(values[name] for name in names))


def differentiate_rows(rows: FloatArray, row_time: float) -> FloatArray:
    """Time derivative of oversampled rows (n_rows,) by central differences of twentieth order.

    At the low-pass's cut-off, four rows per period, the derivative is 0.04 % too small. A delay is
    nearly collinear with a torque hold, so that an error of some per cent stops a search.
    `row_time` [s].
    """
    around = np.pad(rows, _DIFFERENCE_REACH, mode="edge")
    return np.convolve(around, _difference_weights() / row_time, mode="valid")


@cache
def _difference_weights() -> FloatArray:
    """Weights of central differences: (-1)^(k + 1) (n!)^2 / (k (n - k)! (n + k)!) at k rows."""
    n, later = _DIFFERENCE_REACH, range(1, _DIFFERENCE_REACH + 1)
    weights = [(-1) ** (k + 1) * math.comb(2 * n, n - k) / (k * math.comb(2 * n, n)) for k in later]
    return np.array([*weights[::-1], 0.0, *(-weight for weight in weights)])


def shift_samples(samples: FloatArray, ahead: float) -> FloatArray:
    """Samples at shifted times, y_k = x(k + ahead), by windowed sinc interpolation.

    The signal continues with its first and last value beyond its ends. `ahead` is in samples.
    """
    if not ahead:
        return samples
    whole = int(np.floor(ahead))
    taps = _INTERPOLATION_TAPS
    offset = np.arange(-taps, taps + 1, dtype=np.float64) - (ahead - whole)
    window = np.i0(_KAISER_BETA * np.sqrt(np.clip(1.0 - (offset / (taps + 1.0)) ** 2, 0.0, None)))
    weights = np.sinc(offset) * window
    weights /= weights.sum()
    around = np.pad(samples, taps + abs(whole), mode="edge")
    first = abs(whole) + whole
    section = around[first : first + len(samples) + 2 * taps]
    return np.asarray(np.convolve(section, weights[::-1], mode="valid"))


def apply_sensor_model(
    samples: FloatArray, sample_time: float, axis: SensorAxis, values: Mapping[Key, float]
) -> FloatArray:
    """Reading of a sensor with its mount resonance, delay and scale.

    `values` without constants of the sensor describe an ideal sensor.
    """
    mount = mount_resonance(axis, values)
    if mount is not None:
        samples = mount.read(samples, sample_time)
    shifted = shift_samples(samples, -axis.delay(values) / sample_time)
    return np.asarray(axis.value(ConstantKind.SCALE, values) * shifted)


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


def link_quantities(axis: SensorAxis, arm: Arm, motion: JointMotion) -> FloatArray:
    """The quantities (n_samples, n_quantities) that an axis reads, from the joints' motion."""
    rates, accelerations, forces = np.split(motion.links(arm)[:, axis.joint - 1], 3, axis=1)
    products = rates[:, [0, 1, 2, 0, 0, 1]] * rates[:, [0, 1, 2, 1, 2, 2]]
    names = (*ACCELEROMETER_QUANTITIES, *GYRO_QUANTITIES)
    signals = np.column_stack([forces, accelerations, products, rates])
    return signals[:, [names.index(name) for name in axis.quantities]]


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


def read_accelerometer(
    arm: Arm, motion: JointMotion, i: JointIndex, distance: float | None = None
) -> FloatArray:
    """Reading of the accelerometer on link i: (n_samples,) [m/s^2].

    `distance` [m] from the axis is by default that of the study.
    """
    joint, link = arm.joints[i], motion.links(arm)[:, i]
    return np.asarray(link[:, 6:] @ _direction(joint) + _rotation(joint, link, distance))


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


def _rotation(joint: Joint, link: FloatArray, distance: float | None = None) -> FloatArray:
    """Contribution of the rotation of a link (n_samples, 9) to the reading of its accelerometer."""
    if joint.motion == "prismatic":
        return np.zeros(len(link))
    x, y, z = axes_about(joint.axis)
    rate, turning = link[:, :3], link[:, 3:6]
    gain = acceleration_gain(joint) if distance is None else distance
    return np.asarray(gain * (turning @ z + (rate @ x) * (rate @ y)))
