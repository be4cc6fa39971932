"""Files of a comparison: comparison.json and comparison.html."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain.messages import plus_minus
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.fleet.monitoring import output
from strainwave.fleet.monitoring.comparison import (
    AGREES,
    DIFFERS,
    Pair,
    ParameterDifference,
    ResultComparison,
)
from strainwave.fleet.monitoring.significance import JointTest
from strainwave.report.document.blocks import (
    Block,
    Cell,
    Facts,
    Plot,
    Row,
    Section,
    number,
    paragraph,
    prose,
    table,
)
from strainwave.report.document.blocks import document as page_of
from strainwave.report.figures import Axis, Colour, Figure, Markers, Panel

SCHEMA = "strainwave/comparison/1"

_MAX_INTERVAL_RATIO = 4.0  # to the median; wider intervals do not set the scale of the figure


def write(comparison: ResultComparison, folder: Path) -> None:
    """Write comparison.json and comparison.html into a folder."""
    output.write("comparison", to_document(comparison), render(comparison), folder)


def to_document(comparison: ResultComparison) -> dict[str, Any]:
    """The comparison as plain JSON values, in the layout of docs/compare.md."""
    homogeneity = comparison.homogeneity
    return {
        "schema": SCHEMA,
        "level": comparison.level,
        "differs": comparison.differs,
        "results": [
            {
                "label": result.label,
                "path": result.path,
                "created": result.created,
                "status": result.status,
                "study": dict(zip(("path", "sha256"), result.study, strict=True)),
            }
            for result in comparison.results
        ],
        "pairs": [
            {
                "first": pair.first,
                "second": pair.second,
                "parameters": [_difference_entry(comparison, d) for d in pair.parameters],
                "joint_test": pair.joint and _test_entry(comparison, pair.joint),
                "common_factor": pair.factor and asdict(pair.factor),
                "left_out": [{"parameter": p, "reason": reason} for p, reason in pair.left_out],
            }
            for pair in comparison.pairs
        ],
        "homogeneity": homogeneity and _test_entry(comparison, homogeneity),
        "notes": list(comparison.notes),
    }


def _difference_entry(
    comparison: ResultComparison, difference: ParameterDifference
) -> dict[str, Any]:
    return {
        "name": difference.first.name,
        "joint": difference.first.joint,
        "unit": difference.first.unit,
        "first": {"value": difference.first.value, "std": difference.first.std},
        "second": {"value": difference.second.value, "std": difference.second.std},
        "change": difference.change,
        "change_std": difference.std,
        "change_percent": difference.percent,
        "z": difference.z,
        "p": difference.p,
        "adjusted_p": difference.adjusted_p,
        "verdict": comparison.verdict(difference),
    }


def _test_entry(comparison: ResultComparison, test: JointTest) -> dict[str, Any]:
    entry = asdict(test)
    degrees = entry.pop("degrees")
    entry["degrees_of_freedom"] = degrees if math.isfinite(degrees) else None
    return entry | {"verdict": comparison.verdict(test)}


def render(comparison: ResultComparison) -> str:
    """The comparison as one self-contained HTML page."""
    test = comparison.homogeneity
    facts = [f"All results together: {comparison.describe(test)}"] if test else []
    before = output.page_summary(
        comparison.headline, facts, comparison.notes, bad=comparison.differs
    )
    sections = []
    for k, pair in enumerate(comparison.pairs, start=1):
        title, blocks = f"{pair.second} against {pair.first}", _pair_blocks(comparison, pair)
        sections.append(Section(f"pair-{k}", title, tuple(blocks)))
    terms = ("result", "file", "created", "status", "study", "sha256")
    results = []
    for result in comparison.results:
        values = (result.label, result.path, result.created, result.status, *result.study)
        items = list(zip(terms, values, strict=True))
        if result.covariance is not None:
            n = len(result.covariance.names)
            items.append(("joint covariance", f"{n} parameters, stage {result.covariance.stage}"))
        results.append(Facts(tuple((term, fact or "unknown") for term, fact in items)))
    sections.append(Section("results", "Results", tuple(results)))
    title = " and ".join(result.label for result in comparison.results)
    return page_of(title, "Comparison of results", sections, before=(before,))


def _pair_blocks(comparison: ResultComparison, pair: Pair) -> Iterator[Block]:
    columns = ("change %", "z", "adjusted p", pair.first, pair.second)
    heads: Row = ("parameter", "verdict", *map(number, columns), "unit")
    rows: list[Row] = []
    for difference in pair.parameters:
        verdict = comparison.verdict(difference)
        estimates = (difference.first, difference.second)
        values = (" ± ".join(plus_minus(p.value, p.std)) for p in estimates)
        name = Cell(difference.first.label, "name")
        mark = Cell(verdict, mark="bad" if verdict == DIFFERS else "")
        numbers = (*difference.cells, *values)
        rows.append((name, mark, *map(number, numbers), difference.first.unit))
    yield from table("Parameters", heads, rows, heading=False)
    if pair.joint is not None:
        yield paragraph(f"All parameters together: {comparison.describe(pair.joint)}.")
    figure = change_figure(comparison, pair)
    if figure is not None:
        caption = (
            "Change of each parameter with its 95 % interval, in percent and in standard "
            "deviations. The upper panel truncates intervals much wider than the others."
        )
        yield Plot(f"changes {pair.second}", "Changes of the parameters", figure, caption)
    heads = ("not compared", "reason")
    rows = [(p, prose(reason)) for p, reason in pair.left_out]
    yield from table("Not compared", heads, rows)


def change_figure(comparison: ResultComparison, pair: Pair) -> Figure | None:
    """Changes with their 95 % intervals; None if no change can be given in percent."""
    shown = [difference for difference in pair.parameters if difference.percent is not None]
    if not shown:
        return None
    percent = np.array([difference.percent or 0.0 for difference in shown])
    half_width = CI95_STDS * np.array([d.of_first(d.std) or 0.0 for d in shown])
    differs = np.array([comparison.verdict(difference) == DIFFERS for difference in shown])
    z = np.array([difference.z for difference in shown])
    upper, lower = [], []
    groups = (DIFFERS, Colour.MODEL, differs), (AGREES, Colour.MEASURED, ~differs)
    for verdict, colour, is_in_group in groups:
        rows = np.flatnonzero(is_in_group)
        if len(rows):
            names = tuple(shown[k].first.label for k in rows)
            style = (verdict, colour, 7.0, 1.0)
            upper.append(Markers(names, percent[rows], *style, half_width[rows]))
            lower.append(Markers(names, z[rows], *style, np.full(len(rows), CI95_STDS)))
    ordinary = half_width <= _MAX_INTERVAL_RATIO * float(np.median(half_width))
    widest = 1.1 * float(np.max(np.abs(percent[ordinary]) + half_width[ordinary]))
    limit = max(widest, 1.2 * float(np.abs(percent[differs]).max(initial=0.0)))
    panels = (
        Panel(Axis("change [%]", range=(-limit, limit)), tuple(upper), 1.8),
        Panel(Axis("z"), tuple(lower), 1.4),
    )
    return Figure(Axis(""), panels)
