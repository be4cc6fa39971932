"""Whether several differences at once are more than chance, and p-values of many tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray

_SINGULAR = 1e-8  # of the largest eigenvalue of correlations: below, values follow from others


@dataclass(frozen=True, slots=True)
class JointTest:
    """d' S^+ d of differences d with covariance S."""

    statistic: float
    rank: int  # of S: independent differences; the others follow from these
    n_values: int
    degrees: float  # behind S; infinite: the statistic is a chi-square
    p: float
    adjusted_p: float = 1.0  # among all tests of the comparison, by Holm


def joint_test(
    difference: FloatArray, parts: Sequence[FloatArray], degrees: Sequence[float]
) -> JointTest | None:
    """Test that all differences are zero.

    T = d' S^+ d with S = sum of the parts, by the eigenvalues of its correlations. Where every part
    is known exactly, T is a chi-square of rank(S) = r degrees. A part that is known with nu_i
    degrees makes T (nu - r + 1) / (nu r) an F of r and nu - r + 1 degrees with
    nu = (r + r^2) / sum_i (tr G_i^2 + (tr G_i)^2) / nu_i, G_i the part where S is the identity
    (Krishnamoorthy and Yu, 2004).

    Parameters
    ----------
    difference : (n,)
    parts : sequence of (n, n)
        Covariances of independent errors whose sum is the difference's.
    degrees : sequence of float
        Behind each part; infinite where it is known.

    Returns
    -------
    JointTest or None
        None where too few degrees are behind the covariance for so many differences.
    """
    from scipy.stats import chi2, f

    S = np.sum(parts, axis=0)
    scale = np.sqrt(np.diag(S))
    if not len(difference) or not (scale > 0.0).all():
        return None
    values, vectors = np.linalg.eigh(S / np.outer(scale, scale))
    kept = values > _SINGULAR * values[-1]
    whiten = vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None]
    r = int(kept.sum())
    statistic = float(np.sum((whiten.T @ difference) ** 2))
    spread = 0.0
    for part, own in zip(parts, degrees, strict=True):
        G = whiten.T @ part @ whiten
        spread += float(np.sum(G * G) + np.trace(G) ** 2) / own
    nu = (r + r * r) / spread if spread > 0.0 else float("inf")
    if not np.isfinite(nu):
        return JointTest(statistic, r, len(difference), nu, float(chi2.sf(statistic, r)))
    if nu <= r:
        return None
    p = float(f.sf(statistic * (nu - r + 1.0) / (nu * r), r, nu - r + 1.0))
    return JointTest(statistic, r, len(difference), nu, p)


def welch_test(
    difference: float, deviations: Sequence[float], degrees: Sequence[float]
) -> tuple[float, float]:
    """Test that one difference is zero, by Student's t with Welch and Satterthwaite's degrees.

    Parameters
    ----------
    difference : float
    deviations : sequence of float
        Of its independent errors.
    degrees : sequence of float
        Behind each deviation; infinite where it is known: then the test is a normal variable's.

    Returns
    -------
    z, p : float
        The difference over its standard deviation, and the two-sided p-value.
    """
    from scipy.special import ndtr, stdtr

    variances = [s * s for s in deviations]
    total = sum(variances)
    z = difference / np.sqrt(total)
    spread = sum(v * v / nu for v, nu in zip(variances, degrees, strict=True))
    if spread == 0.0:
        return float(z), float(2.0 * ndtr(-abs(z)))
    return float(z), float(2.0 * stdtr(total * total / spread, -abs(z)))


def holm(p: Sequence[float]) -> list[float]:
    """p-values adjusted for their number (Holm, 1979), whatever their dependence.

    The smallest of m is multiplied by m, the next by m - 1, ..., and none is below one before it.

    Parameters
    ----------
    p : sequence of float

    Returns
    -------
    list of float
        In the same order.
    """
    order = np.argsort(p, kind="stable")
    factors = np.arange(len(p), 0, -1)
    raised = np.minimum(1.0, np.maximum.accumulate(factors * np.asarray(p, dtype=float)[order]))
    found = np.empty(len(p))
    found[order] = raised
    return [float(each) for each in found]
