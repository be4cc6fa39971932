"""What the XML formats share: a tree that says where it comes from, and exact numbers."""

from __future__ import annotations

from xml.etree import ElementTree as ET


def numbers(*values: float) -> str:
    """Numbers as text that reads back equal.

    Parameters
    ----------
    values : float

    Returns
    -------
    str
        Separated by blanks.
    """
    return " ".join(repr(float(value) + 0.0) for value in values)  # no -0.0


def root(tag: str, name: str) -> ET.Element:
    """The outermost element, with a comment on its origin and units.

    Parameters
    ----------
    tag : str
    name : str
        The attribute that has the model's name.

    Returns
    -------
    Element
    """
    element = ET.Element(tag, {name: "arm"})
    remark(element, "Identified by strainwave. SI units, angles in rad.")
    return element


def remark(parent: ET.Element, text: str) -> None:
    """Add a comment.

    Parameters
    ----------
    parent : Element
    text : str
        Without two hyphens in a row, which would end it.
    """
    parent.append(ET.Comment(f" {text} "))


def to_bytes(element: ET.Element) -> bytes:
    """The file: declaration, indented tree, newline at the end.

    Parameters
    ----------
    element : Element

    Returns
    -------
    bytes
    """
    ET.indent(element)
    text: bytes = ET.tostring(element, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
