"""The page of the comparisons with the paper: a table of claims, then their figures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import zip_longest

from reproduction.records import Comparison, Evidence, Outcome, Protocol, Tally
from strainwave.report.document.blocks import (
    Block,
    Callout,
    Cell,
    Columns,
    Mark,
    Plot,
    Row,
    Section,
    Span,
    document,
    number,
    paragraph,
    prose,
    table,
)
from strainwave.report.figures import Figure

SOURCE = (
    "Oaki and Adachi, “Decoupling Identification for Serial Two-link Robot Arm with Elastic "
    "Joints”, IFAC SYSID 2009"
)

_MARKS: dict[Outcome, Mark] = {"shown": "good", "not-shown": "doubt", "does-not-hold": "bad"}
PROTOCOL_TEXTS: dict[Protocol, str] = {
    "own": "default settings",
    "as-published": "published settings",
}


def render_comparisons(tallies: Sequence[Tally], *, arm: str) -> str:
    """All claims with the numbers behind them, as one HTML page that needs no network.

    Results with several settings stand side by side. Figures and numbers are those of the first
    run of each claim.
    """
    figures: dict[int, list[Tally]] = {}
    for tally in tallies:
        figures.setdefault(tally.first.figure, []).append(tally)
    settings = list(dict.fromkeys(PROTOCOL_TEXTS[t.first.protocol] for t in tallies))
    counts = (
        f"{text}: {sum(t.is_mostly('shown') for t in tallies if _text(t) == text)} of "
        f"{sum(_text(t) == text for t in tallies)} claims are shown"
        for text in settings
    )
    is_complete = all(t.is_mostly("shown") for t in tallies)
    summary = Callout(
        "" if is_complete else "doubt", (paragraph(Span("; ".join(counts) + ".", strong=True)),)
    )
    heads: Row = (number("figure"), "claim", *settings)
    rows = [_row(group) for group in figures.values()]
    sections = [
        Section("claims", "Claims", tuple(table("Claims", heads, rows, heading=False))),
        *(_section(group) for group in figures.values()),
    ]
    subtitle = f"Figures of {SOURCE}, reproduced on {arm}"
    return document("Comparisons", subtitle, sections, before=(summary,))


def _text(tally: Tally) -> str:
    return PROTOCOL_TEXTS[tally.first.protocol]


def _row(group: Sequence[Tally]) -> tuple[Cell, ...]:
    c = group[0].first
    return (
        Cell(str(c.figure), "number", href=f"#fig-{c.figure}"),
        prose(c.claim),
        *(Cell(tally.verdict, mark=_MARKS[tally.first.outcome]) for tally in group),
    )


def _section(group: Sequence[Tally]) -> Section:
    c = group[0].first
    return Section(f"fig-{c.figure}", f"Fig. {c.figure}: {c.title}", tuple(_blocks(group)))


def _blocks(group: Sequence[Tally]) -> Iterator[Block]:
    yield paragraph(group[0].first.claim)
    for tally in group:
        c = tally.first
        verdict = Span(f"{_text(tally)}, {tally.verdict}:", strong=True, mark=_MARKS[c.outcome])
        yield paragraph(verdict, f" {c.message}")
        for reason in c.reasons:
            yield paragraph(reason)
    yield from _criteria(group)
    for k, plots in enumerate(zip_longest(*(tally.first.plots for tally in group))):
        yield Columns(
            tuple(
                Plot(f"plot fig-{t.first.figure} {t.first.protocol} {k}", _label(t, plot), plot)
                for t, plot in zip(group, plots, strict=True)
                if plot is not None
            )
        )
    heads = ("model", "method", number("order"), "status", "warnings")
    for tally in group:
        yield from table(f"Models, {_text(tally)}", heads, map(_model, tally.first.evidence))


def _label(tally: Tally, plot: Figure) -> str:
    return f"{plot.caption or tally.first.title}, {_text(tally)}"


def _criteria(group: Sequence[Tally]) -> Iterator[Block]:
    """Criteria of one figure with the values of all settings; NaN is shown as "none"."""
    heads: Row = ("criterion", "limit", *(number(_text(tally)) for tally in group))
    named = {c.name: c for tally in group for c in tally.first.criteria}
    rows = [
        (
            prose(name),
            prose(f"{c.bound} {c.limit:g}: {c.reason}"),
            *(_value(tally.first, name) for tally in group),
        )
        for name, c in named.items()
    ]
    yield from table("Criteria", heads, rows)


def _value(comparison: Comparison, name: str) -> Cell:
    criterion = next((c for c in comparison.criteria if c.name == name), None)
    if criterion is None or not math.isfinite(criterion.value):
        return number("none")
    return number(f"{criterion.value:.4g}" + ("" if criterion.passed else " (not met)"))


def _model(e: Evidence) -> Row:
    return (
        prose(e.name),
        e.method,
        number("" if e.order is None else str(e.order)),
        e.status + (", unstable" if e.growth > 1.0 else ""),
        prose(", ".join(dict.fromkeys(w.code for w in e.warnings))),
    )
