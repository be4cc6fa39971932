"""Parameters of each arm over its visits: which change significantly.

Output of a trend: trend.json, trend.html, the terminal.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from strainwave.domain.messages import plus_minus
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.fleet.monitoring import output
from strainwave.fleet.monitoring.shapes import MIN_VISITS, DetectedChange, fit_change, fitted_line
from strainwave.fleet.monitoring.significance import (
    CommonFactor,
    adjust_p_values,
    common_factor,
    format_p,
    is_torque_like,
)
from strainwave.fleet.monitoring.visits import ArmHistory, Histories, ParameterHistory
from strainwave.report.document.blocks import (
    Block,
    Cell,
    Fold,
    Plot,
    Row,
    Section,
    number,
    paragraph,
    prose,
    slug,
    table,
)
from strainwave.report.document.blocks import document as page_of
from strainwave.report.figures import SOLID, Axis, Colour, Figure, Line, Markers, Panel

_MIN_LEVEL_STDS = 2.0  # a level within two standard deviations of zero gives no percentages
_MIN_CHANCE_P = 0.5  # an unchanged arm exceeds it in half of all analyses
_MAX_SINGLE_VISIT_SHARE = 0.5  # share of arms with one visit; more suggests wrongly named arms


@dataclass(frozen=True, slots=True, eq=False)
class ParameterTrend:
    """The most significant change of one parameter over the visits of an arm."""

    history: ParameterHistory
    change: DetectedChange
    adjusted_p: float = 1.0  # by Holm, over all parameters of the arm

    @property
    def percent(self) -> float | None:
        """The change over the history in percent of the level before; None as `of_level`."""
        return self.of_level(self.change.size)

    def of_level(self, size: float) -> float | None:
        """A size in percent of the level; None if the level may be zero."""
        level = abs(self.change.level)
        spread = float(np.median(self.history.series.std)) + self.change.repeatability
        return 100.0 * size / level if level > _MIN_LEVEL_STDS * spread else None

    @property
    def is_likely_chance(self) -> bool:
        """Whether the change is more likely chance than not."""
        return self.adjusted_p > _MIN_CHANCE_P

    @property
    def words(self) -> str:
        """Kind and date of the change, or "none"."""
        if self.is_likely_chance:
            return "none"
        kind, first = self.change.kind, self.change.first
        date = f"{self.history.visits[first].time:%Y-%m-%d}"
        return kind if kind == "drift" else f"{'step at' if kind == 'step' else kind} {date}"


@dataclass(frozen=True, slots=True, eq=False)
class ArmTrend:
    """One arm with its parameters, most significant change first."""

    history: ArmHistory
    parameters: tuple[ParameterTrend, ...]
    too_few: tuple[tuple[str, int], ...]  # parameters with too few visits, number of visits
    factor: CommonFactor | None = None  # of all torque-like parameters

    @property
    def p(self) -> float:
        """Adjusted p-value of the most significant change; 1 if no parameter was tested."""
        return min((parameter.adjusted_p for parameter in self.parameters), default=1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """A fleet of arms, most significant change first."""

    level: float  # probability of a false alarm, per arm
    arms: tuple[ArmTrend, ...]
    covariates: tuple[str, ...]
    notes: tuple[str, ...]

    def concerns(self, arm: ArmTrend) -> tuple[ParameterTrend, ...]:
        """Parameters of an arm that change significantly."""
        return tuple(parameter for parameter in arm.parameters if parameter.adjusted_p < self.level)

    @property
    def concern(self) -> bool:
        """Whether any arm changes significantly."""
        return any(self.concerns(arm) for arm in self.arms)


def trend(histories: Histories, level: float = 0.01) -> Trend:
    """Test each parameter of each arm for a change.

    The p-value of a parameter is that of any shape of `shapes.py`. Those of one
    arm are adjusted by Holm, so that an unchanged arm is reported with a probability of at most
    `level`, under any dependence of its parameters. Raises `InvalidInput` if the level is not
    between 0 and 1, and `NotIdentifiable` if no arm has enough visits.
    """
    if not 0.0 < level < 1.0:
        raise InvalidInput(
            f"the level {level:g} is not a probability", remedy="give for example 0.01"
        )
    arms = [_test_arm(history, level) for history in histories.arms]
    if not any(arm.parameters for arm in arms):
        max_visits = max((len(h.visits) for h in histories.arms), default=0)
        n_required = MIN_VISITS + 1 + len(histories.covariates)
        raise NotIdentifiable(
            f"no arm has enough visits for a trend: {len(arms)} arm(s) with at most {max_visits} "
            f"visit(s), but {n_required} at different times are required; "
            f"{arm_naming_hint(histories)}"
        )
    arms.sort(key=lambda arm: (arm.p, arm.history.arm))
    notes = histories.notes
    notes += tuple(f"{arm.history.arm}: {arm.factor.sentence}" for arm in arms if arm.factor)
    n_single_visits = sum(len(arm.visits) == 1 for arm in histories.arms)
    if n_single_visits > _MAX_SINGLE_VISIT_SHARE * len(arms):
        notes += (
            f"{n_single_visits} of {len(arms)} arms have one visit; {arm_naming_hint(histories)}",
        )
    return Trend(level, tuple(arms), histories.covariates, notes)


def arm_naming_hint(histories: Histories) -> str:
    """Explain how to name arms, with a study of the store as an example."""
    study = next((arm.visits[0].study for arm in histories.arms if arm.visits), "")
    return (
        "an arm is the folder of its studies unless --arm names it, for example "
        f"--arm '([^/]+)/[^/]+/[^/]+$' for the folder above; the store has studies such as "
        f"{study!r}"
    )


def _test_arm(arm: ArmHistory, level: float) -> ArmTrend:
    tested, too_few = [], []
    for history in arm.parameters:
        change = fit_change(history.series, _rng(arm.arm, history.label))
        if change is None:
            too_few.append((history.label, len(history.visits)))
        else:
            tested.append(ParameterTrend(history, change))
    adjusted = adjust_p_values([parameter.change.p for parameter in tested])
    trends = [replace(t, adjusted_p=p) for t, p in zip(tested, adjusted, strict=True)]
    trends.sort(key=lambda parameter: (parameter.adjusted_p, parameter.change.p))
    changes = [each.change for each in trends if is_torque_like(each.history.unit)]
    factor = common_factor(
        ((one.level, 0.0, one.level + one.size, one.size_std) for one in changes), level
    )
    return ArmTrend(arm, tuple(trends), tuple(too_few), factor)


def _rng(*names: str) -> np.random.Generator:
    """A generator that depends on these names only, not on the rest of the store."""
    digest = hashlib.sha256("\n".join(names).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "big"))


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
                "parameters": [_parameter_entry(trend, parameter) for parameter in arm.parameters],
                "common_factor": arm.factor and asdict(arm.factor),
                "too_few": [{"parameter": name, "visits": n} for name, n in arm.too_few],
            }
            for arm in trend.arms
        ],
        "notes": list(trend.notes),
    }


def _parameter_entry(trend: Trend, parameter: ParameterTrend) -> dict[str, Any]:
    history, change = parameter.history, parameter.change
    first = history.visits[change.first]
    return {
        "name": history.name,
        "joint": history.joint,
        "unit": history.unit,
        "stage": history.stage,
        "concern": parameter.adjusted_p < trend.level,
        "p": change.p,
        "adjusted_p": parameter.adjusted_p,
        "change": {
            "kind": change.kind,
            "at": None if change.kind == "drift" else first.time.isoformat(),
            "size": change.size,
            "std": change.size_std,
            "percent": parameter.percent,
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
    """Verdict in one sentence."""
    changed_arms = [arm.history.arm for arm in trend.arms if trend.concerns(arm)]
    total = f"of {_count_noun(len(trend.arms), 'arm')}"
    level = f"at the level of {100.0 * trend.level:g} % per arm"
    if not changed_arms:
        return f"no arm {total} changes {level}"
    verb = "changes" if len(changed_arms) == 1 else "change"
    return f"{len(changed_arms)} {total} {verb} {level}: {', '.join(changed_arms)}"


def _count_noun(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def print_trend(
    trend: Trend, folder: Path | None = None, *, console: Console | None = None
) -> None:
    """Print the most significant change of each arm, the verdict, and the files in `folder`."""
    console = console or Console(highlight=False)
    rows: list[Row] = []
    for arm in trend.arms:
        for k, parameter in enumerate(trend.concerns(arm) or arm.parameters[:1]):
            first = (arm.history.arm, str(len(arm.history.visits))) if k == 0 else ("", "")
            label = "" if parameter.is_likely_chance else parameter.history.label
            words = Cell(parameter.words, mark="bad" if parameter.adjusted_p < trend.level else "")
            rows.append((*first, label, words, *_test_cells(parameter)))
        if not arm.parameters:
            rows.append((arm.history.arm, str(len(arm.history.visits)), "too few visits"))
    numbers = map(number, ("%", "adj. p"))
    heads: Row = ("arm", number("visits"), "parameter", "change", *numbers)
    output.print_tables(console, table("Arms", heads, rows))
    output.print_end(console, "trend", headline(trend), trend.notes, folder, bad=trend.concern)


def _test_cells(parameter: ParameterTrend) -> tuple[str, str]:
    """Change [% of the level] and adjusted p-value as text."""
    shown = parameter.percent is not None and not parameter.is_likely_chance
    return f"{parameter.percent:+.2f}" if shown else "", format_p(parameter.adjusted_p)


def render(trend: Trend) -> str:
    """The trend as one self-contained HTML page."""
    numbers = ("of the level [%]", "adjusted p", "changed parameters", "visits")
    heads: Row = ("arm", "change", *map(number, numbers), "first", "last")
    rows = [_fleet_row(trend, arm) for arm in trend.arms]
    fleet = table("Arms, most significant change first", heads, rows, heading=False)
    changed = [arm for arm in trend.arms if trend.concerns(arm)]
    unchanged = [arm for arm in trend.arms if not trend.concerns(arm)]
    folds = tuple(
        Fold(f"{arm.history.arm}: {len(arm.history.visits)} visits", tuple(_arm_blocks(trend, arm)))
        for arm in unchanged
    )
    sections = [
        Section("fleet", "Fleet", tuple(fleet)),
        *(
            Section(f"arm-{slug(arm.history.arm)}", arm.history.arm, tuple(_arm_blocks(trend, arm)))
            for arm in changed
        ),
        Section("others", "Arms without a significant change", folds),
        Section("reading", "Method", tuple(_method_blocks(trend))),
    ]
    visits = sum(len(arm.history.visits) for arm in trend.arms)
    subtitle = f"{_count_noun(len(trend.arms), 'arm')}, {_count_noun(visits, 'visit')}"
    before = output.page_summary(headline(trend), (), trend.notes, bad=trend.concern)
    return page_of("Parameters over time", subtitle, sections, before=(before,))


def _fleet_row(trend: Trend, arm: ArmTrend) -> Row:
    concerns = trend.concerns(arm)
    visits = arm.history.visits
    name = Cell(arm.history.arm, href=f"#arm-{slug(arm.history.arm)}" if concerns else "#others")
    dates = tuple(f"{visit.time:%Y-%m-%d}" for visit in (visits[0], visits[-1]))
    if not arm.parameters:
        return (name, prose("too few visits"), *[number("")] * 3, number(str(len(visits))), *dates)
    parameter = arm.parameters[0]
    words = f"{parameter.history.label}: {parameter.words}"
    words = "none" if parameter.is_likely_chance else words
    return (
        name,
        Cell(words, "text", mark="bad" if concerns else ""),
        *map(number, _test_cells(parameter)),
        number(str(len(concerns))),
        number(str(len(visits))),
        *dates,
    )


def _arm_blocks(trend: Trend, arm: ArmTrend) -> Iterator[Block]:
    concerns = trend.concerns(arm)
    others = arm.parameters[len(concerns) :]
    name = arm.history.arm
    yield from _plots(trend, arm, concerns, f"{name} changes", f"{name}: changed parameters")
    tests = map(number, ("of the level [%]", "adjusted p", "level"))
    further = map(number, ("between visits [%]", "drift [% in 30 days]", "p of the drift"))
    heads: Row = ("parameter", "change", *tests, "unit", *further)
    rows = [_row(trend, parameter) for parameter in arm.parameters]
    yield from table(f"{name}: all parameters", heads, rows, heading=False)
    plots = tuple(_plots(trend, arm, others, f"{name} others", f"{name}: no significant change"))
    if others and concerns:
        yield Fold(f"Parameters without a significant change ({len(others)})", plots)
    else:
        yield from plots
    if arm.too_few:
        listed = ", ".join(f"{label} ({n})" for label, n in arm.too_few)
        yield paragraph(f"Too few visits: {listed}.")


def _row(trend: Trend, parameter: ParameterTrend) -> Row:
    change = parameter.change
    drift = tuple(
        parameter.of_level(_MONTH_DAYS * each) for each in (change.drift, change.drift_std)
    )
    between = parameter.of_level(change.repeatability)
    return (
        Cell(parameter.history.label, "name"),
        Cell(parameter.words, mark="bad" if parameter.adjusted_p < trend.level else ""),
        *map(number, _test_cells(parameter)),
        number(plus_minus(change.level, float(np.median(parameter.history.series.std)))[0]),
        parameter.history.unit,
        number("" if between is None else f"{between:.2g}"),
        number("" if drift[0] is None else " ± ".join(plus_minus(*drift))),
        number(format_p(change.drift_p)),
    )


def _plots(
    trend: Trend, arm: ArmTrend, parameters: Sequence[ParameterTrend], name: str, label: str
) -> Iterator[Plot]:
    start = f"{arm.history.start:%Y-%m-%d}"
    caption = (
        "Estimates with their 95 % intervals; the line is the most significant change, if any."
    )
    for k in range(0, len(parameters), _MAX_PANELS):
        title = label if k == 0 else f"{label}, continued"
        panels = []
        for parameter in parameters[k : k + _MAX_PANELS]:
            series, is_chance = parameter.history.series, parameter.is_likely_chance
            time, value = np.array(list(fitted_line(parameter.change, series))).T
            colour = Colour.MODEL if parameter.adjusted_p < trend.level else Colour.RESIDUAL
            error = CI95_STDS * series.std
            points = Markers(
                series.time, series.value, "estimate", Colour.MEASURED, 5.0, error=error
            )
            line = Line(time, value, "change", colour, SOLID, 2.0, legend=False)
            axis = Axis(f"{parameter.history.label} [{parameter.history.unit}]")
            panels.append(Panel(axis, (points,) if is_chance else (line, points)))
        figure = Figure(Axis(f"days since {start}"), tuple(panels))
        yield Plot(f"{name} {1 + k // _MAX_PANELS}", title, figure, caption)


def _method_blocks(trend: Trend) -> Iterator[Block]:
    regressed = ", ".join(trend.covariates) or "none"
    yield paragraph(
        "Estimates are weighted by their standard deviations and the scatter between visits, which "
        "is estimated with them. Three kinds of change are tested: a drift over all visits, a step "
        "before a visit and a drift that begins at a visit. The page shows the most significant "
        "one, and the probability that an unchanged parameter gives one as significant, adjusted "
        f"for the number of parameters of the arm. Covariates: {regressed}."
    )
    yield paragraph(f"Each analysis reports at most {100.0 * trend.level:g} % of unchanged arms.")
