"""Readings of the observers: the sensors of a joint, their noise and what they measure.

An observer uses the part of a reading that the motion of its own joint causes. The motion of the
other joints and gravity cause the rest, which is known from the planned motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray, Joint
from strainwave.domain.arm.description import Imu
from strainwave.domain.arm.link_sensors import SensorAxis, axes_of, with_estimates
from strainwave.domain.arm.link_sensors.imu import ImuAccelerometers, ImuGyros
from strainwave.domain.arm.link_sensors.interface import LinkSensor
from strainwave.domain.arm.link_sensors.link_space import Quantity, attitude, axes_about
from strainwave.domain.arm.link_sensors.single_axis import (
    Accelerometer,
    Gyro,
    LinkEncoder,
    TorqueSensor,
    TorsionSensor,
)
from strainwave.domain.keys import JointIndex, JointNumber
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import JointMotion, channel_weights, read_link
from strainwave.export.source import IdentifiedArm
from strainwave.io.joint_covariance import IdentifiedNoise

_DEFAULT_COUNTS = 4096.0  # of an encoder without counts and without identified noise
_MIN_BANDWIDTH_RATIO = 10.0  # of a sensor over the mode of the link, so that its lag is negligible
_MIN_WEIGHT = 1e-12  # of an axis of an IMU: rounding
_MIN_LEVER = 1e-3  # [m] of an IMU from the axis of its joint


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """A reading of an observer: a weighted sum of channels, less its known part.

    It is `factor` times a quantity of the joint, plus a bias.
    """

    name: str
    channels: tuple[str, ...]  # of the log
    weights: tuple[float, ...]
    quantity: Quantity
    unit: str
    std: float  # of one reading
    source: str  # of the standard deviation
    factor: float = 1.0
    has_bias: bool = False
    resolution: float = 0.0  # one count; zero without
    axes: tuple[SensorAxis, ...] = ()  # of the sensor on the link, one per channel

    @property
    def label(self) -> str:
        """The name as an identifier."""
        return self.name.replace(" ", "_").replace("'", "")


_Source = tuple[FloatArray, Quantity, float]
"""Weights of a sensor's axes; the quantity that they give an observer, and its factor."""

_ONE = np.ones(1)
_SIMPLE: dict[type[LinkSensor], _Source] = {
    LinkEncoder: (_ONE, "link_angle", 1.0),
    TorsionSensor: (_ONE, "torsion", -1.0),
    Gyro: (_ONE, "link_velocity", 1.0),
    TorqueSensor: (_ONE, "gear_torque", 1.0),
}


def with_places(arm: IdentifiedArm) -> Arm:
    """The arm with identified places and bandwidths of its sensors."""
    description = arm.study.arm
    joints = (
        with_estimates(joint, number, arm.values)
        for number, joint in enumerate(description.joints, start=1)
    )
    return Arm.of(description.with_joints(tuple(joints)))


def measurements_of(
    arm: IdentifiedArm, number: JointNumber, mode_hz: float, period: float, noise: IdentifiedNoise
) -> tuple[tuple[Measurement, ...], tuple[str, ...]]:
    """The readings of a joint and the sensors that are not used with their reasons.

    `mode_hz` is the frequency of the link while the motor is held.
    """
    model = with_places(arm)
    joint = model.joints[number - 1]
    used, unused = [_motor_encoder(joint, number, noise.samples)], []
    by_sensor: dict[LinkSensor, list[SensorAxis]] = {}
    for axis in axes_of(model, number):
        sensor = axis.sensor
        if sensor.is_in_table or sensor.resolution or axis.channel in arm.study.channels:
            by_sensor.setdefault(axis.sensor, []).append(axis)
    for sensor, axes in by_sensor.items():
        result = _measurement(sensor, axes, joint, mode_hz, period, noise.samples)
        if isinstance(result, str):
            unused.append(f"{sensor.noun}: {result}")
        else:
            used.append(result)
    return tuple(used), tuple(unused)


def known_part(one: Measurement, model: Arm, motion: JointMotion, i: JointIndex) -> FloatArray:
    """Part of a reading that the other joints and gravity cause: (n_samples,).

    `motion` is the planned motion of all joints, i the joint.
    """
    total = np.zeros(len(motion.angle))
    for axis, weight in zip(one.axes, one.weights, strict=True) if one.axes else ():
        channel = channel_weights(model.joints[i], axis.sensor.channel_kinds[axis.number])
        if channel is not None:
            total += weight * (read_link(model, motion, i) @ channel)
    own = {"link_acceleration": motion.acceleration, "link_velocity": motion.velocity}
    if one.quantity not in own:
        return np.zeros_like(total)
    return np.asarray(total - one.factor * own[one.quantity][:, i])


def _measurement(
    sensor: LinkSensor,
    axes: list[SensorAxis],
    joint: Joint,
    mode_hz: float,
    period: float,
    samples: Mapping[str, float],
) -> Measurement | str:
    """The reading of a sensor of a link, or the reason why it is not used."""
    source = _source(sensor, joint)
    if isinstance(source, str):
        return source
    of_axes, quantity, factor = source
    if sensor.hz is not None and sensor.hz < _MIN_BANDWIDTH_RATIO * mode_hz:
        return (
            f"its bandwidth of {sensor.hz:g} Hz is less than {_MIN_BANDWIDTH_RATIO:g} times "
            f"the mode of the link at {mode_hz:.3g} Hz"
        )
    axes = [axis for axis in axes if of_axes[axis.number]]
    if {axis.number for axis in axes} != set(np.flatnonzero(of_axes).tolist()):
        return "not all of the axes that its direction needs have channels"
    noises = [_noise(axis, joint, period, samples) for axis in axes]
    if not all(std for std, _ in noises):
        return "its noise is not known"
    weights = tuple(float(of_axes[axis.number]) for axis in axes)
    stds = [weight * std for weight, (std, _) in zip(weights, noises, strict=True)]
    is_prismatic = joint.motion == "prismatic"
    return Measurement(
        name=sensor.noun,
        channels=tuple(axis.channel for axis in axes),
        weights=weights,
        quantity=quantity,
        unit=(is_prismatic and sensor.prismatic_unit) or sensor.unit,
        std=float(np.linalg.norm(stds)),
        source=noises[0][1],
        factor=factor,
        has_bias=sensor.has_bias,
        resolution=sensor.resolution,
        axes=tuple(axes),
    )


def _source(sensor: LinkSensor, joint: Joint) -> _Source | str:
    """What a sensor measures for an observer, or the reason why it is not used."""
    is_prismatic = joint.motion == "prismatic"
    match sensor:
        case Gyro() | ImuGyros() | ImuAccelerometers() if is_prismatic:
            source: _Source | str = "it is not used on a prismatic joint"
        case Accelerometer(is_at_known_place=True):
            lever = 1.0 if is_prismatic else float(joint.accelerometer_distance or 0.0)
            source = (_ONE, "link_acceleration", lever)
        case Accelerometer():
            source = "its distance from the axis is not known"
        case ImuAccelerometers(xyz=(_, _, _) as xyz, rpy=(_, _, _) as rpy):
            tangent = np.cross(axes_about(joint.axis)[2], xyz)  # accelerates by (z x r) ddq
            lever = float(np.linalg.norm(tangent))
            if lever < _MIN_LEVER:
                return "it is on the axis of the joint"
            source = (_along(rpy, tangent / lever), "link_acceleration", lever)
        case ImuAccelerometers():
            source = "its position and attitude are not in the study"
        case ImuGyros(case=Imu(rpy=(_, _, _) as rpy)):
            source = (_along(rpy, axes_about(joint.axis)[2]), "link_velocity", 1.0)
        case ImuGyros():
            source = "its attitude is not in the study"
        case _:
            source = _SIMPLE.get(type(sensor), "observers have no model of it")
    return source


def _along(rpy: Sequence[float], direction: FloatArray) -> FloatArray:
    """Weights (3,) of the axes of an IMU in the reading along a direction of the link."""
    weights = attitude(rpy).T @ direction
    return np.where(np.abs(weights) < _MIN_WEIGHT, 0.0, weights)


def _noise(
    axis: SensorAxis, joint: Joint, period: float, samples: Mapping[str, float]
) -> tuple[float, str]:
    """Standard deviation of one sample and its source; zero if it is not known."""
    sensor, channel = axis.sensor, axis.channel
    known = samples.get(channel.replace("theta", "omega")) or samples.get(channel)
    if known:
        return known, "identified"
    if sensor.resolution:
        return sensor.resolution / math.sqrt(12.0), "rounding to counts"
    typical_types: dict[type[LinkSensor], type[LinkSensor]] = {
        ImuAccelerometers: Accelerometer,
        ImuGyros: Gyro,
    }
    typical = typical_types.get(type(sensor), type(sensor)).typical(joint, 0.0)
    return (typical.sample_std(period), "typical of such sensors") if typical else (0.0, "")


def _motor_encoder(joint: Joint, number: int, samples: Mapping[str, float]) -> Measurement:
    """The motor encoder with its identified noise, or that of rounding to its counts."""
    count = math.tau / (joint.encoder_counts or _DEFAULT_COUNTS)
    known = samples.get(f"omega_m{number}")
    rounding = "rounding to counts" if joint.encoder_counts else "assumed counts"
    return Measurement(
        name="motor encoder",
        channels=(f"theta_m{number}",),
        weights=(1.0,),
        quantity="motor_angle",
        unit="rad",
        std=known or count / math.sqrt(12.0),
        source="identified" if known else rounding,
        resolution=count if joint.encoder_counts else 0.0,
    )
