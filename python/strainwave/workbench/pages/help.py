"""Help on each page: sections of `help.md`, and the texts of keys, options and warnings.

Everything comes from the package, so that help works without a network.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from typing import Any

from markdown_it import MarkdownIt
from markupsafe import Markup
from starlette.requests import Request
from starlette.responses import Response

from strainwave.domain.messages import catalogue
from strainwave.domain.study import study_keys, study_options
from strainwave.errors import InvalidInput
from strainwave.workbench.web import HERE, PAGE_TABS, STUDY_TABS, Routes, page

routes = Routes()

_LINK = re.compile(r"\[([^]\n]*)\]\([^)\n]*\)")  # to a page of the documentation
_KEYS = (
    ("?", "help on this page"),
    ("/", "go to the filter of the table"),
    ("Ctrl Enter", "press the main button of the page"),
    ("Ctrl Z", "undo the last change of the study or of a slider"),
    ("Esc", "close help or a menu"),
)


@routes.page("/help/{topic}")
def _show_help(request: Request) -> Response:
    topic = request.path_params["topic"]
    if topic not in (topics := _topics()):
        raise InvalidInput("there is no such help", where=topic, remedy="open the help of a page")
    title, text = topics[topic]
    html = Markup(MarkdownIt("commonmark").enable("table").render(_LINK.sub(r"\1", text())))
    letters = [(f"G {letter}", f"page {name}") for _, name, letter in (*PAGE_TABS, *STUDY_TABS)]
    names = [(key, name) for key, (name, _) in topics.items() if key != topic]
    return page(request, "help", title, text=html, keys=(*_KEYS, *letters), topics=names)


@cache
def _topics() -> Mapping[str, tuple[str, Callable[[], str]]]:
    """Title and Markdown text of each topic, by the address of its page."""
    sections = re.split(r"(?m)^## ", (HERE / "help.md").read_text(encoding="utf-8"))[1:]
    written = dict(section.split("\n", 1) for section in sections)
    topics: dict[str, tuple[str, Callable[[], str]]] = {}
    for key, name, _ in (*PAGE_TABS, *STUDY_TABS):
        topics[key or "studies"] = name, partial(written.__getitem__, name)
    topics["keys"] = "Keys of a study file", _study_keys
    topics["options"] = "Options of the estimate", _options
    topics["warnings"] = "Warnings and what to do", _warnings
    return topics


def _study_keys() -> str:
    heads = ("key", "unit", "default", "meaning")
    return "\n\n".join(
        f"## {table}\n\n"
        + _table(heads, ((f"`{key.key}`", key.unit, key.default, key.meaning) for key in keys))
        for table, keys in study_keys().items()
    )


def _options() -> str:
    rows = (
        (f"`{each.name}`", each.default, f"{each.meaning} {each.reason}")
        for each in study_options()
    )
    return _table(("option", "default", "meaning"), rows)


def _warnings() -> str:
    return "\n\n".join(
        f"## {code}\n\n{each['observed']}\n\n*Meaning.* {each['meaning']}\n\n"
        f"*What to do.* {each['remedy']}"
        for code, each in catalogue().items()
    )


def _table(heads: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> str:
    lines = (heads, tuple("---" for _ in heads), *rows)
    return "\n".join(
        f"| {' | '.join(str(each).replace('|', chr(92) + '|') for each in row)} |" for row in lines
    )
