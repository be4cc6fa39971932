"""Factors of intervals; the chi-square, Student's t and F distributions.

The import of SciPy takes longer than most stages, so only inverses for real degrees of freedom load
it. Integer degrees have closed forms, and tails for real degrees a continued fraction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

CI95_STDS = 1.96
"""Half-width of a 95 % interval in standard deviations of a normal variable."""

CI99_STDS = 2.5758
"""The same of a 99 % interval."""

STD_PER_MEDIAN = 1.4826
"""Standard deviation of a normal variable over the median of its absolute value."""

_ROUNDING = 1e-15  # relative change of a continued fraction by which it has converged


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
    _, high = _bisect(low, high, lambda value: chi_square_tail(value, degrees) > probability)
    return high


@lru_cache(maxsize=256)
def student_quantile(probability: float, degrees: int) -> float:
    """Quantile of Student's t distribution, by bisection.

    `probability` is at least 0.5 and below 1, `degrees` at least 1.
    """

    def is_low(angle: float) -> bool:
        return 0.5 + 0.5 * _student_probability(angle, degrees) < probability

    low, _ = _bisect(0.0, 0.5 * math.pi, is_low)
    return math.sqrt(degrees) * math.tan(low)


def _bisect(low: float, high: float, is_low: Callable[[float], bool]) -> tuple[float, float]:
    """Neighbouring numbers between which a condition ceases to hold."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_low(middle) else (low, middle)
    return low, high


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


def student_tail(value: float, degrees: float) -> float:
    """Probability that the magnitude of Student's t exceeds that of a value.

    `degrees` is positive; infinite: the distribution is normal.
    """
    if math.isinf(degrees):
        return math.erfc(abs(value) / math.sqrt(2.0))
    return _beta_probability(degrees, value * value, 0.5 * degrees, 0.5)


def student_degrees(quantile: float) -> float:
    """Degrees of freedom with this 97.5 % quantile of Student's t, which exceeds `CI95_STDS`."""
    from scipy.special import stdtridf

    return float(stdtridf(0.975, quantile))


def f_tail(value: float, numerator: float, denominator: float) -> float:
    """Probability that an F variable with these degrees of freedom exceeds a value."""
    rest = max(numerator * value, 0.0)
    return _beta_probability(denominator, rest, 0.5 * denominator, 0.5 * numerator)


def _beta_probability(part: float, rest: float, a: float, b: float) -> float:
    """Probability I_x(a, b) that a beta variable is below x = part / (part + rest).

    The continued fraction of Abramowitz and Stegun 26.5.8, by Lentz's method, at the end where it
    converges fast.
    """
    x, complement = part / (part + rest), rest / (part + rest)
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - _beta_probability(rest, part, b, a)
    if not x > 0.0:
        return x
    log_beta = math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
    factor = math.exp(a * math.log(x) + b * math.log(complement) - log_beta) / a
    numerator, m, change = 1.0, 0, math.inf
    denominator = 1.0 / (1.0 - (a + b) / (a + 1.0) * x)
    fraction = denominator
    while abs(change - 1.0) > _ROUNDING:
        m += 1
        even = m * (b - m) * x / ((a + 2 * m - 1.0) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1.0))
        for term in (even, odd):
            denominator = 1.0 / (1.0 + term * denominator)
            numerator = 1.0 + term / numerator
            change = numerator * denominator
            fraction *= change
    return factor * fraction


def f_quantile(probability: float, numerator: float, denominator: float) -> float:
    """Value that an F variable with these degrees of freedom does not exceed with a probability."""
    from scipy.special import fdtri

    return float(fdtri(numerator, denominator, probability))
