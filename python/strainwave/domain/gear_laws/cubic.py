"""Cubic law T = k_G delta + k_3 delta^3: the stiffness grows with the square of the torsion.

These are the first two terms of any odd smooth law (Tuttle and Seering, IEEE Transactions on
Robotics and Automation 12(3), 1996).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.gear_laws.interface import STIFFNESS, GearLaw, GearParameter, Values
from strainwave.domain.gear_laws.linear import Linear

CUBIC = "gear_stiffness_cubic"

# Starting values. The equivalent linear stiffness exceeds the stiffness at zero torsion.
_STARTING_STIFFNESS_SHARE = 0.95  # of the equivalent linear stiffness
_STARTING_CUBIC_SHARE = 0.1  # cubic torque over linear torque at the largest torsion


class Cubic(GearLaw):
    """A gear that stiffens smoothly."""

    name = "cubic"
    parameters = (*Linear.parameters, GearParameter(CUBIC, by_load=True))
    simpler = Linear.name
    linearised_note = "the gear stiffens; the linear model has the stiffness at zero torsion"
    equivalent_note = "above the stiffness at zero torsion"

    def torque(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """k_G delta + k_3 delta^3."""
        return (values[STIFFNESS] + values[CUBIC] * torsion**2) * torsion

    def stiffness(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """k_G + 3 k_3 delta^2."""
        return values[STIFFNESS] + 3.0 * values[CUBIC] * torsion**2

    def jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Delta and delta^3."""
        return np.column_stack([torsion, torsion**3])

    def starts(self, stiffness: float, largest_torque: float) -> Values:
        """Slightly lower stiffness at zero torsion, higher stiffness at the largest torque."""
        initial = _STARTING_STIFFNESS_SHARE * stiffness
        cubic = _STARTING_CUBIC_SHARE * initial / (largest_torque / initial) ** 2
        return {STIFFNESS: initial, CUBIC: cubic}
