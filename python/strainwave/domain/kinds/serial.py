"""A chain of 1 to 7 joints placed anywhere in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from strainwave.domain.arm import ArmDescription, Joint, Servo, Vector
from strainwave.domain.kinds.base import Kind


@dataclass(frozen=True, slots=True)
class SerialTable:
    """Keys of `[arm]`."""

    gravity: Vector | None = None  # [m/s^2] in the frame of the base


class SerialChain(Kind[SerialTable]):
    """Joints with the origins and axes of their own tables."""

    name = "serial"
    table = SerialTable

    def construct(
        self, table: SerialTable, joints: Sequence[Joint], servo: Servo | None = None
    ) -> ArmDescription:
        """The joints as they are."""
        return ArmDescription(self.name, tuple(joints), table.gravity, servo=servo)

    def table_of(self, arm: ArmDescription) -> SerialTable:
        """Gravity."""
        return SerialTable(arm.gravity)
