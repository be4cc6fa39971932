"""What every page of the report is made of: the document, tables and figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from importlib.resources import files

from strainwave.report.figures import Figure


def document(title: str, body: Iterable[str], plots: Mapping[str, Figure]) -> str:
    """A whole page that needs no network.

    Parameters
    ----------
    title : str
    body : iterable of str
        HTML, escaped.
    plots : mapping of element id to figure

    Returns
    -------
    str
    """
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="color-scheme" content="light dark">',
            '<link rel="icon" href="data:,">',  # or the browser asks for one
            f"<title>{escape(title)}</title>",
            f"<style>{_own('page.css')}</style></head><body>",
            *body,
            f'<script type="application/json" id="figures">{_inline_json(plots)}</script>',
            *_scripts(plots),
            "</body></html>\n",
        ]
    )


def table(title: str, heads: Iterable[str], rows: str) -> str:
    """A titled table; a head that begins with # is of a column of numbers.

    Parameters
    ----------
    title : str
    heads : iterable of str
    rows : str
        HTML, escaped.

    Returns
    -------
    str
    """
    cells = "".join(
        f'<th scope="col" class="number">{escape(head[1:])}</th>'
        if head.startswith("#")
        else f'<th scope="col">{escape(head)}</th>'
        for head in heads
    )
    return (
        f'<h2>{escape(title)}</h2><div class="wide"><table><thead><tr>{cells}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
    )


def figure(label: str, drawn: Figure, plots: dict[str, Figure]) -> str:
    """A place for a figure, below its label; the figure joins `plots`.

    Parameters
    ----------
    label : str
    drawn : dict
    plots : dict

    Returns
    -------
    str
    """
    name = f"figure-{len(plots)}"
    plots[name] = drawn
    shape = "figure tall" if "yaxis2" in drawn["layout"] else "figure"
    return (
        f"<h3>{escape(label)}</h3>"
        f'<div class="{shape}" id="{name}" role="img" aria-label="{escape(label)}"></div>'
    )


def _scripts(plots: Mapping[str, Figure]) -> list[str]:
    if not plots:
        return []
    plotly = files("plotly").joinpath("package_data/plotly.min.js").read_text(encoding="utf-8")
    return [f"<script>{plotly}</script>", f"<script>{_own('page.js')}</script>"]


def _own(name: str) -> str:
    return files("strainwave.report").joinpath(name).read_text(encoding="utf-8")


def _inline_json(value: object) -> str:
    """JSON that may stand inside a script element: `<` would let a name close it.

    Written by pydantic's compiled encoder, which takes a quarter of the standard one's time.
    """
    from pydantic_core import to_json

    return to_json(value, inf_nan_mode="null").decode().replace("<", "\\u003c")
