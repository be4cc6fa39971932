"""The page of the comparisons: a table of claims and numbers, then the figures."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from strainwave.records import Comparison
from strainwave.report.figures import Figure
from strainwave.report.html import Section, document, figure, table

SOURCE = (
    "Oaki and Adachi, “Decoupling Identification for Serial Two-link Robot Arm with Elastic "
    "Joints”, IFAC SYSID 2009"
)


def render_comparisons(comparisons: Sequence[Comparison], *, arm: str) -> str:
    """Every claim with the number that shows it, as one HTML page that needs no network.

    Parameters
    ----------
    comparisons : sequence of Comparison
    arm : str
        What the claims were put to.

    Returns
    -------
    str
    """
    plots: dict[str, Figure] = {}
    holding = sum(c.holds for c in comparisons)
    mark = "" if holding == len(comparisons) else "doubt"
    rows = "".join(
        f'<tr><td class="number"><a href="#fig-{c.figure}">{c.figure}</a></td>'
        f'<td class="text">{escape(c.claim)}</td><td class="text">{escape(c.message)}</td>'
        f'<td class="{_mark(c)}">{_verdict(c)}</td></tr>'
        for c in comparisons
    )
    head = (
        "<h1>Comparisons</h1>"
        f'<p class="faint">The figures of {escape(SOURCE)}, made again on {escape(arm)}</p>'
        f'<div class="verdict {mark}"><p><strong>{holding} of {len(comparisons)} '
        "claims hold on this arm.</strong></p></div>"
    )
    heads = ("#figure", "claim", "what this arm shows", "verdict")
    sections = [
        Section("claims", "Claims", table("Claims", heads, rows, heading=False)),
        *(_comparison(c, plots) for c in comparisons),
    ]
    return document("strainwave: comparisons", head, sections, plots)


def _comparison(c: Comparison, plots: dict[str, Figure]) -> Section:
    parts = [
        f"<p>{escape(c.claim)}</p>",
        f'<p><strong class="{_mark(c)}">{_verdict(c).capitalize()}:</strong> '
        f"{escape(c.message)}</p>",
    ]
    parts += [
        figure(f"plot {c.figure}", str(drawn["layout"].get("meta", c.title)), drawn, plots)
        for drawn in c.plots
    ]
    return Section(f"fig-{c.figure}", f"Fig. {c.figure}: {c.title}", "".join(parts))


def _verdict(c: Comparison) -> str:
    return "holds" if c.holds else "does not hold"


def _mark(c: Comparison) -> str:
    return "good" if c.holds else "bad"
