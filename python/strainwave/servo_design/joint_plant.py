"""Plant of one joint, on which its observer is based: motor and link with the gear between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from strainwave.domain import FloatArray, Joint
from strainwave.dynamics.arm import Arm
from strainwave.export.source import IdentifiedArm

MOTION = ("motor_angle", "motor_velocity", "link_angle", "link_velocity")

DISTURBANCE, DRIVE_TORQUE, LAST_INPUT = "motor_torque_error", "drive_torque", "last_input"
"""Names of states."""


@dataclass(frozen=True, slots=True, eq=False)
class TwoInertia:
    """Parameters of one joint."""

    number: int
    joint: Joint
    motor_inertia: float
    link_inertia: float
    stiffness: float
    gear_damping: float
    motor_friction: float
    link_friction: float
    dry_friction: float
    torque_per_volt: float

    @classmethod
    def of(cls, arm: IdentifiedArm, model: Arm, number: int, link_inertia: float) -> Self:
        """The joint with the geometric mean of the lowest and highest slope of its gear."""
        joint, values = arm.joint(number), arm.values
        slopes = joint.law.stiffness_range(joint.law.of_joint(values, number))

        def of(name: str) -> float:
            return values.get((name, number), 0.0)

        return cls(
            number=number,
            joint=joint,
            motor_inertia=arm.need("motor_inertia", number),
            link_inertia=link_inertia,
            stiffness=math.sqrt(slopes[0] * slopes[1]),
            gear_damping=arm.need("gear_damping", number),
            motor_friction=of("motor_viscous_friction"),
            link_friction=of("link_viscous_friction"),
            dry_friction=of("motor_coulomb_friction"),
            torque_per_volt=float(model.torque_per_volt[number - 1]),
        )

    @property
    def mode_hz(self) -> float:
        """Frequency of the link while the motor is held."""
        return math.sqrt(self.stiffness / self.link_inertia) / math.tau

    @property
    def gear(self) -> FloatArray:
        """Torque of the gear over angle and velocity of motor and link: (4,)."""
        n, k, c = self.joint.gear_ratio, self.stiffness, self.gear_damping
        return np.array([n * k, n * c, -k, -c])

    def at_rest(self, names: Sequence[str]) -> FloatArray:
        """States at rest over motor angle, interaction torque and input: (n, 3).

        Dry friction holds what gear and drive leave.
        """
        n, rest = self.joint.gear_ratio, np.zeros((len(names), 3))
        rest[0, 0], rest[2, :2] = 1.0, (n, -1.0 / self.stiffness)
        rest[4] = 0.0, n, -self.torque_per_volt
        if DRIVE_TORQUE in names:
            rest[names.index(DRIVE_TORQUE), 2] = self.torque_per_volt
        if LAST_INPUT in names:
            rest[names.index(LAST_INPUT), 2] = 1.0
        return rest

    def equations(self, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """F (n, n) and G (n, 2) of dx = F x + G (u, t_int) for the states of `names`."""
        F, G = np.zeros((len(names), len(names))), np.zeros((len(names), 2))
        n, gear = self.joint.gear_ratio, self.gear
        F[0, 1] = F[2, 3] = 1.0
        F[1, :4] = -n * gear / self.motor_inertia
        F[1, 1] -= self.motor_friction / self.motor_inertia
        F[3, :4] = gear / self.link_inertia
        F[3, 3] -= self.link_friction / self.link_inertia
        F[1, names.index(DISTURBANCE)] = 1.0 / self.motor_inertia
        G[3, 1] = -1.0 / self.link_inertia
        if DRIVE_TORQUE in names:
            at, rate = names.index(DRIVE_TORQUE), math.tau * (self.joint.current_loop_hz or 0.0)
            F[1, at], F[at, at] = 1.0 / self.motor_inertia, -rate
            G[at, 0] = rate * self.torque_per_volt
        else:
            G[1, 0] = self.torque_per_volt / self.motor_inertia
        return F, G
