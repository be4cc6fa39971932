"""Tangential accelerometer, at a given distance from the axis of its link or at an unknown one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors.interface import (
    Axis,
    ConstantKind,
    Group,
    LinkSensor,
    SensorConstant,
    TypicalSensor,
)
from strainwave.domain.link_sensors.link_space import (
    ACCELEROMETER_QUANTITIES,
    accelerometer_weights,
)
from strainwave.domain.quantities import Quantity

if TYPE_CHECKING:
    from strainwave.domain.arm import Joint

ACCELEROMETER_DISTANCE, ACCELEROMETER_TILT = "accelerometer_distance", "accelerometer_tilt"
"""Unknowns of the mounting: distance from the axis, and angle to the tangent."""


ACCELEROMETER_DENSITY = 100e-6 * 9.81
"""Noise density [m/s^2/sqrt(Hz)] of a typical accelerometer."""

_TYPICAL_HZ = 300.0  # [Hz] bandwidth of a typical accelerometer
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
    def group(self) -> Group:
        return Group.MOTION if self.is_at_known_place else Group.MOUNTED

    @property
    def rank(self) -> int:
        return 0 if self.is_at_known_place else 1  # in addition to an IMU it adds little

    def quantities(self) -> tuple[Quantity, ...]:
        return ("accelerometer",) if self.is_at_known_place else ACCELEROMETER_QUANTITIES

    def low_passes(self) -> Mapping[str, float | None]:
        own = "accelerometer_hz" if self.is_at_known_place else "imu_accelerometer_hz"
        return {own: self.hz}

    def weights(self, axis: Axis, values: Mapping[Key, float]) -> FloatArray:
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
        hz = joint.accelerometer_hz or _TYPICAL_HZ
        text = f"{hz:g} Hz, {1e3 * ACCELEROMETER_DENSITY:.2g} mm/s^2/sqrt(Hz)"
        if joint.motion == "revolute":
            text += f", {distance:.2g} m from the joint's axis"
        table = replace(joint, accelerometer_distance=distance, accelerometer_hz=hz)
        return TypicalSensor(table, text, noise_density=ACCELEROMETER_DENSITY)

    def unknowns(self, axes: Sequence[Axis]) -> list[Key]:
        return [] if self.is_at_known_place else [(ACCELEROMETER_DISTANCE, axes[0].joint)]

    def is_scale_identifiable(self, axis: Axis, axes: Sequence[Axis]) -> bool:
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
