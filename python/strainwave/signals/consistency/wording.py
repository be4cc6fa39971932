"""Numbers and lists in messages."""

from __future__ import annotations

from collections.abc import Sequence


def number(value: float, digits: int = 4) -> str:
    """A number with at most so many significant digits."""
    return f"{value:.{digits}g}"


def listed(names: Sequence[str]) -> str:
    """Names as a sentence lists them: "a", "a and b", "a, b and c"."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
