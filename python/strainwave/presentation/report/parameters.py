"""The table of parameters: one row each, the arm's own first, then joint by joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from strainwave.domain import Decision
from strainwave.domain.formatting import plus_minus
from strainwave.domain.parameter_table import base_name
from strainwave.domain.parameter_words import ParameterWords, all_words
from strainwave.presentation.report.blocks import Cell, Group, Row, Table, number, prose, table

_HEADS: tuple[str | Cell, ...] = (
    "parameter",
    "symbol",
    *map(number, ("value", "± one sigma")),
    "unit",
    *map(number, ("95 % interval", "95 % half-width [%]")),
    "source stage",
)
_NO_WORDS = ParameterWords("", "")


def meanings_table(decisions: Sequence[Decision]) -> Iterator[Table]:
    """Symbol and description of every parameter in the table, once.

    Parameters
    ----------
    decisions : sequence of Decision

    Returns
    -------
    iterator of Table
    """
    names = dict.fromkeys(base_name(decision.parameter.name) for decision in decisions)
    words_of = all_words()
    known = ((name, words_of[name]) for name in names if name in words_of)
    rows = [
        (Cell(name, "name", key=_key(name)), Cell(words.symbol, "symbol"), prose(words.description))
        for name, words in known
    ]
    return table("What the parameters are", ("parameter", "symbol", "description"), rows)


def parameter_table(decisions: Sequence[Decision]) -> Iterator[Table]:
    """All parameters with their intervals.

    Parameters
    ----------
    decisions : sequence of Decision
        The final table.

    Returns
    -------
    iterator of Table
    """
    rows: list[Row | Group] = []
    last: int | None = -1
    for decision in decisions:
        p = decision.parameter
        if p.joint != last:
            rows.append(Group(f"joint {p.joint}" if p.joint else "arm"))
            last = p.joint
        rows.append(_row(decision))
    return table("Parameters", _HEADS, rows, heading=False)


def _row(decision: Decision) -> Row:
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
    words = all_words().get(base_name(p.name), _NO_WORDS)
    link = f"#{_key(base_name(p.name))}" if words.description else ""
    return (
        Cell(p.name, href=link, tip=words.description),
        Cell(words.symbol, "symbol"),
        *map(number, (value, spread)),
        p.unit.replace("^2", "²").replace("^3", "³").replace(" ", "\N{NO-BREAK SPACE}"),
        *map(number, (interval, half)),
        p.stage,
    )


def _key(name: str) -> str:
    """The id of a parameter's row in the table of descriptions."""
    return f"parameter-{name}"


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
