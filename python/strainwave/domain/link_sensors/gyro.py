"""Gyro about the axis of a joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from strainwave.domain.link_sensors.interface import LinkSensor

if TYPE_CHECKING:
    from strainwave.domain.arm import Joint


@dataclass(frozen=True)
class Gyro(LinkSensor):
    """Gyro `gyro{i}`: the rate of link i in space."""

    hz: float | None = None

    name = noun = "gyro"
    channel_kinds = ("gyro",)
    drift_unit = "rad/s^2"
    keys = ("gyro_hz",)
    bandwidth_key = "gyro_hz"
    rank = 2

    @classmethod
    def of_joint(cls, joint: Joint) -> Self:
        return cls(joint.gyro_hz)

    def quantities(self) -> tuple[str, ...]:
        return ("gyro",)

    def low_passes(self) -> Mapping[str, float | None]:
        return {"gyro_hz": self.hz}
