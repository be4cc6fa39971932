"""The table of parameters: one row each, the arm's own first, then joint by joint."""

from __future__ import annotations

from collections.abc import Sequence

from strainwave.formatting import plus_minus
from strainwave.records import Decision
from strainwave.report.html import number, row, table

_HEADS = (
    "parameter",
    "unit",
    "#value",
    "#± one sigma",
    "#95 % interval",
    "#95 % half-width, %",
    "source stage",
)


def parameter_table(decisions: Sequence[Decision]) -> str:
    """All parameters with their intervals.

    Parameters
    ----------
    decisions : sequence of Decision
        The final table.

    Returns
    -------
    str
        HTML.
    """
    rows = []
    last: int | None = -1
    for decision in decisions:
        p = decision.parameter
        if p.joint != last:
            title = f"joint {p.joint}" if p.joint else "arm"
            rows.append(
                f'<tr class="group"><th scope="rowgroup" colspan="{len(_HEADS)}">{title}</th></tr>'
            )
            last = p.joint
        rows.append(_row(decision))
    return table("Parameters", _HEADS, "".join(rows), heading=False)


def _row(decision: Decision) -> str:
    p = decision.parameter
    value, spread = plus_minus(p.value, p.std)
    if p.value is None:
        value = "rejected" if decision.rejected else "not identified"
        spread, interval, half = "", decision.rejected or "not identifiable from these data", ""
    elif p.ci95 is None:
        interval, half = "not known", ""
    else:
        low, high = p.ci95
        interval = f"{_like(value, low)} … {_like(value, high)}"
        half = _share(0.5 * (high - low), p.value)
    return row([p.name, p.unit, *map(number, (value, spread, interval, half)), p.stage])


def _share(half: float, value: float) -> str:
    """In percent of the value; beyond all of it the number says nothing more."""
    return f"{100.0 * half / abs(value):.2g}" if half < abs(value) else "over 100"


def _like(shown: str, number: float) -> str:
    """A number with the decimals, and the exponent, of another that is written already."""
    digits, _, exponent = shown.partition("e")
    decimals = len(digits.partition(".")[2])
    if not exponent:
        return f"{number:.{decimals}f}"
    return f"{number / 10.0 ** int(exponent):.{decimals}f}e{exponent}"
