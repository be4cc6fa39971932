"""Sections -> one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from strainwave.presentation.html import filled, source
from strainwave.presentation.plotly_backend import plotly
from strainwave.presentation.report.blocks import Block, Section, keyed

_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)
"""Nothing may be fetched, and nothing be evaluated but what stands in the page."""


def document(
    title: str, subtitle: str, sections: Sequence[Section], *, before: Sequence[Block] = ()
) -> str:
    """A whole page that needs no network.

    Parameters
    ----------
    title, subtitle : str
    sections : sequence of Section
        Those without blocks are left out.
    before : sequence of Block
        Before the list of contents; without figures.

    Returns
    -------
    str
    """
    from markupsafe import Markup

    shown = [section for section in sections if section.blocks]
    plots = keyed(shown)
    keys = {id(plot): key for key, plot in plots.items()}
    return filled(
        "report/page",
        policy=_POLICY,
        title=title,
        subtitle=subtitle,
        before=before,
        sections=shown,
        key_of=lambda plot: keys[id(plot)],
        style=Markup(source("report/page.css")),
        figures=Markup(_inline_json({key: plotly(plot.figure) for key, plot in plots.items()})),
        scripts=[Markup(_script()), Markup(source("report/page.js"))] if plots else [],
    )


def _script() -> str:
    """Plotly's script alone: to import the package around it takes longer than to fill the page."""
    found = find_spec("plotly")
    if found is None or found.origin is None:
        raise ModuleNotFoundError("plotly")
    script = Path(found.origin).parent / "package_data" / "plotly.min.js"
    return script.read_bytes().decode()


def _inline_json(value: object) -> str:
    """JSON that may stand inside a script element: `<` would let a name close it.

    Written by pydantic's compiled encoder, which takes a quarter of the standard one's time.
    """
    from pydantic_core import to_json

    return to_json(value, inf_nan_mode="null").decode().replace("<", "\\u003c")
