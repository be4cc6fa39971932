"""Format numbers and lists for messages."""

from __future__ import annotations

from collections.abc import Sequence


def format_number(value: float, digits: int = 4) -> str:
    """Format a number with at most `digits` significant digits."""
    return f"{value:.{digits}g}"


def join_names(names: Sequence[str]) -> str:
    """Join names into an English list: "a", "a and b", "a, b and c"."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
