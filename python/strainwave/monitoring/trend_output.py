"""Output of a trend: trend.json, trend.html, the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.text import Text

from strainwave.domain.estimates import CI95_STDS
from strainwave.domain.formatting import plus_minus
from strainwave.monitoring import output
from strainwave.monitoring.output import probability
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

_MONTH_DAYS = 30.0
_MAX_PANELS = 6  # of a figure, which then fits a screen


def write(trend: Trend, folder: Path) -> None:
    """Write trend.json and trend.html into a folder."""
    output.write("trend", to_document(trend), render(trend), folder)


def to_document(trend: Trend) -> dict[str, Any]:
    """The trend as plain JSON values, in the layout of docs/trend.md."""
    return {
        "schema": SCHEMA,
        "level": trend.level,
        "concern": trend.concern,
        "covariates": list(trend.covariates),
        "arms": [
            {
                "arm": arm.history.arm,
                "concern": bool(trend.concerns(arm)),
                "p": arm.p,
                "visits": len(arm.history.visits),
                "first": arm.history.visits[0].time.isoformat(),
                "last": arm.history.visits[-1].time.isoformat(),
                "parameters": [_parameter(trend, one) for one in arm.parameters],
                "too_few": [{"parameter": name, "visits": n} for name, n in arm.too_few],
            }
            for arm in trend.arms
        ],
        "notes": list(trend.notes),
    }


def _parameter(trend: Trend, one: ParameterTrend) -> dict[str, Any]:
    history, change = one.history, one.change
    return {
        "name": history.name,
        "joint": history.joint,
        "unit": history.unit,
        "stage": history.stage,
        "concern": one.adjusted_p < trend.level,
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


def headline(trend: Trend) -> str:
    """The verdict in one sentence."""
    named = [arm.history.arm for arm in trend.arms if trend.concerns(arm)]
    of = f"of {_counted(len(trend.arms), 'arm')}"
    level = f"at the level of {100.0 * trend.level:g} % per arm"
    if not named:
        return f"no arm {of} changes {level}"
    changes = "changes" if len(named) == 1 else "change"
    return f"{len(named)} {of} {changes} {level}: {', '.join(named)}"


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def print_trend(
    trend: Trend, folder: Path | None = None, *, console: Console | None = None
) -> None:
    """Print the most significant change of each arm, the verdict, and the files in `folder`."""
    console = console or Console(highlight=False)
    printed = output.printed_table()
    printed.add_column("arm")
    printed.add_column("visits", justify="right")
    printed.add_column("parameter")
    printed.add_column("change")
    printed.add_column("%", justify="right")
    printed.add_column("adj. p", justify="right")
    for arm in trend.arms:
        for k, one in enumerate(trend.concerns(arm) or arm.parameters[:1]):
            first = (arm.history.arm, str(len(arm.history.visits))) if k == 0 else ("", "")
            label = "" if one.is_likely_chance else one.history.label
            cells = (*first, label, one.words, _percent(one), _p(one))
            style = "red" if one.adjusted_p < trend.level else ""
            printed.add_row(*map(Text, cells), style=style)
        if not arm.parameters:
            printed.add_row(Text(arm.history.arm), str(len(arm.history.visits)), "too few visits")
    output.print_table(console, printed)
    output.print_end(console, "trend", headline(trend), trend.notes, folder, bad=trend.concern)


def _percent(one: ParameterTrend) -> str:
    shown = one.percent is not None and not one.is_likely_chance
    return f"{one.percent:+.2f}" if shown else ""


def _p(one: ParameterTrend) -> str:
    return probability(one.adjusted_p)


def render(trend: Trend) -> str:
    """The trend as one self-contained HTML page."""
    worst = [arm for arm in trend.arms if trend.concerns(arm)]
    unchanged = [arm for arm in trend.arms if not trend.concerns(arm)]
    folds = tuple(
        Fold(f"{arm.history.arm}: {len(arm.history.visits)} visits", tuple(_arm(trend, arm)))
        for arm in unchanged
    )
    sections = [
        Section("fleet", "Fleet", tuple(_fleet(trend))),
        *(Section(_key(arm), arm.history.arm, tuple(_arm(trend, arm))) for arm in worst),
        Section("others", "Arms without a significant change", folds),
        Section("reading", "Method", tuple(_reading(trend))),
    ]
    visits = sum(len(arm.history.visits) for arm in trend.arms)
    subtitle = f"{_counted(len(trend.arms), 'arm')}, {_counted(visits, 'visit')}"
    before = output.opening(headline(trend), (), trend.notes, bad=trend.concern)
    return page_of("Parameters over time", subtitle, sections, before=(before,))


def _key(arm: ArmTrend) -> str:
    return f"arm-{slug(arm.history.arm)}"


def _fleet(trend: Trend) -> Iterator[Block]:
    heads: Row = (
        "arm",
        "change",
        number("of the level [%]"),
        number("adjusted p"),
        number("changed parameters"),
        number("visits"),
        "first",
        "last",
    )
    rows = [_fleet_row(trend, arm) for arm in trend.arms]
    yield from table("Arms, most significant change first", heads, rows, heading=False)


def _fleet_row(trend: Trend, arm: ArmTrend) -> Row:
    concerns = trend.concerns(arm)
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


def _arm(trend: Trend, arm: ArmTrend) -> Iterator[Block]:
    """Plots of changed parameters, a table of all parameters, plots of the others."""
    concerns = trend.concerns(arm)
    others = arm.parameters[len(concerns) :]
    name = arm.history.arm
    yield from _plots(trend, arm, concerns, f"{name} changes", f"{name}: changed parameters")
    heads: Row = (
        "parameter",
        "change",
        number("of the level [%]"),
        number("adjusted p"),
        number("level"),
        "unit",
        number("between visits [%]"),
        number("drift [% in 30 days]"),
        number("p of the drift"),
    )
    rows = [_row(trend, one) for one in arm.parameters]
    yield from table(f"{name}: all parameters", heads, rows, heading=False)
    if others:
        plots = tuple(
            _plots(trend, arm, others, f"{name} others", f"{name}: no significant change")
        )
        if concerns:
            yield Fold(f"Parameters without a significant change ({len(others)})", plots)
        else:
            yield from plots
    if arm.too_few:
        listed = ", ".join(f"{label} ({n})" for label, n in arm.too_few)
        yield paragraph(f"Too few visits: {listed}.")


def _row(trend: Trend, one: ParameterTrend) -> Row:
    change = one.change
    drift = tuple(one.of_level(_MONTH_DAYS * each) for each in (change.drift, change.drift_std))
    between = one.of_level(change.repeatability)
    return (
        Cell(one.history.label, "name"),
        Cell(one.words, mark="bad" if one.adjusted_p < trend.level else ""),
        number(_percent(one)),
        number(_p(one)),
        number(plus_minus(change.level, float(np.median(one.history.series.std)))[0]),
        one.history.unit,
        number("" if between is None else f"{between:.2g}"),
        number("" if drift[0] is None else " ± ".join(plus_minus(*drift))),
        number(probability(change.drift_p)),
    )


def _plots(
    trend: Trend, arm: ArmTrend, chosen: Sequence[ParameterTrend], name: str, label: str
) -> Iterator[Plot]:
    start = f"{arm.history.start:%Y-%m-%d}"
    words = "Estimates with their 95 % intervals; the line is the most significant change, if any."
    for k in range(0, len(chosen), _MAX_PANELS):
        title = label if k == 0 else f"{label}, continued"
        panels = tuple(_panel(trend, one) for one in chosen[k : k + _MAX_PANELS])
        drawn = Figure(Axis(f"days since {start}"), panels)
        yield Plot(f"{name} {1 + k // _MAX_PANELS}", title, drawn, words)


def _panel(trend: Trend, one: ParameterTrend) -> Panel:
    series, concern = one.history.series, one.adjusted_p < trend.level
    time, value = np.array(list(fitted_line(one.change, series))).T
    colour = MODEL if concern else RESIDUAL
    points = Markers(
        series.time, series.value, "estimate", MEASURED, 5.0, error=CI95_STDS * series.std
    )
    line = Line(time, value, "change", colour, SOLID, 2.0, legend=False)
    axis = Axis(f"{one.history.label} [{one.history.unit}]")
    return Panel(axis, (points,) if one.is_likely_chance else (line, points))


def _reading(trend: Trend) -> Iterator[Block]:
    regressed = ", ".join(trend.covariates) or "none"
    yield paragraph(
        "Estimates are weighted by their standard deviations and the scatter between visits, which "
        "is estimated with them. Three kinds of change are tested: a drift over all visits, a step "
        "before a visit and a drift that begins at a visit. The page shows the most significant "
        "one, and the probability that an unchanged parameter gives one as significant, adjusted "
        f"for the number of parameters of the arm. Covariates: {regressed}."
    )
    yield paragraph(f"Each analysis reports at most {100.0 * trend.level:g} % of unchanged arms.")
