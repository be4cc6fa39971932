"""A trend for programs and people: trend.json, trend.html, the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.text import Text

from strainwave.domain.formatting import plus_minus
from strainwave.monitoring import output
from strainwave.monitoring.output import REACH, probability
from strainwave.monitoring.shapes import fitted_line
from strainwave.monitoring.trend import ArmTrend, ParameterTrend, Trend
from strainwave.presentation.figures import (
    MEASURED,
    MODEL,
    RESIDUAL,
    SOLID,
    Axis,
    Figure,
    Line,
    Markers,
    Panel,
)
from strainwave.presentation.report.blocks import (
    Block,
    Cell,
    Fold,
    Mark,
    Plot,
    Row,
    Section,
    number,
    paragraph,
    prose,
    slug,
    table,
)
from strainwave.presentation.report.document import document as page_of

SCHEMA = "strainwave/trend/1"

_MONTH = 30.0  # [days]
_TOGETHER = 6  # panels of a figure


def write(found: Trend, folder: Path) -> None:
    """Write trend.json and trend.html.

    Parameters
    ----------
    found : Trend
    folder : Path

    Raises
    ------
    InvalidInput
        The folder cannot be written to.
    """
    output.write("trend", to_document(found), render(found), folder)


def to_document(found: Trend) -> dict[str, Any]:
    """The trend as plain JSON values, in the layout of docs/trend.md.

    Parameters
    ----------
    found : Trend

    Returns
    -------
    dict
    """
    return {
        "schema": SCHEMA,
        "level": found.level,
        "concern": found.concern,
        "covariates": list(found.covariates),
        "arms": [
            {
                "arm": arm.history.arm,
                "concern": bool(found.concerns(arm)),
                "p": arm.p,
                "visits": len(arm.history.visits),
                "first": arm.history.visits[0].time.isoformat(),
                "last": arm.history.visits[-1].time.isoformat(),
                "parameters": [_parameter(found, one) for one in arm.parameters],
                "too_few": [{"parameter": name, "visits": n} for name, n in arm.too_few],
            }
            for arm in found.arms
        ],
        "notes": list(found.notes),
    }


def _parameter(found: Trend, one: ParameterTrend) -> dict[str, Any]:
    history, change = one.history, one.change
    return {
        "name": history.name,
        "joint": history.joint,
        "unit": history.unit,
        "stage": history.stage,
        "concern": one.adjusted_p < found.level,
        "p": change.p,
        "adjusted_p": one.adjusted_p,
        "change": {
            "kind": change.shape.kind,
            "at": None
            if change.shape.kind == "drift"
            else history.visits[change.shape.first].time.isoformat(),
            "size": change.size,
            "std": change.size_std,
            "percent": one.percent,
        },
        "drift": {"per_day": change.drift, "std": change.drift_std, "p": change.drift_p},
        "level": change.level,
        "repeatability": change.repeatability,
        "degrees_of_freedom": change.degrees,
        "visits": [
            {
                "run": visit.run,
                "study": visit.study,
                "time": visit.time.isoformat(),
                "value": float(value),
                "std": float(std),
                "fitted": float(fitted),
            }
            for visit, value, std, fitted in zip(
                history.visits, history.series.value, history.series.std, change.fitted, strict=True
            )
        ],
    }


def headline(found: Trend) -> str:
    """The verdict in one sentence.

    Parameters
    ----------
    found : Trend

    Returns
    -------
    str
    """
    named = [arm.history.arm for arm in found.arms if found.concerns(arm)]
    of = f"of {_counted(len(found.arms), 'arm')}"
    level = f"at the level of {100.0 * found.level:g} % per arm"
    if not named:
        return f"none {of} changes clearly {level}"
    changes = "changes" if len(named) == 1 else "change"
    return f"{len(named)} {of} {changes} {level}: {', '.join(named)}"


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def print_trend(
    found: Trend, folder: Path | None = None, *, console: Console | None = None
) -> None:
    """Print each arm's clearest change, the worst first, and the verdict.

    Parameters
    ----------
    found : Trend
    folder : Path, optional
        Where the files were written.
    console : rich Console, optional
        The terminal, if not standard output.
    """
    console = console or Console(highlight=False)
    printed = output.printed_table()
    printed.add_column("arm", no_wrap=True)
    printed.add_column("visits", justify="right")
    printed.add_column("parameter", no_wrap=True)
    printed.add_column("clearest change", no_wrap=True)
    printed.add_column("%", justify="right")
    printed.add_column("adj. p", justify="right")
    for arm in found.arms:
        for k, one in enumerate(found.concerns(arm) or arm.parameters[:1]):
            first = (arm.history.arm, str(len(arm.history.visits))) if k == 0 else ("", "")
            label = "" if one.is_likely_chance else one.history.label
            cells = (*first, label, one.words, _percent(one), _p(one))
            style = "red" if one.adjusted_p < found.level else ""
            printed.add_row(*map(Text, cells), style=style)
        if not arm.parameters:
            printed.add_row(Text(arm.history.arm), str(len(arm.history.visits)), "too few visits")
    console.print(printed)
    output.print_end(console, "trend", headline(found), found.notes, folder, bad=found.concern)


def _percent(one: ParameterTrend) -> str:
    shown = one.percent is not None and not one.is_likely_chance
    return f"{one.percent:+.2f}" if shown else ""


def _p(one: ParameterTrend) -> str:
    return probability(one.adjusted_p)


def render(found: Trend) -> str:
    """The trend as one HTML page that needs no network.

    Parameters
    ----------
    found : Trend

    Returns
    -------
    str
    """
    worst = [arm for arm in found.arms if found.concerns(arm)]
    calm = [arm for arm in found.arms if not found.concerns(arm)]
    folds = tuple(
        Fold(f"{arm.history.arm}: {len(arm.history.visits)} visits", tuple(_arm(found, arm)))
        for arm in calm
    )
    sections = [
        Section("fleet", "Fleet", tuple(_fleet(found))),
        *(Section(_key(arm), arm.history.arm, tuple(_arm(found, arm))) for arm in worst),
        Section("others", "Arms without a clear change", folds),
        Section("reading", "How to read this", tuple(_reading(found))),
    ]
    visits = sum(len(arm.history.visits) for arm in found.arms)
    subtitle = f"{_counted(len(found.arms), 'arm')}, {_counted(visits, 'visit')}"
    before = output.opening(headline(found), (), found.notes, bad=found.concern)
    return page_of("Parameters over time", subtitle, sections, before=(before,))


def _key(arm: ArmTrend) -> str:
    return f"arm-{slug(arm.history.arm)}"


def _fleet(found: Trend) -> Iterator[Block]:
    heads: Row = (
        "arm",
        "clearest change",
        number("of the level [%]"),
        number("adjusted p"),
        number("parameters that change"),
        number("visits"),
        "first",
        "last",
    )
    rows = [_fleet_row(found, arm) for arm in found.arms]
    yield from table("Arms, the most concerning first", heads, rows, heading=False)


def _fleet_row(found: Trend, arm: ArmTrend) -> Row:
    concerns = found.concerns(arm)
    visits = arm.history.visits
    name = Cell(arm.history.arm, href=f"#{_key(arm)}" if concerns else "#others")
    dates = tuple(f"{visit.time:%Y-%m-%d}" for visit in (visits[0], visits[-1]))
    if not arm.parameters:
        return (name, prose("too few visits"), *[number("")] * 3, number(str(len(visits))), *dates)
    one = arm.parameters[0]
    mark: Mark = "bad" if concerns else ""
    chance = one.is_likely_chance
    return (
        name,
        Cell("none" if chance else f"{one.history.label}: {one.words}", "text", mark=mark),
        number(_percent(one)),
        number(_p(one)),
        number(str(len(concerns))),
        number(str(len(visits))),
        *dates,
    )


def _arm(found: Trend, arm: ArmTrend) -> Iterator[Block]:
    """Plots of what changes, a table of all, and plots of the rest."""
    concerns = found.concerns(arm)
    others = arm.parameters[len(concerns) :]
    name = arm.history.arm
    yield from _plots(found, arm, concerns, f"{name} changes", f"{name}: what changes")
    heads: Row = (
        "parameter",
        "clearest change",
        number("of the level [%]"),
        number("adjusted p"),
        number("level"),
        "unit",
        number("between visits [%]"),
        number("drift [% in 30 days]"),
        number("p of the drift"),
    )
    rows = [_row(found, one) for one in arm.parameters]
    yield from table(f"{name}: all parameters", heads, rows, heading=False)
    if others:
        plots = tuple(_plots(found, arm, others, f"{name} others", f"{name}: no clear change"))
        if concerns:
            yield Fold(f"Parameters without a clear change ({len(others)})", plots)
        else:
            yield from plots
    if arm.too_few:
        listed = ", ".join(f"{label} ({n})" for label, n in arm.too_few)
        yield paragraph(f"Too few visits: {listed}.")


def _row(found: Trend, one: ParameterTrend) -> Row:
    change = one.change
    drift = tuple(one.of_level(_MONTH * each) for each in (change.drift, change.drift_std))
    between = one.of_level(change.repeatability)
    return (
        Cell(one.history.label, "name"),
        Cell(one.words, mark="bad" if one.adjusted_p < found.level else ""),
        number(_percent(one)),
        number(_p(one)),
        number(plus_minus(change.level, float(np.median(one.history.series.std)))[0]),
        one.history.unit,
        number("" if between is None else f"{between:.2g}"),
        number("" if drift[0] is None else " ± ".join(plus_minus(*drift))),
        number(probability(change.drift_p)),
    )


def _plots(
    found: Trend, arm: ArmTrend, chosen: Sequence[ParameterTrend], name: str, label: str
) -> Iterator[Plot]:
    start = f"{arm.history.start:%Y-%m-%d}"
    words = (
        "Estimates with 95 % intervals of their runs; line: the clearest change, if any is clear."
    )
    for k in range(0, len(chosen), _TOGETHER):
        title = label if k == 0 else f"{label}, continued"
        panels = tuple(_panel(found, one) for one in chosen[k : k + _TOGETHER])
        drawn = Figure(Axis(f"days since {start}"), panels)
        yield Plot(f"{name} {1 + k // _TOGETHER}", title, drawn, words)


def _panel(found: Trend, one: ParameterTrend) -> Panel:
    series, concern = one.history.series, one.adjusted_p < found.level
    time, value = np.array(list(fitted_line(one.change, series))).T
    colour = MODEL if concern else RESIDUAL
    points = Markers(series.time, series.value, "estimate", MEASURED, 5.0, error=REACH * series.std)
    line = Line(time, value, "clearest change", colour, SOLID, 2.0, legend=False)
    axis = Axis(f"{one.history.label} [{one.history.unit}]")
    return Panel(axis, (points,) if one.is_likely_chance else (line, points))


def _reading(found: Trend) -> Iterator[Block]:
    regressed = ", ".join(found.covariates) or "nothing"
    yield paragraph(
        "Each parameter's estimates are weighed by their own standard deviations and the scatter "
        "between visits, which is estimated with them. Of a drift over all visits, a step before "
        "any of them and a drift that begins at any of them, the clearest is given, and the "
        "probability that any would be as clear by chance, adjusted for the number of the arm's "
        f"parameters. Regressed out: {regressed}."
    )
    yield paragraph(
        f"Of arms that do not change, {100.0 * found.level:g} % at most are named at each look."
    )
