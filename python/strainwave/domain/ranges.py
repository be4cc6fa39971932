"""Physical ranges of parameters: which values an arm can have."""

from __future__ import annotations

from strainwave.domain.parameter_table import Range, base_name, parameter_table


def physical_range(name: str) -> Range:
    """The range of one parameter.

    Parameters
    ----------
    name : str
        As in docs/notation.md.

    Returns
    -------
    "positive", "non-negative" or "any"
    """
    known = parameter_table().get(base_name(name))
    return "any" if known is None else known.range


def is_physical(name: str, value: float) -> bool:
    """Whether an arm can have this value.

    Parameters
    ----------
    name : str
        As in docs/notation.md.
    value : float [SI]

    Returns
    -------
    bool
        False for what is not finite, too.
    """
    if not abs(value) < float("inf"):
        return False
    least = physical_range(name)
    return least == "any" or value > 0.0 or (value == 0.0 and least == "non-negative")
