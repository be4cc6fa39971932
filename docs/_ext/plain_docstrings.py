"""Docstrings for the API pages: plain text stays plain, and fields get the comments beside them.

Our docstrings are read in editors first. Stars, bars and trailing underscores in their equations
are no markup, an indented equation is a block of code, and a record's fields say what they are in
comments: these hooks tell autodoc so.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import textwrap
from typing import Any

from sphinx.application import Sphinx

_COMMENT = re.compile(r"# (.*)$")


def _process(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    told, sections = _before_sections(lines)
    blocks = [_block(block) for block in "\n".join(told).split("\n\n")]
    lines[:] = "\n\n".join([*blocks, _plain("\n".join(sections))]).split("\n")
    if what == "class" and dataclasses.is_dataclass(obj):
        lines += ["", *_fields(obj)]


def _without_fields(app: Sphinx, what: str, name: str, obj: Any, *rest: Any) -> Any:
    """No signature for a record: its fields follow as a list."""
    return ("", None) if what == "class" and dataclasses.is_dataclass(obj) else None


def _before_sections(lines: list[str]) -> tuple[list[str], list[str]]:
    """The docstring's text, and its numpy sections: a word with a rule of the same length below."""
    for k in range(1, len(lines)):
        if lines[k] and set(lines[k]) == {"-"} and len(lines[k]) == len(lines[k - 1]):
            return lines[: k - 1], lines[k - 1 :]
    return lines, []


def _block(block: str) -> str:
    """A paragraph; where all of it is indented, an equation."""
    indented = all(line.startswith("    ") for line in block.split("\n"))
    return f"::\n\n{block}" if indented else _plain(block)


def _plain(text: str) -> str:
    """Text in which single backquotes mean code and nothing else is markup."""
    parts = re.split(r"(`[^`\n]+`)", text)
    parts[::2] = [re.sub(r"([*|\\])|(?<=\w)(_)(?!\w)", r"\\\1\2", part) for part in parts[::2]]
    parts[1::2] = [f"`{part}`" for part in parts[1::2]]
    return "".join(parts)


def _fields(record: type) -> list[str]:
    """A record's own fields as a list of definitions, from its source."""
    source = textwrap.dedent(inspect.getsource(record))
    lines = source.splitlines()
    body = ast.parse(source).body[0]
    assert isinstance(body, ast.ClassDef)
    found = []
    for field in body.body:
        if isinstance(field, ast.AnnAssign):
            first, last = field.lineno - 1, field.end_lineno or field.lineno
            above = [lines[first - 1]] if lines[first - 1].lstrip().startswith("#") else []
            said = [_COMMENT.search(line) for line in above + lines[first:last]]
            text = _literal(" ".join(comment[1] for comment in said if comment))
            kind = ast.unparse(field.annotation)
            found.append(f"- ``{ast.unparse(field.target)}``: ``{kind}``{', ' * bool(text)}{text}")
    return found


def _literal(text: str) -> str:
    return re.sub(r"([*|`\\_])", r"\\\1", text)


def setup(app: Sphinx) -> dict[str, bool]:
    """Hook into autodoc, before napoleon reads the sections."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-docstring", _process, priority=100)
    app.connect("autodoc-process-signature", _without_fields)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
