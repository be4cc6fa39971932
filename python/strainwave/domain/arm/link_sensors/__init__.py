"""Link sensors: a class per type.

A new type needs a class in this package and an entry in `TYPES`, and simulated quantities of the
core. All other code loops over the sensors of a joint.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cache
from types import MappingProxyType

import numpy as np

from strainwave.domain.arm.description import ArmDescription, Joint
from strainwave.domain.arm.link_sensors.imu import ImuAccelerometers, ImuGyros
from strainwave.domain.arm.link_sensors.interface import ConstantKind as ConstantKind
from strainwave.domain.arm.link_sensors.interface import LinkSensor as LinkSensor
from strainwave.domain.arm.link_sensors.interface import SensorAxis as SensorAxis
from strainwave.domain.arm.link_sensors.interface import SensorConstant as SensorConstant
from strainwave.domain.arm.link_sensors.interface import SensorGroup as SensorGroup
from strainwave.domain.arm.link_sensors.interface import TypicalSensor as TypicalSensor
from strainwave.domain.arm.link_sensors.link_space import link_space
from strainwave.domain.arm.link_sensors.single_axis import (
    Accelerometer,
    Gyro,
    LinkEncoder,
    MotorEncoder,
    TorqueSensor,
    TorsionSensor,
)
from strainwave.domain.arm.parameter_table import base_name
from strainwave.domain.keys import JointNumber, Key

TYPES: dict[str, type[LinkSensor]] = {
    sensor.name: sensor
    for sensor in (
        *(Accelerometer, LinkEncoder, TorsionSensor, Gyro),
        *(ImuAccelerometers, ImuGyros, TorqueSensor),
    )
}
"""All types by name."""


def all_types() -> tuple[type[LinkSensor], ...]:
    """All types in the order of `TYPES`."""
    return tuple(TYPES.values())


def link_channel_kinds() -> tuple[str, ...]:
    """Channels of all types, without the joint's number."""
    return tuple(kind for sensor in all_types() for kind in sensor.channel_kinds)


def key_texts() -> Mapping[str, tuple[str, str]]:
    """Keys of a `[[joint]]` table that describe sensors of the link: title in reports, and unit."""
    return {key: text for sensor in all_types() for key, text in sensor.keys.items()}


@cache
def sensor_constants() -> Mapping[str, SensorConstant]:
    """Constants of the motor encoder and of all types by name, without records."""
    types: tuple[type[LinkSensor], ...] = (MotorEncoder, *all_types())
    constants = (constant for sensor in types for constant in sensor.constants())
    return MappingProxyType({constant.name: constant for constant in constants})


def constant_of(key: Key) -> SensorConstant | None:
    """The sensor constant that a key names; None for a parameter of the arm."""
    return sensor_constants().get(base_name(key[0]))


def is_kind(key: Key, *kinds: ConstantKind) -> bool:
    """Whether a key names a sensor constant of one of these kinds."""
    constant = constant_of(key)
    return constant is not None and constant.kind in kinds


def is_hidden(key: Key) -> bool:
    """Whether a key names a sensor constant that results do not contain."""
    constant = constant_of(key)
    return constant is not None and constant.is_hidden


def nominal(key: Key) -> float:
    """Value of a sensor constant for an ideal sensor."""
    constant = constant_of(key)
    return constant.kind.nominal if constant else 0.0


def optional_constants() -> tuple[str, ...]:
    """Names of the constants that the whole-arm fit estimates if the data support them."""
    return tuple(name for name, constant in sensor_constants().items() if constant.is_optional)


def sensors_of(joint: Joint) -> tuple[LinkSensor, ...]:
    """Sensors that the link of a joint can have, with the constants of the joint's table."""
    sensors = (sensor.of_joint(joint) for sensor in all_types())
    return tuple(sensor for sensor in sensors if sensor is not None)


def sensor_of(joint: Joint, kind: str) -> LinkSensor | None:
    """The sensor of a joint with a channel of this kind; None if there is none."""
    return next((sensor for sensor in sensors_of(joint) if kind in sensor.channel_kinds), None)


def low_passes(joint: Joint) -> dict[str, float | None]:
    """Low-passes [Hz] of a joint's simulated quantities by argument of the core."""
    passes: dict[str, float | None] = {}
    for sensor in sensors_of(joint):
        passes |= sensor.low_passes()
    return passes


def axes_of(arm: ArmDescription, number: JointNumber) -> tuple[SensorAxis, ...]:
    """Axes of all sensors that the link of a joint can have."""
    space, sensors = link_space(arm, number), sensors_of(arm.joints[number - 1])
    return tuple(axis for sensor in sensors for axis in sensor.axes(number, space))


def installed_axes(
    arm: ArmDescription, number: JointNumber, channels: Collection[str]
) -> tuple[SensorAxis, ...]:
    """Axes that the link of a joint has by its table or by the channels of a study."""
    return tuple(
        axis
        for axis in axes_of(arm, number)
        if axis.sensor.is_in_table or (axis.sensor.by_channel and axis.channel in channels)
    )


def compared_axes(
    arm: ArmDescription, number: JointNumber, channels: Collection[str]
) -> tuple[SensorAxis, ...]:
    """Axes on a link that a fit compares if a log has these channels.

    Of each group of sensors, in the order of the groups, these are the axes of least rank.
    """
    axes = [axis for axis in axes_of(arm, number) if axis.channel in channels]
    compared: list[SensorAxis] = []
    for group in SensorGroup:
        of_group = [axis for axis in axes if axis.sensor.group is group]
        least = min((axis.sensor.rank for axis in of_group), default=0)
        compared += [axis for axis in of_group if axis.sensor.rank == least]
    return tuple(compared)


def mounted_axes(
    arm: ArmDescription, number: int, channels: Collection[str]
) -> tuple[SensorAxis, ...]:
    """The compared axes whose readings depend on a mounting."""
    axes = compared_axes(arm, number, channels)
    return tuple(axis for axis in axes if axis.is_mounted)


def unknowns_of(axes: Sequence[SensorAxis]) -> list[Key]:
    """Unknowns of the mounting of one link's axes, in the coordinates of a fit."""
    return axes[0].sensor.unknowns(axes) if axes else []


def with_estimates(joint: Joint, number: JointNumber, values: Mapping[Key, float]) -> Joint:
    """The table of a joint with estimated bandwidths and places of its sensors."""
    for sensor in sensors_of(joint):
        joint = sensor.with_place(joint, number, values)
    return with_bandwidths(joint, number, values)


def with_bandwidths(joint: Joint, number: JointNumber, values: Mapping[Key, float]) -> Joint:
    """The table of a joint with the finite bandwidths among some sensor constants."""
    for sensor in sensors_of(joint):
        hz = sensor.axes(number)[0].value(ConstantKind.BANDWIDTH, values)
        joint = sensor.with_bandwidth(joint, hz) if np.isfinite(hz) else joint
    return joint
