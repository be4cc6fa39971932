"""A factor that all parameters with a force in their unit share.

The scale of the torques is not in the data: inertias, friction, gravity and stiffness that change
by one factor point to `torque_per_volt`, or to the scale of the torque channels.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from strainwave.domain.distributions import chi_square_tail, student_tail
from strainwave.domain.formatting import plus_minus

_MIN_PARAMETERS = 3  # that share a factor; two may do so by chance
_MAX_RELATIVE_STD = 0.3  # of a value whose logarithm has nearly Gaussian errors
_MIN_MISFIT_P = 0.01  # of a common factor, by a chi-square test


@dataclass(frozen=True, slots=True)
class CommonFactor:
    """Factor of all torque-like parameters, and its standard deviation."""

    value: float
    std: float

    @property
    def sentence(self) -> str:
        """What it means, as a clause."""
        factor = " +- ".join(plus_minus(self.value, self.std))
        return (
            f"all torque-like parameters differ by one factor, {factor}: compare torque_per_volt or"
            " the scales of the torque channels, with which inertias, friction and stiffness scale"
        )


def is_torque_like(unit: str) -> bool:
    """Whether a parameter scales with the torques: its unit contains N or kg."""
    return not {"N", "kg"}.isdisjoint(unit.replace("/", " ").split())


def common_factor(
    pairs: Iterable[tuple[float, float, float, float]], level: float
) -> CommonFactor | None:
    """The common factor of torque-like values (first, its std, second, its std); None without one.

    A factor other than one must be significant at the level, and explain all changes.
    """
    first, first_std, second, second_std = np.array(list(pairs)).reshape(-1, 4).T
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = second / first
        spread = np.hypot(first_std / first, second_std / second)
    usable = (ratio > 0.0) & (spread > 0.0) & (spread < _MAX_RELATIVE_STD)
    if usable.sum() < _MIN_PARAMETERS:
        return None
    change, weight = np.log(ratio[usable]), spread[usable] ** -2.0
    mean, std = float(weight @ change / weight.sum()), float(weight.sum() ** -0.5)
    misfit = float(weight @ (change - mean) ** 2)
    is_common = chi_square_tail(misfit, len(change) - 1) > _MIN_MISFIT_P
    if not is_common or student_tail(mean / std, np.inf) >= level:
        return None
    return CommonFactor(float(np.exp(mean)), float(np.exp(mean)) * std)
