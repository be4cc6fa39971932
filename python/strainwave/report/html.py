"""HTML from templates. Every text is escaped, and a missing value is an error."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unicodedata import lookup

from strainwave.io.templates import template_environment

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

_HERE = Path(__file__).parent
_GREEK = {
    name: lookup(f"GREEK SMALL LETTER {name.upper()}")
    for name in ("alpha", "beta", "gamma", "delta", "tau")
}


def fill_template(template: str, **values: Any) -> str:
    """The HTML of a template of this package, named without its ending: "document/page"."""
    return _environment().get_template(f"{template}.html.j2").render(**values)


def load_template(template: str) -> None:
    """Compile a template that `fill_template` uses later."""
    _environment().get_template(f"{template}.html.j2")


def read_template(name: str) -> str:
    """The text of a template file, named with its ending: "document/page.css"."""
    folder, _, file = name.partition("/")
    return (_HERE / folder / "templates" / file).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    environment = template_environment(read_template, autoescape=True)
    environment.filters |= {"typeset": typeset, "breakable": breakable}
    return environment


def breakable(name: str) -> Markup:
    """A name that may break after each underscore."""
    from markupsafe import Markup, escape

    return escape(name).replace("_", Markup("_<wbr>"))


def typeset(symbol: str) -> Markup:
    """A symbol of docs/notation.md as mathematics: `m_M` with an index, `alpha` in Greek."""
    from markupsafe import Markup

    stem, _, index = symbol.partition("_")
    if not index:
        stem = symbol.rstrip("0123456789")
        index = symbol.removeprefix(stem)
    return Markup("{}<sub>{}</sub>" if index else "{}").format(_GREEK.get(stem, stem), index)
