"""Readings of link sensors: ideal ones from the motion of the joints, then mount, delay and scale.

f, dw and w are the specific force, the angular acceleration and the rate of a link in its own
frame. At r, along the direction c, an accelerometer reads

    c . (f + dw x r + w x (w x r)),

a gyro reads c . w. For the tangential accelerometer of a joint r is along x and c along y, where z
is the axis of the joint, x the direction along the link as far as it is perpendicular to the axis,
and y = z x x. For the gyro, and for the accelerometer of a prismatic joint, c is z.

The resonance of a sensor's mount is (S31),

    H(s) = w^2 / (s^2 + 2 zeta w s + w^2)

The frequency response is applied to the spectrum of the samples, which is exact if the samples
resolve the motion. A recursive filter would assume straight lines between samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Self

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, Imu, Joint
from strainwave.domain.arm.link_sensors import ConstantKind, SensorAxis, sensor_of
from strainwave.domain.arm.link_sensors.imu import ImuGyros, ImuSensor
from strainwave.domain.arm.link_sensors.link_space import (
    ACCELEROMETER_QUANTITIES,
    GYRO_QUANTITIES,
    LINK_SIGNALS,
    accelerometer_weights,
    attitude,
    axes_about,
)
from strainwave.domain.arm.link_sensors.single_axis import Accelerometer, Gyro
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


def read_link(arm: Arm, motion: JointMotion, i: JointIndex) -> FloatArray:
    """Signals of link i in the order of `LINK_SIGNALS`: (n_samples, n_signals)."""
    rates, accelerations, forces = np.split(motion.links(arm)[:, i], 3, axis=1)
    products = rates[:, [0, 1, 2, 0, 0, 1]] * rates[:, [0, 1, 2, 1, 2, 2]]
    return np.column_stack([forces, accelerations, products, rates])


def link_quantities(axes: Sequence[SensorAxis], arm: Arm, motion: JointMotion) -> list[FloatArray]:
    """The quantities (n_samples, n_quantities) that each axis on a link reads, from the motion."""
    signals = read_link(arm, motion, axes[0].joint - 1)
    return [signals[:, [LINK_SIGNALS.index(name) for name in axis.quantities]] for axis in axes]


def channel_weights(joint: Joint, kind: str, distance: float | None = None) -> FloatArray | None:
    """Weights (n_signals,) of `LINK_SIGNALS` in the ideal reading of a channel of a link.

    `distance` [m] is that of a tangential accelerometer, by default that of the study. None if the
    study does not give the place of the sensor.
    """
    (x, y, z), sensor = axes_about(joint.axis), sensor_of(joint, kind)
    distance = distance or joint.accelerometer_distance
    place: Sequence[float] | None = None
    match sensor:
        case Gyro():
            direction = z
        case Accelerometer() if joint.motion == "prismatic":
            direction, place = z, (0.0, 0.0, 0.0)
        case Accelerometer() if distance is not None:
            direction, place = y, (distance * x).tolist()
        case ImuSensor(case=Imu(rpy=(_, _, _) as rpy)):
            direction, place = attitude(rpy)[:, sensor.channel_kinds.index(kind)], sensor.xyz
        case _:
            return None
    if isinstance(sensor, Gyro | ImuGyros):
        return np.concatenate([np.zeros(len(ACCELEROMETER_QUANTITIES)), direction])
    if place is None:
        return None
    of_motion = accelerometer_weights(direction.tolist(), place)
    return np.concatenate([of_motion, np.zeros(len(GYRO_QUANTITIES))])


def reading_parts(
    arm: Arm, motion: JointMotion, kind: str, i: JointIndex
) -> dict[str, FloatArray] | None:
    """Parts of the ideal reading of a channel of link i, each (n_samples,).

    "own-joint" is the motion of the link. For a tangential accelerometer it is the rotation about
    the origin of the link's frame, and "origin-motion" the acceleration of that origin. None if the
    study does not give the place of the sensor.
    """
    joint, weights = arm.joints[i], channel_weights(arm.joints[i], kind)
    if weights is None:
        return None
    signals, force_weights = read_link(arm, motion, i), weights[:3]
    if not force_weights.any():
        return {"own-joint": signals @ weights}
    gravity = np.zeros(len(signals))
    if arm.gravity_size:
        at_rest = JointMotion.at_rest(motion.angle)
        gravity = read_link(arm, at_rest, i)[:, :3] @ force_weights
    force, rotation = signals[:, :3] @ force_weights - gravity, signals[:, 3:] @ weights[3:]
    if kind == "a" and joint.motion == "revolute":
        return {"own-joint": rotation, "origin-motion": force, "gravity": gravity}
    return {"own-joint": force + rotation, "gravity": gravity}


def read_gravity(arm: Arm, angle: FloatArray, i: int, gravity: FloatArray) -> FloatArray:
    """Readings of accelerometer i at rest under any gravity (n, 3) [m/s^2] of the base's frame.

    Returns (n_samples, n).
    """
    joint = arm.joints[i]
    direction = axes_about(joint.axis)[2 if joint.motion == "prismatic" else 1]
    return -np.asarray(direction @ arm.link_attitudes(angle)[:, i] @ gravity.T)


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
