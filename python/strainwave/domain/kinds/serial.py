"""A chain of 1 to 7 joints placed anywhere in space."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from strainwave.domain.arm import ArmDescription, Joint, Servo, Vector
from strainwave.domain.kinds.base import Fault, Kind

_MAX_JOINTS = 7  # of the compiled core


@dataclass(frozen=True, slots=True)
class SerialTable:
    """Keys of `[arm]`."""

    gravity: Vector | None = None  # [m/s^2] in the frame of the base


class SerialChain(Kind[SerialTable]):
    """Joints with the origins and axes of their own tables."""

    name = "serial"
    table = SerialTable

    def faults(self, table: SerialTable, joints: Sequence[Joint]) -> Iterator[Fault]:
        """Too many joints, or an axis of length zero."""
        if len(joints) > _MAX_JOINTS:
            yield Fault(
                f"there are {len(joints)} [[joint]] tables, but a chain has at most {_MAX_JOINTS}",
                "describe the joints that move",
                "joint",
            )
        for index, joint in enumerate(joints):
            if not any(joint.axis):
                yield Fault("the axis has length zero", "set its direction", "joint", index, "axis")

    def construct(
        self, table: SerialTable, joints: Sequence[Joint], servo: Servo | None = None
    ) -> ArmDescription:
        """The joints as they are."""
        return ArmDescription(self.name, tuple(joints), table.gravity, servo=servo)

    def table_of(self, arm: ArmDescription) -> SerialTable:
        """Gravity."""
        return SerialTable(arm.gravity)
