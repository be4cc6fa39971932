"""Tests of several differences at once, adjusted p-values, and a factor of all torques.

The scale of the torques is not in the data: inertias, friction, gravity and stiffness that change
by one factor point to `torque_per_volt`, or to the scale of the torque channels.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.messages import plus_minus
from strainwave.domain.results.distributions import chi_square_tail, f_tail, student_tail

_RANK_TOLERANCE = 1e-8  # of the largest eigenvalue of the correlation matrix; below: dependent


@dataclass(frozen=True, slots=True)
class JointTest:
    """Test statistic d' S^+ d of differences d with covariance S."""

    statistic: float
    rank: int  # of S: number of independent differences
    n_values: int
    degrees: float  # degrees of freedom of S; infinite: the statistic is chi-square distributed
    p: float
    adjusted_p: float = 1.0  # by Holm, over all tests of the comparison


def joint_test(
    difference: FloatArray, parts: Sequence[FloatArray], degrees: Sequence[float]
) -> JointTest | None:
    """Test that all differences, (n,), are zero.

    T = d' S^+ d with S the sum of the parts, (n, n) covariances of independent errors; the rank r
    of S is that of its correlation matrix. If all parts are known exactly, T is a chi-square of r
    degrees. If part i is known with nu_i degrees of freedom, T (nu - r + 1)/(nu r) is an F of r and
    nu - r + 1 degrees with nu = (r + r^2) / sum_i (tr G_i^2 + (tr G_i)^2)/nu_i, G_i the part in
    coordinates where S is the identity (Krishnamoorthy and Yu, 2004). None if nu <= r.
    """
    S = np.sum(parts, axis=0)
    scale = np.sqrt(np.diag(S))
    if not len(difference) or not (scale > 0.0).all():
        return None
    values, vectors = np.linalg.eigh(S / np.outer(scale, scale))
    independent = values > _RANK_TOLERANCE * values[-1]
    whiten = vectors[:, independent] / np.sqrt(values[independent]) / scale[:, None]
    r = int(independent.sum())
    statistic = float(np.sum((whiten.T @ difference) ** 2))
    spread = 0.0
    for part, nu_i in zip(parts, degrees, strict=True):
        G = whiten.T @ part @ whiten
        spread += float(np.sum(G * G) + np.trace(G) ** 2) / nu_i
    nu = (r + r * r) / spread if spread > 0.0 else float("inf")
    if not np.isfinite(nu):
        return JointTest(statistic, r, len(difference), nu, chi_square_tail(statistic, r))
    if nu <= r:
        return None
    p = f_tail(statistic * (nu - r + 1.0) / (nu * r), r, nu - r + 1.0)
    return JointTest(statistic, r, len(difference), nu, p)


def welch_test(
    difference: float, stds: Sequence[float], degrees: Sequence[float]
) -> tuple[float, float]:
    """z, the difference over its standard deviation, and the two-sided p-value of no difference.

    `stds` are those of its independent errors. Student's t with the degrees of freedom of Welch and
    Satterthwaite; a normal distribution if all degrees are infinite.
    """
    variances = [s * s for s in stds]
    total = sum(variances)
    z = float(difference / np.sqrt(total))
    spread = sum(v * v / nu for v, nu in zip(variances, degrees, strict=True))
    return z, student_tail(z, total * total / spread if spread > 0.0 else math.inf)


def adjust_p_values(p: Sequence[float]) -> list[float]:
    """p-values adjusted for their number, valid under any dependence (Holm, 1979).

    The smallest of m is multiplied by m, the next by m - 1, and so on; the result does not decrease
    in the order of p.
    """
    order = np.argsort(p, kind="stable")
    factors = np.arange(len(p), 0, -1)
    scaled = np.minimum(1.0, np.maximum.accumulate(factors * np.asarray(p, dtype=float)[order]))
    adjusted = np.empty(len(p))
    adjusted[order] = scaled
    return [float(value) for value in adjusted]


_MIN_PRINTED_P = 1e-16  # rounding of the test statistics limits smaller values


def format_p(p: float) -> str:
    """A p-value with two significant digits, one below 1e-4."""
    if p < _MIN_PRINTED_P:
        return f"<{_MIN_PRINTED_P:.0e}"
    return f"{p:.2g}" if p >= 1e-4 else f"{p:.0e}"


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
