"""Sections to one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from strainwave.presentation.html import fill_template, read_template
from strainwave.presentation.plotly_backend import plotly
from strainwave.presentation.report.blocks import Block, Section, keyed

_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)
"""Content security policy: the page loads nothing and evaluates only its own scripts."""


def document(
    title: str, subtitle: str, sections: Sequence[Section], *, before: Sequence[Block] = ()
) -> str:
    """A complete page that needs no network. `before` precedes the contents and has no figures."""
    from markupsafe import Markup

    filled = [section for section in sections if section.blocks]
    plots = keyed(filled)
    keys = {id(plot): key for key, plot in plots.items()}
    return fill_template(
        "report/page",
        policy=_POLICY,
        title=title,
        subtitle=subtitle,
        before=before,
        sections=filled,
        key_of=lambda plot: keys[id(plot)],
        style=Markup(read_template("report/page.css")),
        figures=Markup(
            _inline_json(
                {key: plotly(plot.figure) | {"title": plot.label} for key, plot in plots.items()}
            )
        ),
        scripts=[Markup(script) for script in page_scripts()] if plots else [],
    )


def page_scripts() -> list[str]:
    """The scripts of a page with figures."""
    return [_plotly_script(), read_template("report/page.js")]


def _plotly_script() -> str:
    """Plotly's script. Importing the Python package takes longer than filling the page."""
    spec = find_spec("plotly")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("plotly")
    script = Path(spec.origin).parent / "package_data" / "plotly.min.js"
    return script.read_bytes().decode()


def _inline_json(value: object) -> str:
    """JSON for a script element, in which `<` is escaped because it could end the element.

    pydantic's compiled encoder takes a quarter of the time of the standard one.
    """
    from pydantic_core import to_json

    return to_json(value, inf_nan_mode="null").decode().replace("<", "\\u003c")
