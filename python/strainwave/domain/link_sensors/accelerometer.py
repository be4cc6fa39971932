"""Tangential accelerometer, at a given distance from the axis of its link or at an unknown one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors.interface import (
    Axis,
    ConstantKind,
    Group,
    LinkSensor,
    SensorConstant,
)
from strainwave.domain.link_sensors.link_signals import (
    ACCELEROMETER_QUANTITIES,
    accelerometer_weights,
)

if TYPE_CHECKING:
    from strainwave.domain.arm import Joint

ACCELEROMETER_DISTANCE, ACCELEROMETER_TILT = "accelerometer_distance", "accelerometer_tilt"
"""Unknowns of the mounting: distance from the axis, and angle to the tangent."""


@dataclass(frozen=True)
class Accelerometer(LinkSensor):
    """Accelerometer `a{i}` along the tangent, or along a prismatic joint."""

    is_at_known_place: bool
    hz: float | None = None

    name = noun = "accelerometer"
    channel_kinds = ("a",)
    drift_unit = "m/s^3"
    keys = ("accelerometer_distance", "accelerometer_hz")
    bandwidth_key = "accelerometer_hz"

    @classmethod
    def of_joint(cls, joint: Joint) -> Self:
        is_known = joint.motion == "prismatic" or joint.accelerometer_distance is not None
        return cls(is_known, joint.accelerometer_hz)

    @property
    def group(self) -> Group:
        return Group.MOTION if self.is_at_known_place else Group.MOUNTED

    @property
    def rank(self) -> int:
        return 0 if self.is_at_known_place else 1  # in addition to an IMU it adds little

    def quantities(self) -> tuple[str, ...]:
        return ("accelerometer",) if self.is_at_known_place else ACCELEROMETER_QUANTITIES

    def low_passes(self) -> Mapping[str, float | None]:
        own = "accelerometer_hz" if self.is_at_known_place else "imu_accelerometer_hz"
        return {own: self.hz}

    def weights(self, axis: Axis, values: Mapping[Key, float]) -> FloatArray:
        if self.is_at_known_place:
            return np.ones(1)
        tilt = values.get((ACCELEROMETER_TILT, axis.joint), 0.0)
        direction = (-np.sin(tilt), np.cos(tilt), 0.0)
        position = (values[ACCELEROMETER_DISTANCE, axis.joint], 0.0, 0.0)
        return accelerometer_weights(direction, position)

    def unknowns(self, axes: Sequence[Axis], *, has_gravity: bool) -> list[Key]:
        return [] if self.is_at_known_place else [(ACCELEROMETER_DISTANCE, axes[0].joint)]

    def is_scale_identifiable(self, axis: Axis, axes: Sequence[Axis], *, has_gravity: bool) -> bool:
        return self.is_at_known_place or axis.joint > 1 or has_gravity

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
