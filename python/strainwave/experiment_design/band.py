"""Resonances of a guessed joint, and the frequencies that identify it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain.combinations import value_of
from strainwave.domain.parameters import Values, completed
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import TwoInertia, anti_resonance, resonance

MARGIN = 5.0  # below the anti-resonance and above the resonance
LINES = 5  # in the width of the anti-resonance: fewer, and its damping follows from one of them


@dataclass(frozen=True, slots=True)
class Band:
    """The frequencies in which one joint is to be excited."""

    anti_resonance_hz: float  # lowest, of the softest slope
    resonance_hz: float  # highest, of the stiffest slope
    width_hz: float  # of the anti-resonance at half its power

    @property
    def low_hz(self) -> float:
        """Lowest frequency wanted."""
        return self.anti_resonance_hz / MARGIN

    @property
    def high_hz(self) -> float:
        """Highest frequency wanted."""
        return self.resonance_hz * MARGIN

    @property
    def period(self) -> float:
        """[s] that a period needs: `LINES` in the dip's width, and the lowest frequency in it."""
        return max(LINES / self.width_hz, 1.0 / self.low_hz)


def band_of(arm: Arm, values: Values, joint: int) -> Band | None:
    """The band of one joint, as if the others stood still.

    omega_a^2 = k/m_L and width (d_L + d_G)/m_L, zeros of (17), with the inertia of the stretched
    arm; omega_r from its poles. The margin covers what the other joint's freedom and the posture
    change.

    `values`: (name, joint) -> value, all that simulating the arm needs. `joint`: From 1. Returns:
    None: the gear is rigid.
    """
    known = completed(values, arm)
    drive = arm.joints[joint - 1]
    if not drive.elastic:
        return None
    soft, stiff = (
        TwoInertia(
            motor_inertia=known["motor_inertia", joint],
            motor_viscous_friction=known["motor_viscous_friction", joint],
            link_inertia=value_of(arm.link_inertia(joint), known),
            link_viscous_friction=known["link_viscous_friction", joint],
            gear_stiffness=stiffness,
            gear_damping=known["gear_damping", joint],
            gear_ratio=drive.gear_ratio,
        )
        for stiffness in drive.law.stiffness_range(drive.law.of_joint(known, joint))
    )
    damping = soft.link_viscous_friction + soft.gear_damping
    return Band(
        anti_resonance_hz=anti_resonance(soft).frequency_hz,
        resonance_hz=resonance(stiff).frequency_hz,
        width_hz=damping / soft.link_inertia / (2.0 * np.pi),
    )
