"""Encoder of a motor, with the interface of a link sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from strainwave.domain.link_sensors.interface import Group, LinkSensor
from strainwave.domain.quantities import Quantity

if TYPE_CHECKING:
    from strainwave.domain.arm import Joint


@dataclass(frozen=True)
class MotorEncoder(LinkSensor):
    """Encoder `theta_m{i}`, to which the delays of link sensors are relative."""

    resolution: float = 0.0

    name = noun = "encoder"
    channel_kinds = ("theta_m",)
    unit = "rad"
    measurand = "motor angle"
    group = Group.MOTOR
    reads_angle = True
    has_bias = False
    common = per_axis = ()

    @classmethod
    def of_joint(cls, joint: Joint) -> Self:
        return cls(joint.encoder_resolution)

    def quantities(self) -> tuple[Quantity, ...]:
        return ("motor_angle",)
