"""Laws without knees: rigid, linear T = K delta, and cubic T = k_G delta + k_3 delta^3.

The terms of the cubic law are the first two of any odd smooth law (Tuttle and Seering, IEEE
Transactions on Robotics and Automation 12(3), 1996).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.gear_laws.interface import STIFFNESS, GearLaw, GearParameter, Values


class Linear(GearLaw):
    """One stiffness at all torsions."""

    name = "linear"
    parameters = (GearParameter(STIFFNESS, is_slope=True),)
    lists: Mapping[str, tuple[str, ...]] = {STIFFNESS: (STIFFNESS,)}

    def torque(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """K delta."""
        return values[STIFFNESS] * torsion

    def stiffness(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """K."""
        return np.full_like(torsion, values[STIFFNESS])

    def jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Delta."""
        return torsion[:, None]


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


class Rigid(GearLaw):
    """Motor and link move as one body. The law has no parameters."""

    name = "rigid"
    elastic = False

    def torque(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Zero without torsion, otherwise infinite."""
        return np.where(torsion == 0.0, 0.0, np.copysign(np.inf, torsion))

    def stiffness(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Infinite."""
        return np.full_like(torsion, np.inf)

    def jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """No columns."""
        return np.zeros((len(torsion), 0))

    def torsion(self, values: Mapping[str, float], torque: FloatArray) -> FloatArray:
        """Zero."""
        return np.zeros_like(torque)
