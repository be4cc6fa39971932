"""Units of a joint's servo: the input of the drive, and the coordinate of the motor."""

from __future__ import annotations

from dataclasses import dataclass

from strainwave.domain import Joint


@dataclass(frozen=True, slots=True)
class Units:
    """Units of one joint."""

    angle: str  # of the motor
    input: str  # of the drive: a voltage, or a torque
    torque: str  # at the motor

    @classmethod
    def of(cls, joint: Joint) -> Units:
        """The units; without `torque_per_volt` the input is a torque."""
        angle, torque = ("m", "N") if joint.motion == "prismatic" else ("rad", "N m")
        return cls(angle, torque if joint.torque_per_volt is None else "V", torque)

    @property
    def velocity(self) -> str:
        """Of the reference's velocity."""
        return f"{self.angle}/s"

    @property
    def kp(self) -> str:
        """Input per velocity."""
        return f"{self.input} s/{self.angle}"

    @property
    def ki(self) -> str:
        """Input per angle."""
        return f"{self.input}/{self.angle}"
