"""Searches on objectives with a known minimum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from strainwave.domain import FloatArray, SearchEnd, WholeArmOptions
from strainwave.identification.whole_arm.search import Fit, fine_search, polish
from strainwave.numerics.search import Flat, Linearised

MINIMUM = 1.0
NOISE_COST = 1000.0
JUMP = 50.0  # of the cost where the step error is not that of the corrected point
REACH = 1e-3  # of a correction


@dataclass(frozen=True)
class Corrected:
    """Cost 10 (z - 1)^2 + 1000, with a jump around the point at which it is corrected."""

    corrected_at: float | None = None
    space = Flat()
    weights = ()

    def cost(self, z: FloatArray) -> float:
        at = self.corrected_at
        jump = JUMP if at is not None and abs(z[0] - at) > REACH else 0.0
        return float(10.0 * (z[0] - MINIMUM) ** 2 + NOISE_COST + jump)

    def linearise(self, z: FloatArray) -> Linearised:
        slope = 10.0**0.5
        factor = np.array([[slope, slope * (z[0] - MINIMUM)], [0.0, NOISE_COST**0.5]])
        return Linearised(self.cost(z), factor)

    def correct_step_error(self, z: FloatArray) -> Corrected:
        return Corrected(float(z[0]))

    def update_weights(self, _: FloatArray) -> Corrected:
        return self

    def resolve_modes(self, _: FloatArray) -> Corrected:
        return self

    def free_ended(self, *_: Corrected) -> None:
        """Nothing is cached."""


def test_a_search_leaves_the_point_of_its_step_error_correction() -> None:
    start = Fit.at(cast(Any, Corrected()), np.zeros(1))
    fit = polish(fine_search(start, WholeArmOptions()), WholeArmOptions())
    assert fit.end is SearchEnd.CONVERGED
    np.testing.assert_allclose(fit.z, MINIMUM, atol=REACH)
    assert fit.iterations < 12


def test_a_search_stays_where_the_exact_cost_does_not_decrease() -> None:
    start = Fit.at(cast(Any, Corrected()), np.array([MINIMUM]))
    fit = polish(fine_search(start, WholeArmOptions()), WholeArmOptions())
    assert fit.z[0] == MINIMUM
    assert fit.cost == NOISE_COST
