"""Encoders: of the motor, and a second one on the link's side of the gear."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from strainwave.domain.link_sensors.interface import ConstantKind, Group, LinkSensor, TypicalSensor
from strainwave.domain.quantities import Quantity

if TYPE_CHECKING:
    from strainwave.domain.arm import Joint

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
