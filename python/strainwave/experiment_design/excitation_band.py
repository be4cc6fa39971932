"""Resonances of a guessed joint, and the band that identifies it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.base_parameters import link_inertia
from strainwave.domain.combinations import value_of
from strainwave.domain.keys import Values
from strainwave.domain.parameters import complete_values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import TwoInertia, anti_resonance, resonance

BAND_MARGIN = 5.0  # factor below the anti-resonance and above the resonance
# Spectral lines in the half-power width of the anti-resonance, to resolve its damping.
MIN_RESONANCE_LINES = 5


@dataclass(frozen=True, slots=True)
class ExcitationBand:
    """Band in which one joint must be excited."""

    anti_resonance_hz: float  # of the lowest slope
    resonance_hz: float  # of the highest slope
    width_hz: float  # half-power width of the anti-resonance

    @property
    def low_hz(self) -> float:
        """Lower edge of the band."""
        return self.anti_resonance_hz / BAND_MARGIN

    @property
    def high_hz(self) -> float:
        """Upper edge of the band."""
        return self.resonance_hz * BAND_MARGIN

    @property
    def period(self) -> float:
        """Period [s] with `LINES` in the anti-resonance's width and a line at the lower edge."""
        return max(MIN_RESONANCE_LINES / self.width_hz, 1.0 / self.low_hz)


def band_of(
    arm: Arm, values: Values, joint: int, posture: FloatArray | None = None
) -> ExcitationBand | None:
    """Band of one joint, from 1, with the others at rest; None if the gear is rigid.

    The zeros of (17) give omega_a^2 = k/m_L and the width (d_L + d_G)/m_L; the poles give omega_r.
    The link inertia is that in a posture (n_joints,); without one, that of the stretched arm. The
    margin covers the motion of other joints and other postures.
    """
    known = complete_values(values, arm)
    drive = arm.joints[joint - 1]
    if not drive.elastic:
        return None
    softest, stiffest = (
        TwoInertia(
            motor_inertia=known["motor_inertia", joint],
            motor_viscous_friction=known["motor_viscous_friction", joint],
            link_inertia=value_of(link_inertia(arm, joint, posture), known),
            link_viscous_friction=known["link_viscous_friction", joint],
            gear_stiffness=stiffness,
            gear_damping=known["gear_damping", joint],
            gear_ratio=float(arm.gear_ratios[joint - 1]),
        )
        for stiffness in drive.law.stiffness_range(drive.law.of_joint(known, joint))
    )
    damping = softest.link_viscous_friction + softest.gear_damping
    return ExcitationBand(
        anti_resonance_hz=anti_resonance(softest).frequency_hz,
        resonance_hz=resonance(stiffest).frequency_hz,
        width_hz=damping / softest.link_inertia / (2.0 * np.pi),
    )
