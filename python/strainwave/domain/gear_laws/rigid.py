"""Rigid gear: no torsion under any torque."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.gear_laws.interface import GearLaw


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
