"""T = k_G delta + k_3 delta^3: the stiffness grows with the square of the torsion.

The first two terms of any odd smooth law (Tuttle and Seering, IEEE Transactions on Robotics and
Automation 12(3), 1996).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.gear_laws.interface import STIFFNESS, GearLaw, GearParameter, Values
from strainwave.domain.gear_laws.linear import Linear

CUBIC = "gear_stiffness_cubic"

_SOFTER = 0.95  # of the one stiffness found, which lies above that without torsion
_SHARE = 0.1  # of the linear torque at the largest torsion: the cubic one to start from


class Cubic(GearLaw):
    """A gear that stiffens without knees."""

    name = "cubic"
    parameters = (*Linear.parameters, GearParameter(CUBIC, by_load=True))
    simpler = Linear.name
    linearised_note = "its gear stiffens; the linear model has the stiffness without torsion"
    equivalent_note = "above the stiffness without torsion"

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
        """Somewhat softer without torsion, stiffer at the largest torque."""
        own = _SOFTER * stiffness
        return {STIFFNESS: own, CUBIC: _SHARE * own / (largest_torque / own) ** 2}
