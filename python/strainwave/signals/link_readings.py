"""Readings from which the stages before the whole-arm fit compute the motion of each link.

Encoders, gyros and accelerometers at known positions are read as they are. A weighted sum of the
axes of an IMU reads as one tangential accelerometer with an estimated distance, or as a gyro along
the axis; on a prismatic joint, as one accelerometer along the axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import FloatArray, Lag, LinkSource, Log
from strainwave.domain.arm.link_sensors import SensorAxis, sensor_of
from strainwave.domain.arm.link_sensors.imu import ImuAccelerometers, ImuGyros
from strainwave.domain.arm.link_sensors.link_space import (
    LinkSpace,
    accelerometer_weights,
    axes_about,
)
from strainwave.domain.arm.link_sensors.single_axis import Accelerometer
from strainwave.domain.keys import JointNumber
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import (
    JointMotion,
    acceleration_gain,
    channel_weights,
    link_quantities,
    read_link,
)
from strainwave.errors import InvalidInput
from strainwave.signals.channels import sensor_lags
from strainwave.signals.mounting_start import (
    axes_on,
    is_long_enough,
    linear_factors,
    slow_motion,
)

_MIN_SQUARED_SHARE = 0.1  # of the rate about the axis in the gyros of an IMU
_MAX_FACTOR_ERROR = 0.1  # of a sum of axes that reads as a tangential accelerometer
_MIN_DISTANCE = 0.02  # [m] minimum distance from the axis to measure angular acceleration

# channels of sensors that are read as they are, without the joint's number, the best first
_DIRECT: Mapping[LinkSource, str] = {
    "accelerometer": "a",
    "encoder": "theta_l",
    "deflection": "deflection",
    "gyro": "gyro",
}


@dataclass(frozen=True, slots=True)
class LinkReading:
    """Weighted sum of sensor axes on one link, less the part of the other quantities they read.

    It reads as a sensor of the kind `source` does. Without axes the motor gives the motion, with
    the torsion if that is measured.
    """

    joint: JointNumber
    source: LinkSource
    axes: tuple[SensorAxis, ...] = ()
    weights: FloatArray = field(default_factory=lambda: np.ones(1))  # (n_axes,)
    # derivative of the reading by the acceleration of its own joint: 1, or the distance [m] of a
    # tangential accelerometer
    gain: float = 1.0
    # factors of other quantities in the sum, which the motors give; None: not subtracted
    others: FloatArray | None = None

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of the axes."""
        return tuple(axis.channel for axis in self.axes)

    @property
    def lags(self) -> tuple[Lag, ...]:
        """Low-pass that the reading has passed, as the study gives it."""
        return sensor_lags(self.axes[0].sensor) if self.axes else ()

    def samples(self, log: Log, arm: Arm) -> FloatArray:
        """The reading in a record: (n_samples,)."""
        samples = self.weights @ np.array([log.channels[name] for name in self.channels])
        if self.others is not None:
            (quantities,) = link_quantities(self.axes[:1], arm, slow_motion(log, arm))
            samples -= quantities @ self.others[self.axes[0].is_simulated]
        return np.asarray(samples)

    def predict(self, arm: Arm, motion: JointMotion) -> FloatArray:
        """Ideal reading of an accelerometer or a gyro: (n_samples,)."""
        i = self.joint - 1
        weights = channel_weights(arm.joints[i], _DIRECT[self.source], self.gain)
        assert weights is not None  # the distance is known
        return np.asarray(read_link(arm, motion, i) @ weights)

    def preceding_gains(self, arm: Arm, angle: FloatArray) -> FloatArray:
        """Derivatives by the accelerations of the joints before: (n_samples, joint - 1).

        Those of a gyro are derivatives of the slope of its reading, which are those of the reading
        by the rates.
        """
        rest, gains = JointMotion.at_rest(angle), np.empty((len(angle), self.joint - 1))
        start = self.predict(arm, rest)
        for j in range(self.joint - 1):
            unit = np.zeros_like(angle)
            unit[:, j] = 1.0
            is_gyro = self.source == "gyro"
            moving = replace(rest, velocity=unit) if is_gyro else replace(rest, acceleration=unit)
            gains[:, j] = self.predict(arm, moving) - start
        return gains


CombinedReadings = Mapping[JointNumber, LinkReading | None]
"""Readings of links by sensors that are not read as they are; None: they do not give the motion."""


def choose_reading(
    log: Log, arm: Arm, joint: JointNumber, combined: CombinedReadings
) -> LinkReading:
    """The best reading of a link in a record.

    Raises InvalidInput if the position of its accelerometer is missing.
    """
    description, reading = arm.joints[joint - 1], combined.get(joint)
    if not description.elastic:
        return LinkReading(joint, "rigid")
    if reading is not None and set(reading.channels) <= log.channels.keys():
        return reading
    for source, kind in _DIRECT.items():
        if f"{kind}{joint}" not in log.channels:
            continue
        if source == "deflection":
            return LinkReading(joint, source)
        if source == "accelerometer" and joint in combined:
            continue
        sensor = sensor_of(description, kind)
        if sensor is None:
            continue
        if isinstance(sensor, Accelerometer) and not sensor.is_at_known_place:
            raise InvalidInput(
                f"a{joint} is logged but accelerometer_distance is not given",
                where=f"joint {joint}",
                remedy="add accelerometer_distance to the joint, or remove the channel",
            )
        gain = acceleration_gain(description) if source == "accelerometer" else 1.0
        return LinkReading(joint, source, sensor.axes(joint), gain=gain)
    return LinkReading(joint, "motor")


def combine_axes(logs: Sequence[Log], arm: Arm, known: Sequence[Log]) -> CombinedReadings:
    """Readings of the links whose only sensors are an IMU or an accelerometer at an unknown place.

    The stages before the whole-arm fit use them. `known` are all logs, which determine the
    positions.
    """
    combined: dict[JointNumber, LinkReading | None] = {}
    for joint in range(1, arm.n_joints + 1):
        axes = axes_on(logs, arm, joint)
        is_single = bool(axes) and isinstance(axes[0].sensor, Accelerometer)
        has_direct_sensor = any(
            f"{kind}{joint}" in log.channels for kind in _DIRECT.values() for log in logs
        )
        if not axes or (has_direct_sensor and not is_single):
            continue
        combined[joint] = None
        # an inaccurate position is worse than no sensor
        if any(is_long_enough(log) for log in known if axes[0].channel in log.channels):
            combined[joint] = _combined_reading(arm, axes, linear_factors(known, arm, axes))
    return combined


def _combined_reading(
    arm: Arm, axes: Sequence[SensorAxis], linear: Sequence[FloatArray]
) -> LinkReading | None:
    """The reading of one link as an accelerometer or a gyro; None if no sum of axes is one."""
    joint, space = axes[0].joint, axes[0].space
    x, y, z = axes_about(arm.joints[joint - 1].axis)
    pairs = list(zip(axes, linear, strict=True))
    gyros = [(a, f) for a, f in pairs if isinstance(a.sensor, ImuGyros)]
    accelerometers = [(a, f) for a, f in pairs if not isinstance(a.sensor, ImuGyros)]
    used, factors = tuple(a for a, _ in accelerometers), [f for _, f in accelerometers]
    if arm.joints[joint - 1].motion == "prismatic":
        return _along_the_slide(used, np.array(factors), z)
    weights, distance = _tangential_weights(factors, (x, y, z), space)
    if used and abs(distance) > _MIN_DISTANCE:
        others = None
        if isinstance(used[0].sensor, ImuAccelerometers):
            tangential = accelerometer_weights(y.tolist(), (distance * x).tolist())
            others = weights @ np.array(factors) - tangential
        return LinkReading(joint, "accelerometer", used, weights, distance, others)
    shares = np.array([factor @ z for _, factor in gyros])
    if not float(shares @ shares) > _MIN_SQUARED_SHARE:
        return None
    used, weights = tuple(axis for axis, _ in gyros), shares / float(shares @ shares)
    others = weights @ np.array([f for _, f in gyros]) - z if space.axis is None else None
    return LinkReading(joint, "gyro", used, weights, others=others)


def _along_the_slide(
    axes: tuple[SensorAxis, ...], factors: FloatArray, z: FloatArray
) -> LinkReading | None:
    """The reading along a prismatic joint, at the origin of its link.

    `factors` is (n_axes, n_quantities).
    """
    if not axes:
        return None
    forces = factors[:, :3].T
    weights = np.linalg.pinv(forces, rcond=0.1) @ z
    if np.any(np.abs(forces @ weights - z) > _MAX_FACTOR_ERROR):
        return None
    others = weights @ factors - accelerometer_weights(z.tolist(), (0.0, 0.0, 0.0))
    return LinkReading(axes[0].joint, "accelerometer", axes, weights, others=others)


def _tangential_weights(
    linear: Sequence[FloatArray], directions: Sequence[FloatArray], space: LinkSpace
) -> tuple[FloatArray, float]:
    """Weights of a sum of axes that reads f along the tangent only, and its factor of alpha.

    `directions` are x, along the link, the tangent y and the axis z of the joint. About a fixed
    axis, where f is small, the sum has factor one of alpha and zero of w^2. The factor is zero if
    no weights achieve this.
    """
    if not linear:
        return np.zeros(0), 0.0
    forces, accelerations, products = np.split(np.array(linear).T, [3, 6])  # (.., n_axes)
    x, y, z = directions
    by_alpha = z @ accelerations
    if len(linear) == 1 and not space.is_axis_fixed:
        is_tangential = abs(y @ forces[:, 0] - 1.0) < _MAX_FACTOR_ERROR
        return np.ones(1), float(by_alpha[0]) if is_tangential else 0.0
    if space.is_axis_fixed:
        by_square = (z[[0, 1, 2, 0, 0, 1]] * z[[0, 1, 2, 1, 2, 2]]) @ products
        rows, target = np.array([by_square, by_alpha]), np.array([0.0, 1.0])
    else:
        rows, target = np.array([x, y, z]) @ forces, np.array([0.0, 1.0, 0.0])
    weights = np.linalg.pinv(rows, rcond=0.1) @ target
    if np.any(np.abs(rows @ weights - target) > _MAX_FACTOR_ERROR):
        return weights, 0.0
    return weights, float(by_alpha @ weights)
