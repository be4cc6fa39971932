"""The table of parameters, arm first, then joint by joint; correlations of their errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from strainwave.domain import (
    ArmDescription,
    Clause,
    Decision,
    FloatArray,
    Identification,
    Parameter,
)
from strainwave.domain.arm.combinations import reported
from strainwave.domain.arm.parameter_table import base_name
from strainwave.domain.arm.parameters import parameter_descriptions
from strainwave.domain.messages import plus_minus, text_of
from strainwave.io.base_parameters import BaseParameter
from strainwave.report.document import blocks
from strainwave.report.document.blocks import Cell, Row, RowGroup, Table
from strainwave.report.figures import Colour, HeatMap

_HEADS: tuple[str | Cell, ...] = (
    "parameter",
    "symbol",
    *map(blocks.number, ("value", "standard deviation")),
    "unit",
    *map(blocks.number, ("95 % interval", "half-width [%]")),
    "stage",
)

SUMMARY_HEADS: Row = ("parameter", "joint", blocks.number("value"), blocks.number("± std"), "unit")
"""Heads of the short table in terminal and notebook."""


def summary_row(p: Parameter, *, is_rejected: bool = False) -> Row:
    """A parameter under `SUMMARY_HEADS`."""
    numbers = plus_minus(p.value, p.std)
    if p.value is None:
        numbers = "rejected" if is_rejected else "not identified", ""
    return (p.name, str(p.joint or "arm"), *map(blocks.number, numbers), p.unit)


def descriptions_table(decisions: Sequence[Decision]) -> Iterator[Table]:
    """Symbol and description of every parameter in the table, once."""
    names = dict.fromkeys(base_name(decision.parameter.name) for decision in decisions)
    words_of = parameter_descriptions()
    pairs = ((name, words_of[name]) for name in names if name in words_of)
    rows = [
        (
            Cell(name, "name", key=_key(name)),
            Cell(words.symbol, "symbol"),
            blocks.prose(words.description),
        )
        for name, words in pairs
    ]
    heads = ("parameter", "symbol", "description")
    return blocks.table("Descriptions of the parameters", heads, rows, heading=False)


def parameter_table(decisions: Sequence[Decision]) -> Iterator[Table]:
    """All parameters of the final table with their intervals."""
    rows: list[Row | RowGroup] = []
    group: int | None = -1
    for decision in decisions:
        p = decision.parameter
        if p.joint != group:
            rows.append(RowGroup(f"Joint {p.joint}" if p.joint else "Arm"))
            group = p.joint
        rows.append(_row(decision))
    return blocks.table("Parameters", _HEADS, rows, heading=False)


def base_parameter_table(parameters: Sequence[BaseParameter]) -> Iterator[Table]:
    """Base parameters of a serial arm with their combinations of standard parameters."""
    rows: list[Row] = [
        (
            one.name,
            blocks.prose(combination_text(one.combination)),
            *_numbers(one.estimate)[:2],
            _unit(one.estimate),
            *_numbers(one.estimate)[2:],
            one.estimate.stage,
        )
        for one in parameters
    ]
    heads = ("name", "combination", *_HEADS[2:])
    return blocks.table("Base parameters", heads, rows, heading=False)


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
        return [blocks.number(value), blocks.number(""), blocks.prose(reason), blocks.number("")]
    if p.ci95 is None:
        interval, half = "not known", ""
    else:
        low, high = p.ci95
        interval = f"{_like(value, low)} … {_like(value, high)}"
        share = 50.0 * (high - low) / abs(p.value) if p.value else np.inf
        half = "over 100" if share >= 100.0 else blocks.two_digits(share)
    return [blocks.number(text) for text in (value, std, interval, half)]


def _unit(p: Parameter) -> str:
    return p.unit.replace("^2", "²").replace("^3", "³").replace(" ", "\N{NO-BREAK SPACE}")


def _key(name: str) -> str:
    return f"parameter-{name}"


def _like(template: str, value: float) -> str:
    """A number with the decimals and the exponent of another."""
    digits, _, exponent = template.partition("e")
    decimals = len(digits.partition(".")[2])
    if not exponent:
        return f"{value:.{decimals}f}"
    return f"{value / 10.0 ** int(exponent):.{decimals}f}e{exponent}"


MIN_STRONG_CORRELATION = 0.95  # above it, only a combination of the two parameters is identified
_MAX_LISTED_PAIRS = 8


def correlations(identification: Identification) -> HeatMap | None:
    """Correlations of the parameters that have an interval, from -1 (blue) to +1 (vermilion).

    Of the whole-arm fit, else of the last stage before; None with fewer than two parameters.
    """
    whole_arm, joints, rigid = identification.whole_arm, identification.joints, identification.rigid
    arm = identification.study.arm
    if whole_arm is not None:
        return _of(arm, whole_arm.parameters, whole_arm.covariance)
    if len(joints) == 1:
        covariance = joints[0].covariance  # without the total viscous friction, the last parameter
        return _of(arm, joints[0].parameters[: len(covariance)], covariance)
    return _of(arm, rigid.parameters, rigid.covariance) if rigid is not None else None


def describe_correlations(errors: HeatMap) -> str:
    """Caption of the heat map: strongly correlated pairs, strongest first."""
    rows, columns = np.triu_indices(len(errors.names), 1)
    values = errors.values[rows, columns]
    order = [k for k in np.argsort(-np.abs(values)) if abs(values[k]) >= MIN_STRONG_CORRELATION]
    pairs = [
        f"{errors.names[rows[k]]} and {errors.names[columns[k]]} ({values[k]:+.3f})"
        for k in order[:_MAX_LISTED_PAIRS]
    ]
    if not pairs:
        return f"No two parameters have a correlation of {MIN_STRONG_CORRELATION:g} or more."
    return (
        f"Strong correlations: {'; '.join(pairs)}. The data identify a combination of such a pair"
        " better than either parameter."
    )


def _of(
    arm: ArmDescription, parameters: Sequence[Parameter], covariance: FloatArray
) -> HeatMap | None:
    """Without sums of other parameters, which are correlated with these by definition."""
    variance = np.diag(covariance)
    keys = {p.key for p in parameters}
    sums = {key for key, parts in reported(arm).items() if not keys.isdisjoint(parts)}
    rows = [
        k
        for k, p in enumerate(parameters)
        if p.value is not None
        and np.isfinite(variance[k])
        and variance[k] > 0.0
        and p.key not in sums
    ]
    if len(rows) < 2:
        return None
    std = np.sqrt(variance[rows])
    matrix = covariance[np.ix_(rows, rows)] / np.outer(std, std)
    labels = []
    for p in (parameters[k] for k in rows):
        labels.append(p.name.replace("_", " ") + (f" {p.joint}" if p.joint else ""))
    colours = (Colour.MEASURED, "#FFFFFF", Colour.MODEL)
    return HeatMap(tuple(labels), np.clip(matrix, -1.0, 1.0), -1.0, 1.0, colours)
