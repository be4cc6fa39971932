"""Texts from Jinja templates, files that stand next to the modules that fill them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment


def fill_text(path: Path, **values: Any) -> str:
    """The text of a template with values, which are not escaped; a missing value is an error."""
    return _texts().get_template(str(path)).render(**values)


def template_environment(read: Callable[[str], str], *, autoescape: bool) -> Environment:
    """Templates that `read` gives by name, without the line ends of their statements."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    return Environment(
        autoescape=autoescape,
        loader=FunctionLoader(read),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=not autoescape,
        auto_reload=False,
    )


@cache
def _texts() -> Environment:
    return template_environment(lambda name: Path(name).read_text("utf-8"), autoescape=False)
