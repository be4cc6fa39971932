"""Selection of the bandwidth of the rigid step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest

from strainwave.domain import ArmDescription, FloatArray, Joint
from strainwave.dynamics.arm import Arm
from strainwave.identification.rigid.trial import Trial, select_bandwidth

RIGID = Arm.of(ArmDescription("single-joint", (Joint("rigid", 1.0),)))


@dataclass(frozen=True)
class Fitted:
    """Estimate and standard deviation of one parameter at one bandwidth."""

    bandwidth_hz: float
    value: float
    std: float
    arm: Arm = RIGID
    has_short_blocks: bool = False

    @property
    def solution(self) -> FloatArray:
        return np.array([self.value])

    @property
    def covariance(self) -> FloatArray:
        return np.array([[self.std**2]])

    @property
    def spread(self) -> FloatArray:
        return np.log([self.std])


def selected(*fits: Fitted) -> float:
    return select_bandwidth(cast(list[Trial], list[Any](fits))).bandwidth_hz


@pytest.mark.parametrize(("values", "best"), [((1.0, 1.02, 0.99), 16.0), ((1.0, 0.98, 0.85), 8.0)])
def test_a_bandwidth_whose_estimate_is_biased_is_not_selected(
    values: tuple[float, float, float], best: float
) -> None:
    """Noise of the acceleration lowers inertias at high frequencies, and standard deviations."""
    bands, stds = (4.0, 8.0, 16.0), (0.05, 0.03, 0.02)
    fits = [Fitted(f, x, s) for f, x, s in zip(bands, values, stds, strict=True)]
    assert selected(*fits) == best


def test_elastic_gears_limit_the_bandwidth_themselves() -> None:
    elastic = Arm.of(ArmDescription("single-joint", (Joint("linear", 1.0),)))
    fits = Fitted(8.0, 1.0, 0.03), Fitted(16.0, 0.85, 0.02)
    assert selected(*(replace(fit, arm=elastic) for fit in fits)) == 16.0


def test_few_rows_do_not_give_the_smallest_standard_deviation() -> None:
    """Of 68 rows with 17 unknowns, the blocks of a jackknife agree by chance."""
    short, long = Fitted(1.0, 1.0, 0.001, has_short_blocks=True), Fitted(2.0, 1.1, 0.03)
    assert selected(short, long) == 2.0
    assert selected(short) == 1.0
