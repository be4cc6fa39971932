"""Number formats for text."""

from __future__ import annotations

import math

UNKNOWN = "not known"


def plus_minus(value: float | None, std: float | None) -> tuple[str, str]:
    """Text of a value and its standard deviation, to the second digit of the standard deviation.

    None and non-finite numbers give `UNKNOWN`. Large and small numbers share one exponent, as in
    ("1.502e-04", "0.012e-04").
    """
    if value is None or not math.isfinite(value):
        return UNKNOWN, UNKNOWN
    if std is None or not math.isfinite(std) or std <= 0.0:
        return f"{value:.4g}", UNKNOWN if std is None or not math.isfinite(std) else "0"
    last = math.floor(math.log10(std)) - 1  # decimal place of std's second digit
    top = max(math.floor(math.log10(max(abs(value), std))), last)
    exponent = top if top < -3 or last > 3 else 0
    digits = max(0, exponent - last)
    suffix = f"e{exponent:+03d}" if exponent else ""
    scale = 10.0**exponent
    return f"{value / scale:.{digits}f}{suffix}", f"{std / scale:.{digits}f}{suffix}"


def percent(fit: float) -> str:
    """A fit [%] with one decimal; `UNKNOWN` if it is not finite."""
    return f"{fit:.1f} %" if math.isfinite(fit) else UNKNOWN
