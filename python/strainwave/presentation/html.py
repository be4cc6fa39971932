"""HTML by templates: every text in them is escaped, and a name that is not given is an error."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment


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
    found = files("strainwave.presentation").joinpath(folder, "templates", file)
    return found.read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    return Environment(
        autoescape=True,
        loader=FunctionLoader(source),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )
