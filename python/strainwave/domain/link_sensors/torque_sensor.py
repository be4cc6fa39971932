"""Joint torque sensor between gear and link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from strainwave.domain.link_sensors.interface import ConstantKind, Group, LinkSensor
from strainwave.domain.quantities import Quantity

if TYPE_CHECKING:
    from strainwave.domain.arm import Joint


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
