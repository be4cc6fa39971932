"""Factors of intervals; chi-square and Student's t distributions for integer degrees of freedom.

SciPy provides the distributions too, but its import takes longer than most stages.
"""

from __future__ import annotations

import math
from functools import lru_cache

CI95_STDS = 1.96
"""Half-width of a 95 % interval in standard deviations of a normal variable."""

CI99_STDS = 2.5758
"""The same of a 99 % interval."""

STD_PER_MEDIAN = 1.4826
"""Standard deviation of a normal variable over the median of its absolute value."""


def chi_square_tail(value: float, degrees: int) -> float:
    """Probability that a chi-square variable exceeds a value (Abramowitz and Stegun 26.4.4, 5).

    `degrees` is at least 1.
    """
    if not value > 0.0:
        return 1.0 if value <= 0.0 else math.nan
    half = 0.5 * value
    if not math.isfinite(half):
        return 0.0
    first = 0.5 * (degrees % 2)
    powers = (first + j for j in range(degrees // 2))
    terms = (math.exp(a * math.log(half) - half - math.lgamma(a + 1.0)) for a in powers)
    tail = math.erfc(math.sqrt(half)) if first else 0.0
    return min(1.0, tail + math.fsum(terms))


@lru_cache(maxsize=256)
def chi_square_limit(probability: float, degrees: int) -> float:
    """Value that a chi-square variable exceeds with the given probability, by bisection.

    `probability` is between 0 and 1, `degrees` at least 1.
    """
    low, high = 0.0, float(degrees)
    while chi_square_tail(high, degrees) > probability:
        low, high = high, 2.0 * high
    for _ in range(60):
        middle = 0.5 * (low + high)
        if chi_square_tail(middle, degrees) > probability:
            low = middle
        else:
            high = middle
    return high


def student_quantile(probability: float, degrees: int) -> float:
    """Quantile of Student's t distribution, by bisection.

    `probability` is at least 0.5 and below 1, `degrees` at least 1.
    """
    low, high = 0.0, 0.5 * math.pi
    for _ in range(60):
        middle = 0.5 * (low + high)
        if 0.5 + 0.5 * _student_probability(middle, degrees) < probability:
            low = middle
        else:
            high = middle
    return math.sqrt(degrees) * math.tan(low)


def _student_probability(angle: float, degrees: int) -> float:
    """Probability P(|t| < sqrt(degrees) tan angle) (Abramowitz and Stegun 26.7.3, 26.7.4)."""
    odd = degrees % 2
    cosine = math.cos(angle)
    term, total = (cosine if odd else 1.0), 0.0
    for j in range(odd, degrees - 1, 2):
        total += term
        term *= (j + 1.0) / (j + 2.0) * cosine**2
    if not odd:
        return math.sin(angle) * total
    return 2.0 / math.pi * (angle + math.sin(angle) * total)
