"""Docstrings of the API pages: plain text stays plain, and fields get their comments.

The docstrings are written for editors. Stars, bars and trailing underscores in their equations are
not markup, an indented equation is a code block, and comments describe the fields of a record.
These hooks pass that on to autodoc.
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
    text, sections = _before_sections(lines)
    blocks = [_block(block) for block in "\n".join(text).split("\n\n")]
    lines[:] = "\n\n".join([*blocks, _plain("\n".join(sections))]).split("\n")
    if what == "class" and dataclasses.is_dataclass(obj):
        lines += ["", *_fields(obj)]


def _without_fields(app: Sphinx, what: str, name: str, obj: Any, *rest: Any) -> Any:
    """Omit the signature of a record: its fields follow as a list."""
    return ("", None) if what == "class" and dataclasses.is_dataclass(obj) else None


def _before_sections(lines: list[str]) -> tuple[list[str], list[str]]:
    """Split a docstring into text and numpy sections (a word with a rule of its length below)."""
    for k in range(1, len(lines)):
        if lines[k] and set(lines[k]) == {"-"} and len(lines[k]) == len(lines[k - 1]):
            return lines[: k - 1], lines[k - 1 :]
    return lines, []


def _block(block: str) -> str:
    """A paragraph, or an equation if all of it is indented."""
    indented = all(line.startswith("    ") for line in block.split("\n"))
    return f"::\n\n{block}" if indented else _plain(block)


def _plain(text: str) -> str:
    """Escape everything but single backquotes, which mean code."""
    parts = re.split(r"(`[^`\n]+`)", text)
    parts[::2] = [re.sub(r"([*|\\])|(?<=\w)(_)(?!\w)", r"\\\1\2", part) for part in parts[::2]]
    parts[1::2] = [f"`{part}`" for part in parts[1::2]]
    return "".join(parts)


def _fields(record: type) -> list[str]:
    """List of a record's fields with types and comments, from its source."""
    source = textwrap.dedent(inspect.getsource(record))
    lines = source.splitlines()
    body = ast.parse(source).body[0]
    assert isinstance(body, ast.ClassDef)
    entries = []
    for field in body.body:
        if isinstance(field, ast.AnnAssign):
            first, last = field.lineno - 1, field.end_lineno or field.lineno
            start = first
            while lines[start - 1].lstrip().startswith("#"):
                start -= 1
            comments = [_COMMENT.search(line) for line in lines[start:last]]
            text = _literal(" ".join(comment[1] for comment in comments if comment))
            kind = ast.unparse(field.annotation)
            entries.append(
                f"- ``{ast.unparse(field.target)}``: ``{kind}``{', ' * bool(text)}{text}"
            )
    return entries


def _literal(text: str) -> str:
    return re.sub(r"([*|`\\_])", r"\\\1", text)


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to autodoc, before napoleon reads the sections."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-docstring", _process, priority=100)
    app.connect("autodoc-process-signature", _without_fields)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
