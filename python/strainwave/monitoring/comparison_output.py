"""A comparison for programs and people: comparison.json, comparison.html, the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from strainwave.domain.formatting import plus_minus
from strainwave.monitoring import output
from strainwave.monitoring.comparison import (
    DIFFERS,
    SAME,
    Pair,
    ParameterDifference,
    ResultComparison,
)
from strainwave.monitoring.joint_tests import JointTest
from strainwave.monitoring.output import REACH, probability
from strainwave.presentation.figures import MEASURED, MODEL, Axis, Figure, Markers, Panel
from strainwave.presentation.report.blocks import (
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
from strainwave.presentation.report.document import document as page_of

SCHEMA = "strainwave/comparison/1"

_WIDE = 4.0  # times the median interval, from which one is cut off by the figure's edge
_JOINTLY = "all at once"


def write(comparison: ResultComparison, folder: Path) -> None:
    """Write comparison.json and comparison.html.

    Parameters
    ----------
    comparison : ResultComparison
    folder : Path

    Raises
    ------
    InvalidInput
        The folder cannot be written to.
    """
    output.write("comparison", to_document(comparison), render(comparison), folder)


def to_document(comparison: ResultComparison) -> dict[str, Any]:
    """The comparison as plain JSON values, in the layout of docs/compare.md.

    Parameters
    ----------
    comparison : ResultComparison

    Returns
    -------
    dict
    """
    whole = comparison.homogeneity
    return {
        "schema": SCHEMA,
        "level": comparison.level,
        "differs": comparison.differs,
        "results": [
            {
                "label": one.label,
                "path": one.path,
                "created": one.created,
                "status": one.status,
                "study": dict(zip(("path", "sha256"), one.study, strict=True)),
            }
            for one in comparison.results
        ],
        "pairs": [
            {
                "first": pair.first,
                "second": pair.second,
                "parameters": [_difference(comparison, one) for one in pair.parameters],
                "joint_test": pair.joint and _test(comparison, pair.joint),
                "left_out": [{"parameter": p, "reason": why} for p, why in pair.left_out],
            }
            for pair in comparison.pairs
        ],
        "homogeneity": whole and _test(comparison, whole),
        "notes": list(comparison.notes),
    }


def _difference(comparison: ResultComparison, one: ParameterDifference) -> dict[str, Any]:
    return {
        "name": one.first.name,
        "joint": one.first.joint,
        "unit": one.first.unit,
        "first": {"value": one.first.value, "std": one.first.std},
        "second": {"value": one.second.value, "std": one.second.std},
        "change": one.change,
        "change_std": one.std,
        "change_percent": one.percent,
        "z": one.z,
        "p": one.p,
        "adjusted_p": one.adjusted_p,
        "verdict": comparison.verdict(one),
    }


def _test(comparison: ResultComparison, test: JointTest) -> dict[str, Any]:
    return {
        "statistic": test.statistic,
        "rank": test.rank,
        "n_values": test.n_values,
        "degrees_of_freedom": test.degrees if math.isfinite(test.degrees) else None,
        "p": test.p,
        "adjusted_p": test.adjusted_p,
        "verdict": comparison.verdict(test),
    }


def print_comparison(
    comparison: ResultComparison, folder: Path | None = None, *, console: Console | None = None
) -> None:
    """Print a table per pair, the tests of all parameters at once, and the verdict.

    Parameters
    ----------
    comparison : ResultComparison
    folder : Path, optional
        Where the files were written.
    console : rich Console, optional
        The terminal, if not standard output.
    """
    console = console or Console(highlight=False)
    for pair in comparison.pairs:
        console.print(Text(f"{pair.second} against {pair.first}", style="bold"))
        console.print(_printed(comparison, pair))
        for line in _beside(comparison, pair):
            console.print(Text(line))
    if comparison.homogeneity is not None:
        said = _said(comparison, comparison.homogeneity)
        console.print(Text(f"all {len(comparison.results)} results, {_JOINTLY}: {said}"))
    output.print_end(
        console,
        "comparison",
        headline(comparison),
        comparison.notes,
        folder,
        bad=comparison.differs,
    )


def headline(comparison: ResultComparison) -> str:
    """The verdict in one sentence.

    Parameters
    ----------
    comparison : ResultComparison

    Returns
    -------
    str
    """
    level = f"{100.0 * comparison.level:g} %"
    if not comparison.differs:
        return f"no difference at the level of {level}"
    named = list(
        dict.fromkeys(
            one.first.label
            for pair in comparison.pairs
            for one in pair.parameters
            if comparison.verdict(one) == DIFFERS
        )
    )
    said = ", ".join(named) or "no single parameter, but all at once"
    return f"the results differ at the level of {level}: {said}"


def _printed(comparison: ResultComparison, pair: Pair) -> Table:
    found = output.printed_table()
    found.add_column("parameter", no_wrap=True)
    for head in (pair.first, pair.second, "change %", "z", "adj. p"):
        found.add_column(Text(head), justify="right", overflow="ellipsis")
    found.add_column("verdict", no_wrap=True)
    for one in pair.parameters:
        verdict = comparison.verdict(one)
        values = (plus_minus(p.value, p.std)[0] for p in (one.first, one.second))
        cells = (one.first.label, *values, *_tested(one), verdict)
        found.add_row(*map(Text, cells), style="red" if verdict == DIFFERS else "")
    return found


def _tested(one: ParameterDifference) -> tuple[str, str, str]:
    """Change [%], its deviations and its adjusted p-value in words."""
    percent = "" if one.percent is None else f"{one.percent:+.{3 if abs(one.percent) < 1 else 2}f}"
    return percent, f"{one.z:+.1f}", probability(one.adjusted_p)


def _beside(comparison: ResultComparison, pair: Pair) -> Iterator[str]:
    """Lines below a pair's table."""
    if pair.joint is not None:
        yield f"{_JOINTLY}: {_said(comparison, pair.joint)}"
    if pair.left_out:
        listed = "; ".join(f"{name} {why}" for name, why in pair.left_out)
        yield f"not compared: {listed}"


def _said(comparison: ResultComparison, test: JointTest) -> str:
    """A joint test in words."""
    law = f"chi-square of {test.rank} degrees"
    if math.isfinite(test.degrees):
        law = f"rank {test.rank}, {test.degrees:.3g} degrees behind the covariance"
    return (
        f"{test.statistic:.1f} ({law}; {test.n_values} values), "
        f"adjusted p {probability(test.adjusted_p)}: {comparison.verdict(test)}"
    )


def render(comparison: ResultComparison) -> str:
    """The comparison as one HTML page that needs no network.

    Parameters
    ----------
    comparison : ResultComparison

    Returns
    -------
    str
    """
    whole = comparison.homogeneity
    facts = [] if whole is None else [f"All results at once: {_said(comparison, whole)}"]
    before = output.opening(headline(comparison), facts, comparison.notes, bad=comparison.differs)
    sections = [
        Section(
            f"pair-{k}", f"{pair.second} against {pair.first}", tuple(_blocks(comparison, pair))
        )
        for k, pair in enumerate(comparison.pairs, start=1)
    ]
    sections.append(Section("results", "Results", tuple(_results(comparison))))
    title = " and ".join(one.label for one in comparison.results)
    return page_of(title, "Results of one arm compared", sections, before=(before,))


def _blocks(comparison: ResultComparison, pair: Pair) -> Iterator[Block]:
    heads: Row = (
        "parameter",
        "verdict",
        number("change %"),
        number("in std (z)"),
        number("adjusted p"),
        number(pair.first),
        number(pair.second),
        "unit",
    )
    rows = [_row(comparison, one) for one in pair.parameters]
    yield from table("Parameters", heads, rows, heading=False)
    if pair.joint is not None:
        yield paragraph(f"All at once: {_said(comparison, pair.joint)}.")
    drawn = forest(comparison, pair)
    if drawn is not None:
        words = (
            "Change of each parameter with its 95 % interval, and in standard deviations. "
            "Intervals much wider than the others go beyond the upper panel."
        )
        yield Plot(f"changes {pair.second}", "Changes of the parameters", drawn, words)
    heads = ("not compared", "why")
    yield from table("Not compared", heads, [(p, prose(why)) for p, why in pair.left_out])


def _row(comparison: ResultComparison, one: ParameterDifference) -> Row:
    verdict = comparison.verdict(one)
    values = (" ± ".join(plus_minus(p.value, p.std)) for p in (one.first, one.second))
    return (
        Cell(one.first.label, "name"),
        Cell(verdict, mark="bad" if verdict == DIFFERS else ""),
        *map(number, _tested(one)),
        *map(number, values),
        one.first.unit,
    )


def forest(comparison: ResultComparison, pair: Pair) -> Figure | None:
    """Changes with their intervals, parameter by parameter.

    Parameters
    ----------
    comparison : ResultComparison
    pair : Pair

    Returns
    -------
    Figure or None
        None where no change can be given in percent.
    """
    shown = [one for one in pair.parameters if one.percent is not None]
    if not shown:
        return None
    percent = np.array([one.percent or 0.0 for one in shown])
    reach = np.array([REACH * (one.std_percent or 0.0) for one in shown])
    groups = [
        (verdict, colour, [k for k, one in enumerate(shown) if comparison.verdict(one) == verdict])
        for verdict, colour in ((DIFFERS, MODEL), (SAME, MEASURED))
    ]
    upper, lower = [], []
    for verdict, colour, own in groups:
        if own:
            names = tuple(shown[k].first.label for k in own)
            upper.append(Markers(names, percent[own], verdict, colour, 7.0, error=reach[own]))
            z = np.array([shown[k].z for k in own])
            lower.append(Markers(names, z, verdict, colour, 7.0, error=np.full(len(own), REACH)))
    ordinary = reach <= _WIDE * float(np.median(reach))
    widest = 1.1 * float(np.max(np.abs(percent[ordinary]) + reach[ordinary]))
    named = [abs(p) * 1.2 for p, one in zip(percent, shown, strict=True) if _named(comparison, one)]
    limit = max([widest, *named])
    panels = (
        Panel(Axis("change [%]", range=(-limit, limit)), tuple(upper), 1.8),
        Panel(Axis("in std"), tuple(lower), 1.4),
    )
    return Figure(Axis(""), panels)


def _named(comparison: ResultComparison, one: ParameterDifference) -> bool:
    return comparison.verdict(one) == DIFFERS


def _results(comparison: ResultComparison) -> Iterator[Block]:
    for one in comparison.results:
        facts = [
            ("result", one.label),
            ("file", one.path),
            ("made", one.created),
            ("status", one.status),
            ("study", one.study[0]),
            ("sha256", one.study[1]),
        ]
        if one.covariance is not None:
            n = len(one.covariance.names)
            facts.append(("joint covariance", f"of {n} parameters, stage {one.covariance.stage}"))
        yield Facts(tuple((term, fact or "not known") for term, fact in facts))
