"""What every page of the report is made of: the document, its sections, tables and figures."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from strainwave.presentation.report.figures import Figure

_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)
"""Nothing may be fetched, and nothing be evaluated but what stands in the page."""


_ROWS = 6  # of a heat map in the height of a panel: their names still stand apart


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page that the contents list names."""

    key: str  # its element's id
    title: str
    body: str  # HTML, escaped; empty: the section is left out


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table that is not a plain word."""

    text: str
    kind: Literal["", "number", "text"] = ""


def document(
    title: str, head: str, sections: Sequence[Section], plots: Mapping[str, Figure]
) -> str:
    """A whole page that needs no network.

    Parameters
    ----------
    title : str
    head : str
        HTML, escaped, before the first section.
    sections : sequence of Section
        Those without a body are left out.
    plots : mapping of name to figure

    Returns
    -------
    str
    """
    shown = [section for section in sections if section.body]
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="color-scheme" content="light dark">',
            '<link rel="icon" href="data:,">',  # or the browser asks for one
            f"<title>{escape(title)}</title>",
            f"<style>{_own('page.css')}</style></head><body>",
            '<a class="skip" href="#main">Skip to the findings</a>',
            f"<header>{head}</header>",
            _contents(shown),
            '<main id="main" tabindex="-1">',
            *(_section(section) for section in shown),
            "</main>",
            f'<script type="application/json" id="figures">{_inline_json(plots)}</script>',
            *_scripts(plots),
            "</body></html>\n",
        ]
    )


def table(label: str, heads: Iterable[str], rows: str, *, heading: bool = True) -> str:
    """A table in a region of its own that scrolls sideways.

    Parameters
    ----------
    label : str
    heads : iterable of str
        One that begins with # is of a column of numbers.
    rows : str
        HTML, escaped: `<tr>` elements.
    heading : bool
        Whether the label is written above the table; else only screen readers say it.

    Returns
    -------
    str
        Nothing for no rows.
    """
    if not rows:
        return ""
    cells = "".join(
        f'<th scope="col" class="number">{escape(head[1:])}</th>'
        if head.startswith("#")
        else f'<th scope="col">{escape(head)}</th>'
        for head in heads
    )
    above = f"<h3>{escape(label)}</h3>" if heading else ""
    return (
        f'{above}<div class="wide" role="region" aria-label="{escape(label)}" tabindex="0"><table>'
        f"<thead><tr>{cells}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def row(cells: Iterable[str | Cell]) -> str:
    """A row of a table.

    Parameters
    ----------
    cells : iterable of str or Cell
        The first is the row's head.

    Returns
    -------
    str
    """
    parts = []
    for k, cell in enumerate(cells):
        own = cell if isinstance(cell, Cell) else Cell(cell)
        kind = f' class="{own.kind}"' if own.kind else ""
        text = escape(own.text)
        parts.append(f"<td{kind}>{text}</td>" if k else f'<th scope="row"{kind}>{text}</th>')
    return f"<tr>{''.join(parts)}</tr>"


def number(text: str) -> Cell:
    """A cell of a column of numbers."""
    return Cell(text, "number")


def prose(text: str) -> Cell:
    """A cell of sentences, which may take several lines."""
    return Cell(text, "text")


def figure(
    name: str, label: str, drawn: Figure, plots: dict[str, Figure], *, words: str = ""
) -> str:
    """A place for a figure; the figure joins `plots`.

    Parameters
    ----------
    name : str
        Of its files; made fit for one.
    label : str
        Stands above.
    drawn : dict
    plots : dict
    words : str
        What it shows, in words, below; also for those who do not see it.

    Returns
    -------
    str
    """
    key = _free(slug(name), plots)
    plots[key] = drawn
    panels = sum(axis.startswith("yaxis") for axis in drawn["layout"]) or 1
    rows = max((len(t["y"]) for t in drawn["data"] if t.get("type") == "heatmap"), default=0)
    below = f"<figcaption>{escape(words)}</figcaption>" if words else ""
    return (
        f'<figure><h3>{escape(label)}</h3><div class="plot" id="figure-{key}" role="img" '
        f'style="--panels:{max(panels, 1 + math.ceil(rows / _ROWS) if rows else 0)}" '
        f'aria-label="{escape(f"{label}. {words}".strip())}"></div>{below}</figure>'
    )


def slug(text: str) -> str:
    """A name fit for a file and an element: small letters, digits and dashes.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
    """
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "figure"


def _free(key: str, taken: Mapping[str, Figure]) -> str:
    """The key, numbered where another figure has it."""
    candidate, k = key, 2
    while candidate in taken:
        candidate, k = f"{key}-{k}", k + 1
    return candidate


def _contents(sections: Sequence[Section]) -> str:
    items = "".join(f'<li><a href="#{s.key}">{escape(s.title)}</a></li>' for s in sections)
    return f'<nav aria-label="Contents"><ol>{items}</ol></nav>'


def _section(section: Section) -> str:
    head = f"{section.key}-title"
    return (
        f'<section id="{section.key}" aria-labelledby="{head}">'
        f'<h2 id="{head}">{escape(section.title)}</h2>{section.body}</section>'
    )


def _scripts(plots: Mapping[str, Figure]) -> list[str]:
    if not plots:
        return []
    return [
        "<noscript><p>The figures need JavaScript; words and tables do not.</p></noscript>",
        f"<script>{_plotly()}</script>",
        f"<script>{_own('page.js')}</script>",
    ]


def _plotly() -> str:
    """The script alone: to import the package around it takes longer than to fill the page."""
    found = find_spec("plotly")
    if found is None or found.origin is None:
        raise ModuleNotFoundError("plotly")
    script = Path(found.origin).parent / "package_data" / "plotly.min.js"
    return script.read_text(encoding="utf-8")


def _own(name: str) -> str:
    return files("strainwave.presentation.report").joinpath(name).read_text(encoding="utf-8")


def _inline_json(value: object) -> str:
    """JSON that may stand inside a script element: `<` would let a name close it.

    Written by pydantic's compiled encoder, which takes a quarter of the standard one's time.
    """
    from pydantic_core import to_json

    return to_json(value, inf_nan_mode="null").decode().replace("<", "\\u003c")
