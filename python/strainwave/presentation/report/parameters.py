"""The table of parameters: first those of the arm, then joint by joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from strainwave.domain import Decision
from strainwave.domain.formatting import plus_minus
from strainwave.domain.messages import text_of
from strainwave.domain.parameter_table import base_name
from strainwave.domain.parameter_words import parameter_descriptions
from strainwave.presentation.report.blocks import (
    Cell,
    Group,
    Row,
    Table,
    number,
    prose,
    table,
    two_digits,
)

_HEADS: tuple[str | Cell, ...] = (
    "parameter",
    "symbol",
    *map(number, ("value", "standard deviation")),
    "unit",
    *map(number, ("95 % interval", "half-width [%]")),
    "stage",
)


def descriptions_table(decisions: Sequence[Decision]) -> Iterator[Table]:
    """Symbol and description of every parameter in the table, once."""
    names = dict.fromkeys(base_name(decision.parameter.name) for decision in decisions)
    words_of = parameter_descriptions()
    pairs = ((name, words_of[name]) for name in names if name in words_of)
    rows = [
        (Cell(name, "name", key=_key(name)), Cell(words.symbol, "symbol"), prose(words.description))
        for name, words in pairs
    ]
    heads = ("parameter", "symbol", "description")
    return table("Descriptions of the parameters", heads, rows, heading=False)


def parameter_table(decisions: Sequence[Decision]) -> Iterator[Table]:
    """All parameters of the final table with their intervals."""
    rows: list[Row | Group] = []
    group: int | None = -1
    for decision in decisions:
        p = decision.parameter
        if p.joint != group:
            rows.append(Group(f"Joint {p.joint}" if p.joint else "Arm"))
            group = p.joint
        rows.append(_row(decision))
    return table("Parameters", _HEADS, rows, heading=False)


def _row(decision: Decision) -> Row:
    p = decision.parameter
    value, std = plus_minus(p.value, p.std)
    if p.value is None:
        value = "rejected" if decision.rejected else "not identified"
        reason = decision.rejected
        interval = text_of(reason) if reason else "not identifiable from these data"
        std = half = ""
    elif p.ci95 is None:
        interval, half = "not known", ""
    else:
        low, high = p.ci95
        interval = f"{_like(value, low)} … {_like(value, high)}"
        half = _relative(0.5 * (high - low), p.value)
    words = parameter_descriptions().get(base_name(p.name))
    link = f"#{_key(base_name(p.name))}" if words else ""
    return (
        Cell(p.name, href=link, tip=words.description if words else ""),
        Cell(words.symbol if words else "", "symbol"),
        *map(number, (value, std)),
        p.unit.replace("^2", "²").replace("^3", "³").replace(" ", "\N{NO-BREAK SPACE}"),
        *map(number, (interval, half)),
        p.stage,
    )


def _key(name: str) -> str:
    """The id of a parameter's row in the table of descriptions."""
    return f"parameter-{name}"


def _relative(half: float, value: float) -> str:
    """Half-width in percent of the value, to two digits; "over 100" above."""
    if half >= abs(value):
        return "over 100"
    return two_digits(100.0 * half / abs(value))


def _like(template: str, value: float) -> str:
    """A number with the decimals and the exponent of another."""
    digits, _, exponent = template.partition("e")
    decimals = len(digits.partition(".")[2])
    if not exponent:
        return f"{value:.{decimals}f}"
    return f"{value / 10.0 ** int(exponent):.{decimals}f}e{exponent}"
