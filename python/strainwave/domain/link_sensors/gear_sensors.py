"""Sensors of a gear: its torsion, and the joint torque between gear and link."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors.interface import Axis, ConstantKind, Group, LinkSensor
from strainwave.domain.quantities import Quantity

if TYPE_CHECKING:
    from strainwave.domain.arm import Joint


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

    def weights(self, axis: Axis, values: Mapping[Key, float]) -> FloatArray:
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
    group = Group.TORQUE
    common = (ConstantKind.DELAY,)

    @classmethod
    def of_joint(cls, joint: Joint) -> Self | None:
        return cls() if joint.elastic else None  # the core computes no torque of a rigid gear

    def quantities(self) -> tuple[Quantity, ...]:
        return ("gear_torque",)
