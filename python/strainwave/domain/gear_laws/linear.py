"""Linear law T = K delta."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.gear_laws.interface import STIFFNESS, GearLaw, GearParameter


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
