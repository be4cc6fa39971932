r"""Equations as MathML, converted when the pages are built: no script, no network.

`\tag{S1}` at the end of an equation gives its number at the margin and the anchor `eq-s1`.
"""

from __future__ import annotations

import re
from html import escape
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

_TAG = re.compile(r"\s*\\tag\{([^}]*)\}\s*$")


_FUNCTION = re.compile(r"<mi>(sin|cos|exp)</mi>(?!<mo[^>]*>&#x00028;)|<mi>(exp|cos|sin)</mi>")
_SPACE = '<mspace width="0.17em"/>'


def _converted(text: str, display: str) -> str:
    """MathML with TeX's spaces around functions."""

    def spaced(match: re.Match[str]) -> str:
        return _SPACE + (f"<mi>{match[1]}</mi>{_SPACE}" if match[1] else f"<mi>{match[2]}</mi>")

    return _FUNCTION.sub(spaced, convert(text, display=display))


def _inline(translator: Any, node: nodes.Element) -> None:
    translator.body.append(_converted(node.astext(), "inline"))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.Element) -> None:
    text = node.astext().strip()
    tag = _TAG.search(text)
    number = escape(tag[1]) if tag else ""
    anchor = f' id="eq-{number.lower()}"' if number else ""
    shown = f'<span class="number">({number})</span>' if number else ""
    equation = _converted(_TAG.sub("", text), "block")
    translator.body.append(f'<div class="equation"{anchor}>{equation}{shown}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer `mathml` with the HTML builders."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
