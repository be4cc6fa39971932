"""Encoder of a motor, with the interface of a link sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from strainwave.domain.link_sensors.interface import ConstantKind, Group, LinkSensor
from strainwave.domain.quantities import Quantity

if TYPE_CHECKING:
    from strainwave.domain.arm import Joint


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
    group = Group.MOTOR
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
