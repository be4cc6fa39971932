"""Sensors with one reading per link: accelerometer, encoders, gyro, gear torsion and torque."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from strainwave.domain.arm.description import Joint
from strainwave.domain.arm.link_sensors.interface import (
    ConstantKind,
    LinkSensor,
    SensorAxis,
    SensorConstant,
    SensorGroup,
    TypicalSensor,
)
from strainwave.domain.arm.link_sensors.link_space import (
    ACCELEROMETER_QUANTITIES,
    Quantity,
    accelerometer_weights,
)
from strainwave.domain.keys import FloatArray, Key

ACCELEROMETER_DISTANCE, ACCELEROMETER_TILT = "accelerometer_distance", "accelerometer_tilt"
"""Unknowns of the mounting: distance from the axis, and angle to the tangent."""


ACCELEROMETER_DENSITY = 100e-6 * 9.81
"""Noise density [m/s^2/sqrt(Hz)] of a typical accelerometer."""

_TYPICAL_ACCELEROMETER_HZ = 300.0  # [Hz] bandwidth of a typical accelerometer
_DEFAULT_DISTANCE = 0.3  # [m] from the axis if the study gives no length


@dataclass(frozen=True)
class Accelerometer(LinkSensor):
    """Accelerometer `a{i}` along the tangent, or along a prismatic joint."""

    is_at_known_place: bool
    hz: float | None = None
    is_in_table: bool = False

    name = noun = "accelerometer"
    channel_kinds = ("a",)
    unit = "m/s^2"
    measurand = "acceleration"
    keys: ClassVar[Mapping[str, tuple[str, str]]] = {
        "accelerometer_distance": ("accelerometer distance from the joint axis", "m"),
        "accelerometer_hz": ("accelerometer bandwidth", "Hz"),
    }
    suggested_as = "an accelerometer"
    bandwidth_key = "accelerometer_hz"

    @classmethod
    def of_joint(cls, joint: Joint) -> Self:
        is_known = joint.motion == "prismatic" or joint.accelerometer_distance is not None
        return cls(is_known, joint.accelerometer_hz, joint.accelerometer_distance is not None)

    @property
    def group(self) -> SensorGroup:
        return SensorGroup.MOTION if self.is_at_known_place else SensorGroup.MOUNTED

    @property
    def rank(self) -> int:
        return 0 if self.is_at_known_place else 1  # in addition to an IMU it adds little

    def quantities(self) -> tuple[Quantity, ...]:
        return ("accelerometer",) if self.is_at_known_place else ACCELEROMETER_QUANTITIES

    def low_passes(self) -> Mapping[str, float | None]:
        own = "accelerometer_hz" if self.is_at_known_place else "imu_accelerometer_hz"
        return {own: self.hz}

    def weights(self, axis: SensorAxis, values: Mapping[Key, float]) -> FloatArray:
        if self.is_at_known_place:
            return np.ones(1)
        tilt = values.get((ACCELEROMETER_TILT, axis.joint), 0.0)
        x, y, _ = axis.space.directions
        direction = np.cos(tilt) * y - np.sin(tilt) * x
        position = values[ACCELEROMETER_DISTANCE, axis.joint] * x
        return accelerometer_weights(direction.tolist(), position.tolist())

    def with_place(self, joint: Joint, number: int, values: Mapping[Key, float]) -> Joint:
        known = joint.accelerometer_distance or values.get((ACCELEROMETER_DISTANCE, number))
        return replace(joint, accelerometer_distance=known)

    @classmethod
    def typical(cls, joint: Joint, length: float) -> TypicalSensor:
        distance = joint.accelerometer_distance or length or _DEFAULT_DISTANCE
        hz = joint.accelerometer_hz or _TYPICAL_ACCELEROMETER_HZ
        text = f"{hz:g} Hz, {1e3 * ACCELEROMETER_DENSITY:.2g} mm/s^2/sqrt(Hz)"
        if joint.motion == "revolute":
            text += f", {distance:.2g} m from the joint's axis"
        table = replace(joint, accelerometer_distance=distance, accelerometer_hz=hz)
        return TypicalSensor(table, text, noise_density=ACCELEROMETER_DENSITY)

    def unknowns(self, axes: Sequence[SensorAxis]) -> list[Key]:
        return [] if self.is_at_known_place else [(ACCELEROMETER_DISTANCE, axes[0].joint)]

    def is_scale_identifiable(self, axis: SensorAxis, axes: Sequence[SensorAxis]) -> bool:
        return self.is_at_known_place or axis.space.has_varying_force

    @classmethod
    def extra_constants(cls) -> tuple[SensorConstant, ...]:
        return (
            SensorConstant(
                cls.name,
                ConstantKind.DISTANCE,
                "m",
                "distance of the accelerometer from its link's own axis",
                "l_a",
            ),
            SensorConstant(
                cls.name,
                ConstantKind.TILT,
                "rad",
                "angle between the accelerometer and the tangent, in the plane of motion",
            ),
        )


_TYPICAL_COUNTS = 2**17  # per turn, of a typical link encoder


@dataclass(frozen=True)
class LinkEncoder(LinkSensor):
    """Encoder `theta_l{i}` of the link angle; the line count gives its scale."""

    resolution: float = 0.0

    name = "link_encoder"
    noun = "link encoder"
    channel_kinds = ("theta_l",)
    unit = "rad"
    measurand = "link angle"
    prismatic_unit = "m"
    by_channel = True
    keys: ClassVar[Mapping[str, tuple[str, str]]] = {
        "link_encoder_counts": ("link encoder, counts per turn", "1")
    }
    suggested_as = "an encoder"
    rank = 1
    reads_angle = True
    has_bias = False
    common = (ConstantKind.DELAY,)
    per_axis = ()

    @classmethod
    def of_joint(cls, joint: Joint) -> Self:
        counts = joint.link_encoder_counts
        return cls(math.tau / counts if counts else 0.0)

    def quantities(self) -> tuple[Quantity, ...]:
        return ("link_angle",)

    @classmethod
    def typical(cls, joint: Joint, length: float) -> TypicalSensor | None:
        if joint.motion == "prismatic":
            return None
        counts = joint.link_encoder_counts or _TYPICAL_COUNTS
        return TypicalSensor(joint, f"{counts:g} counts per turn", resolution=math.tau / counts)


@dataclass(frozen=True)
class MotorEncoder(LinkSensor):
    """Encoder `theta_m{i}`, to which the delays of link sensors are relative.

    Its own delay is relative to the logged torque of the motor: drives sample and filter it at
    unknown times. `torque_hold` tells how that torque continues between its samples (S32). A logged
    voltage has neither, because it is held and the model contains the current loop.
    """

    resolution: float = 0.0

    name, noun = "motor_encoder", "motor encoder"
    time_reference = "logged torque"
    channel_kinds = ("theta_m",)
    unit = "rad"
    measurand = "motor angle"
    group = SensorGroup.MOTOR
    reads_angle = True
    has_bias = False
    common, per_axis = (ConstantKind.DELAY,), (ConstantKind.HOLD,)

    @classmethod
    def of_joint(cls, joint: Joint) -> Self:
        return cls(joint.encoder_resolution)

    @classmethod
    def owner(cls, number: int) -> str:
        return "torque"

    @classmethod
    def axis_noun(cls, number: int) -> str:
        return cls.time_reference

    def quantities(self) -> tuple[Quantity, ...]:
        return ("motor_angle",)


_TYPICAL_GYRO_HZ = 100.0  # [Hz] bandwidth of a typical gyro
_TYPICAL_GYRO_DENSITY = math.radians(0.01)  # [rad/s/sqrt(Hz)] its noise density


@dataclass(frozen=True)
class Gyro(LinkSensor):
    """Gyro `gyro{i}`: the rate of link i in space."""

    hz: float | None = None

    name = noun = "gyro"
    channel_kinds = ("gyro",)
    unit = "rad/s"
    measurand = "link rate"
    low_pass_order = 1
    keys: ClassVar[Mapping[str, tuple[str, str]]] = {"gyro_hz": ("gyro bandwidth", "Hz")}
    suggested_as = "a gyro"
    bandwidth_key = "gyro_hz"
    rank = 2

    @classmethod
    def of_joint(cls, joint: Joint) -> Self:
        return cls(joint.gyro_hz)

    @property
    def is_in_table(self) -> bool:
        return self.hz is not None

    def quantities(self) -> tuple[Quantity, ...]:
        return ("gyro",)

    def low_passes(self) -> Mapping[str, float | None]:
        return {"gyro_hz": self.hz}

    @classmethod
    def typical(cls, joint: Joint, length: float) -> TypicalSensor | None:
        if joint.motion == "prismatic":
            return None
        hz = joint.gyro_hz or _TYPICAL_GYRO_HZ
        text = f"{hz:g} Hz, 0.01 deg/s/sqrt(Hz)"
        return TypicalSensor(replace(joint, gyro_hz=hz), text, noise_density=_TYPICAL_GYRO_DENSITY)


@dataclass(frozen=True)
class TorsionSensor(LinkSensor):
    """Sensor `deflection{i}` of theta_L - C N theta_M. With the motors' angles, a link encoder."""

    name = "torsion_sensor"
    noun = "torsion sensor"
    channel_kinds = ("deflection",)
    unit = "rad"
    measurand = "torsion"
    prismatic_unit = "m"
    by_channel = True
    group = None  # compared as the link angle that it gives with the motor encoder
    reads_angle = True
    has_bias = False
    common = per_axis = ()

    @classmethod
    def of_joint(cls, joint: Joint) -> Self:
        return cls()

    def quantities(self) -> tuple[Quantity, ...]:
        return ("torsion",)

    def weights(self, axis: SensorAxis, values: Mapping[Key, float]) -> FloatArray:
        return np.array([-1.0])


@dataclass(frozen=True)
class TorqueSensor(LinkSensor):
    """Sensor `tau_l{i}` of the gear's torque at the link, T + D_G ddelta."""

    name = "torque_sensor"
    noun = "joint torque sensor"
    channel_kinds = ("tau_l",)
    unit = "N m"
    measurand = "joint torque"
    prismatic_unit = "N"
    by_channel = True
    group = SensorGroup.TORQUE
    common = (ConstantKind.DELAY,)

    @classmethod
    def of_joint(cls, joint: Joint) -> Self | None:
        return cls() if joint.elastic else None  # the core computes no torque of a rigid gear

    def quantities(self) -> tuple[Quantity, ...]:
        return ("gear_torque",)
