"""The page of the comparisons with the paper: a table of claims, then their figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from strainwave.domain import Comparison, Criterion, Evidence, Outcome, Tally
from strainwave.presentation.report.blocks import (
    Block,
    Callout,
    Cell,
    Mark,
    Plot,
    Row,
    Section,
    Span,
    number,
    paragraph,
    prose,
    table,
)
from strainwave.presentation.report.document import document

SOURCE = (
    "Oaki and Adachi, “Decoupling Identification for Serial Two-link Robot Arm with Elastic "
    "Joints”, IFAC SYSID 2009"
)

_MARKS: dict[Outcome, Mark] = {"shown": "good", "not-shown": "doubt", "does-not-hold": "bad"}
_PROTOCOLS = {"own": "", "as-published": ", as published"}


def render_comparisons(tallies: Sequence[Tally], *, arm: str) -> str:
    """All claims with the numbers behind them, as one HTML page that needs no network.

    Figures and numbers are those of the first run of each claim.
    """
    n_shown = sum(t.first.outcome == "shown" for t in tallies)
    lead = Span(f"{n_shown} of {len(tallies)} claims are confirmed on this arm.", strong=True)
    summary = Callout("" if n_shown == len(tallies) else "doubt", (paragraph(lead),))
    heads = (number("figure"), "claim", "result on this arm", "verdict")
    rows = [_row(tally) for tally in tallies]
    sections = [
        Section("claims", "Claims", tuple(table("Claims", heads, rows, heading=False))),
        *(_section(tally) for tally in tallies),
    ]
    subtitle = f"Figures of {SOURCE}, reproduced on {arm}"
    return document("Comparisons", subtitle, sections, before=(summary,))


def _row(tally: Tally) -> tuple[Cell, ...]:
    c = tally.first
    return (
        Cell(str(c.figure), "number", href=f"#{_key(c)}"),
        prose(c.claim + _PROTOCOLS[c.protocol]),
        prose(c.message),
        Cell(tally.verdict, mark=_MARKS[c.outcome]),
    )


def _section(tally: Tally) -> Section:
    c = tally.first
    title = f"Fig. {c.figure}: {c.title}{_PROTOCOLS[c.protocol]}"
    return Section(_key(c), title, tuple(_blocks(tally)))


def _blocks(tally: Tally) -> Iterator[Block]:
    c = tally.first
    yield paragraph(c.claim)
    verdict = Span(f"{tally.verdict}:", strong=True, mark=_MARKS[c.outcome])
    yield paragraph(verdict, f" {c.message}")
    for reason in c.reasons:
        yield paragraph(reason)
    heads: Row = ("criterion", number("value"), "limit", "met")
    yield from table("Criteria", heads, map(_criterion, c.criteria))
    for k, figure in enumerate(c.plots):
        yield Plot(f"plot {_key(c)} {k}", figure.caption or c.title, figure)
    heads = ("model", "method", number("order"), "status", "warnings")
    yield from table("Models", heads, map(_model, c.evidence))


def _key(c: Comparison) -> str:
    return f"fig-{c.figure}" + ("" if c.protocol == "own" else f"-{c.protocol}")


def _criterion(c: Criterion) -> Row:
    limit = prose(f"{c.bound} {c.limit:g}: {c.reason}")
    return prose(c.name), number(f"{c.value:.5g}"), limit, "yes" if c.passed else "no"


def _model(e: Evidence) -> Row:
    return (
        prose(e.name),
        e.method,
        number("" if e.order is None else str(e.order)),
        e.status + (", unstable" if e.growth > 1.0 else ""),
        prose(", ".join(dict.fromkeys(w.code for w in e.warnings))),
    )
