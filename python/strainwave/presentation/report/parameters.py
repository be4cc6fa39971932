"""The table of parameters: first those of the arm, then joint by joint."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from strainwave.domain import Clause, Decision, Parameter
from strainwave.domain.formatting import plus_minus
from strainwave.domain.messages import text_of
from strainwave.domain.parameter_table import base_name
from strainwave.domain.parameters import parameter_descriptions
from strainwave.io.base_parameters import BaseParameter
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


def base_parameter_table(parameters: Sequence[BaseParameter]) -> Iterator[Table]:
    """Base parameters of a serial arm with their combinations of standard parameters."""
    rows: list[Row] = [
        (
            one.name,
            prose(combination_text(one.combination)),
            *_numbers(one.estimate)[:2],
            _unit(one.estimate),
            *_numbers(one.estimate)[2:],
            one.estimate.stage,
        )
        for one in parameters
    ]
    heads = ("name", "combination", *_HEADS[2:])
    return table("Base parameters", heads, rows, heading=False)


def combination_text(combination: Mapping[str, float]) -> str:
    """Sum of weighted standard parameters: Izz2 + 0.16 m3 - 0.4 mz3."""
    text = ""
    for name, weight in combination.items():
        size = "" if abs(weight) == 1.0 else f"{abs(weight):.5g} "
        sign = " - " if weight < 0.0 else " + "
        text += f"{sign}{size}{name}" if text else f"{sign.strip(' +')}{size}{name}"
    return text


def _row(decision: Decision) -> Row:
    p = decision.parameter
    numbers = _numbers(p, decision.rejected)
    words = parameter_descriptions().get(base_name(p.name))
    link = f"#{_key(base_name(p.name))}" if words else ""
    return (
        Cell(p.name, href=link, tip=words.description if words else ""),
        Cell(words.symbol if words else "", "symbol"),
        *numbers[:2],
        _unit(p),
        *numbers[2:],
        p.stage,
    )


def _numbers(p: Parameter, rejected: Clause | None = None) -> list[Cell]:
    """Value, standard deviation, 95 % interval, and its half-width in percent."""
    value, std = plus_minus(p.value, p.std)
    if p.value is None:
        value = "rejected" if rejected else "not identified"
        reason = text_of(rejected) if rejected else "not identifiable from these data"
        return [number(value), number(""), prose(reason), number("")]
    if p.ci95 is None:
        interval, half = "not known", ""
    else:
        low, high = p.ci95
        interval = f"{_like(value, low)} … {_like(value, high)}"
        half = _relative(0.5 * (high - low), p.value)
    return [number(text) for text in (value, std, interval, half)]


def _unit(p: Parameter) -> str:
    return p.unit.replace("^2", "²").replace("^3", "³").replace(" ", "\N{NO-BREAK SPACE}")


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
