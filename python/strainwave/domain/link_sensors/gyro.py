"""Gyro about the axis of a joint."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from strainwave.domain.link_sensors.interface import LinkSensor, TypicalSensor
from strainwave.domain.quantities import Quantity

if TYPE_CHECKING:
    from strainwave.domain.arm import Joint


_TYPICAL_HZ = 100.0  # [Hz] bandwidth of a typical gyro
_TYPICAL_DENSITY = math.radians(0.01)  # [rad/s/sqrt(Hz)] its noise density


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
        hz = joint.gyro_hz or _TYPICAL_HZ
        text = f"{hz:g} Hz, 0.01 deg/s/sqrt(Hz)"
        return TypicalSensor(replace(joint, gyro_hz=hz), text, noise_density=_TYPICAL_DENSITY)
