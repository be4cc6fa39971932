"""HTML by templates: every text in them is escaped, and a name that is not given is an error."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unicodedata import lookup

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

_HERE = Path(__file__).parent
_GREEK = {
    name: lookup(f"GREEK SMALL LETTER {name.upper()}")
    for name in ("alpha", "beta", "gamma", "delta", "tau")
}


def filled(template: str, **values: Any) -> str:
    """A template of this package with values filled in.

    Parameters
    ----------
    template : str
        Folder and name, without ".html.j2": "report/page".
    **values
        By the names that the template has for them.

    Returns
    -------
    str
        HTML.
    """
    return _environment().get_template(f"{template}.html.j2").render(**values)


def source(name: str) -> str:
    """The text of a file of templates.

    Parameters
    ----------
    name : str
        Folder and name, with its ending: "report/page.css".

    Returns
    -------
    str
    """
    folder, _, file = name.partition("/")
    return (_HERE / folder / "templates" / file).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    found = Environment(
        autoescape=True,
        loader=FunctionLoader(source),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )
    found.filters |= {"typeset": typeset, "breakable": breakable}
    return found


def breakable(name: str) -> Markup:
    """A name that may go on in a new line after each of its words.

    Parameters
    ----------
    name : str
        Its words joined by underscores.

    Returns
    -------
    Markup
    """
    from markupsafe import Markup, escape

    return escape(name).replace("_", Markup("_<wbr>"))


def typeset(symbol: str) -> Markup:
    """A symbol as print sets it: `m_M` with its index lowered, `alpha` as the Greek letter.

    Parameters
    ----------
    symbol : str
        As in docs/notation.md.

    Returns
    -------
    Markup
    """
    from markupsafe import Markup

    stem, _, index = symbol.partition("_")
    if not index:
        stem = symbol.rstrip("0123456789")
        index = symbol.removeprefix(stem)
    return Markup("{}<sub>{}</sub>" if index else "{}").format(_GREEK.get(stem, stem), index)
