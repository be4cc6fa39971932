"""Physical bounds of zero: rotor inertia, viscous friction and Coulomb friction.

An estimate that is negative by less than its interval is set to zero, and the others are estimated
given it. The covariance is that of the normal distribution truncated at the bound.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from statistics import NormalDist

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.base_parameters import MOTOR_INERTIA
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.ranges import physical_range
from strainwave.identification.rigid.trial import Trial
from strainwave.numerics import least_squares as ls

MAX_NEGLIGIBLE_SHARE = 0.02
"""Share of the torque below which a value, or the half-width of an interval, is negligible."""

_AT_INTERVAL = 1.0 + 1e-9  # for rounding
_NORMAL = NormalDist()


@dataclass(frozen=True, slots=True)
class Bounded:
    """A fit with parameters at their bounds."""

    trial: Trial
    covariance: FloatArray  # (n_parameters, n_parameters) about the estimates
    # parameter at zero -> upper end of its one-sided 95 % interval
    upper: Mapping[int, float] = field(default_factory=dict)


def bound(trial: Trial, covariance: FloatArray) -> Bounded:
    """Set estimates to zero that are negative within their intervals, by an active set.

    The covariance includes the model error. Parameters that are negative beyond their intervals
    keep their values: the model contradicts the data. If the value is negligible, the interval is
    widened to zero instead, because the model error is at least as large.
    """
    columns = trial.arm.rigid_columns
    upper: dict[int, float] = {}
    width = trial.interval_half_width
    bounded = [k for k, c in enumerate(columns) if has_zero_bound(c.name) and trial.determined[k]]
    solution, fit = trial.solution, trial
    torque = float(np.linalg.norm(trial.factor.root * trial.equations.target))
    covariance = covariance.copy()
    for k in bounded:
        if solution[k] * trial.factor.scale[k] > -MAX_NEGLIGIBLE_SHARE * torque:
            reaching = (min(float(solution[k]), 0.0) / width) ** 2
            covariance[k, k] = max(covariance[k, k], reaching)
    while True:
        stds = np.sqrt(np.diag(covariance))
        inside = [
            k
            for k in bounded
            if k not in upper and -_AT_INTERVAL * width * stds[k] <= solution[k] < 0.0
        ]
        if not inside:
            return Bounded(fit, covariance, upper)
        k = min(inside, key=lambda k: solution[k] / stds[k])
        covariance, upper[k] = _truncated(solution, covariance, k, width / CI95_STDS)
        fit = _without(trial, sorted(upper))
        solution = fit.solution


def has_zero_bound(name: str) -> bool:
    """Whether zero is a bound of a parameter that an arm can have."""
    return name == MOTOR_INERTIA or physical_range(name) == "non-negative"


def _truncated(
    solution: FloatArray, covariance: FloatArray, k: int, scale: float
) -> tuple[FloatArray, float]:
    """Covariance about zero of a normal distribution without negative values of one parameter.

    Second, the 95 % quantile of that parameter. `scale` converts standard deviations into those of
    a normal distribution with the same interval.
    """
    std = scale * float(np.sqrt(covariance[k, k]))
    below = -float(solution[k]) / std
    beyond = _NORMAL.cdf(-below)
    # E[(x / std)^2] of x ~ N(-below, 1) std, x > 0
    moment = 1.0 + below**2 - below * _NORMAL.pdf(below) / beyond
    quantile = -_NORMAL.inv_cdf(0.05 * beyond) - below
    row = covariance[k]
    reduced = covariance - (1.0 - moment) / covariance[k, k] * np.outer(row, row)
    return np.asarray(reduced), std * quantile


def _without(trial: Trial, at_zero: list[int]) -> Trial:
    """The trial, fitted without the columns of parameters."""
    shared = trial.equations.shared.copy()
    shared[:, at_zero] = 0.0
    factor = ls.factorise(replace(trial.equations, shared=shared), trial.factor.root)
    return replace(
        trial,
        estimate=replace(trial.estimate, solution=factor.value),
        factor=replace(trial.factor, value=factor.value, common=factor.common, local=factor.local),
    )
