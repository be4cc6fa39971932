"""The page of the comparisons: a table of claims and numbers, then the figures."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from strainwave.domain import Comparison, Criterion, Evidence, Tally
from strainwave.presentation.report.figures import Figure
from strainwave.presentation.report.html import Cell, Section, document, figure, row, table

SOURCE = (
    "Oaki and Adachi, “Decoupling Identification for Serial Two-link Robot Arm with Elastic "
    "Joints”, IFAC SYSID 2009"
)


_MARKS = {"shown": "good", "not-shown": "doubt", "does-not-hold": "bad"}
_PROTOCOLS = {"own": "", "as-published": ", as published"}


def render_comparisons(tallies: Sequence[Tally], *, arm: str) -> str:
    """Every claim with the numbers that show it, as one HTML page that needs no network.

    Parameters
    ----------
    tallies : sequence of Tally
        Figures and numbers are those of the first run of each.
    arm : str
        What the claims were put to.

    Returns
    -------
    str
    """
    plots: dict[str, Figure] = {}
    shown = sum(t.first.outcome == "shown" for t in tallies)
    mark = "" if shown == len(tallies) else "doubt"
    rows = "".join(
        f'<tr><td class="number"><a href="#{_key(t.first)}">{t.first.figure}</a></td>'
        f'<td class="text">{escape(t.first.claim)}{_PROTOCOLS[t.first.protocol]}</td>'
        f'<td class="text">{escape(t.first.message)}</td>'
        f'<td class="{_MARKS[t.first.outcome]}">{escape(t.verdict)}</td></tr>'
        for t in tallies
    )
    head = (
        "<h1>Comparisons</h1>"
        f'<p class="faint">The figures of {escape(SOURCE)}, made again on {escape(arm)}</p>'
        f'<div class="verdict {mark}"><p><strong>{shown} of {len(tallies)} '
        "claims are shown on this arm.</strong></p></div>"
    )
    heads = ("#figure", "claim", "what this arm shows", "verdict")
    sections = [
        Section("claims", "Claims", table("Claims", heads, rows, heading=False)),
        *(_comparison(t, plots) for t in tallies),
    ]
    return document("strainwave: comparisons", head, sections, plots)


def _comparison(tally: Tally, plots: dict[str, Figure]) -> Section:
    c, key = tally.first, _key(tally.first)
    parts = [
        f"<p>{escape(c.claim)}</p>",
        f'<p><strong class="{_MARKS[c.outcome]}">{escape(tally.verdict)}:</strong> '
        f"{escape(c.message)}</p>",
        *(f"<p>{escape(reason)}</p>" for reason in c.reasons),
        table("Criteria", ("criterion", "#value", "limit", "kept"), _criteria(c.criteria)),
    ]
    parts += [
        figure(f"plot {key} {k}", str(drawn["layout"].get("meta", c.title)), drawn, plots)
        for k, drawn in enumerate(c.plots)
    ]
    heads = ("model", "method", "#order", "status", "warnings")
    parts.append(table("Models", heads, _models(c.evidence)))
    title = f"Fig. {c.figure}: {c.title}{_PROTOCOLS[c.protocol]}"
    return Section(key, title, "".join(parts))


def _key(c: Comparison) -> str:
    return f"fig-{c.figure}" + ("" if c.protocol == "own" else f"-{c.protocol}")


def _criteria(criteria: Sequence[Criterion]) -> str:
    return "".join(
        row(
            (
                Cell(c.name, "text"),
                Cell(f"{c.value:.5g}", "number"),
                Cell(f"{c.bound} {c.limit:g}: {c.reason}", "text"),
                "yes" if c.passed else "no",
            )
        )
        for c in criteria
    )


def _models(evidence: Sequence[Evidence]) -> str:
    return "".join(
        row(
            (
                Cell(e.name, "text"),
                e.method,
                Cell("" if e.order is None else str(e.order), "number"),
                e.status + (", unstable" if e.growth > 1.0 else ""),
                Cell(", ".join(dict.fromkeys(w.code for w in e.warnings)), "text"),
            )
        )
        for e in evidence
    )
