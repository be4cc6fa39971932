"""XML trees with comments and exact numbers."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree as ET

from strainwave.export.omissions import sentence_of


def numbers(*values: float) -> str:
    """Numbers separated by blanks, with all digits."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # no -0.0


def root(tag: str, name: str, notes: Iterable[str]) -> ET.Element:
    """The outermost element, with comments on its origin and on omitted parts.

    `name` is the attribute that has the name of the model.
    """
    element = ET.Element(tag, {name: "arm"})
    comment(element, "Identified by strainwave. SI units, angles in rad.")
    for note in notes:
        comment(element, sentence_of(note))
    return element


def comment(parent: ET.Element, text: str) -> None:
    """Add a comment."""
    parent.append(ET.Comment(f" {comment_text(text)} "))


def comment_text(text: str) -> str:
    """Text of a comment; two hyphens in a row, which XML forbids, become one."""
    return text.replace("--", "-")


def to_bytes(element: ET.Element) -> bytes:
    """The file: declaration, indented tree, newline at the end."""
    ET.indent(element)
    text: bytes = ET.tostring(element, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
