"""Equations as MathML, made when the pages are built: no script, no font, no network.

A `\\tag{S1}` at the end of an equation becomes its number at the margin and the anchor `eq-s1`.
"""

from __future__ import annotations

import re
from html import escape
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

_TAG = re.compile(r"\s*\\tag\{([^}]*)\}\s*$")


def _inline(translator: Any, node: nodes.Element) -> None:
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.Element) -> None:
    text = node.astext().strip()
    tag = _TAG.search(text)
    number = escape(tag[1]) if tag else ""
    anchor = f' id="eq-{number.lower()}"' if number else ""
    shown = f'<span class="eqno">({number})</span>' if number else ""
    equation = convert(_TAG.sub("", text), display="block")
    translator.body.append(f'<div class="math equation"{anchor}>{equation}{shown}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Offer the renderer `mathml` to the HTML builders."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
