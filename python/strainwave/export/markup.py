"""What the XML formats share: a tree that says where it comes from, and exact numbers."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from strainwave.export.source import IdentifiedArm


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
    return " ".join(repr(float(value)) for value in values)


def root(tag: str, name: str, arm: IdentifiedArm) -> ET.Element:
    """The outermost element, with a comment on its origin and units.

    Parameters
    ----------
    tag, name : str
    arm : IdentifiedArm

    Returns
    -------
    Element
    """
    element = ET.Element(tag, {name: "arm"})
    remark(element, f"Identified by strainwave, from {arm.source}. SI units, angles in rad.")
    return element


def remark(parent: ET.Element, text: str) -> None:
    """Add a comment.

    Parameters
    ----------
    parent : Element
    text : str
    """
    # two hyphens would end it
    parent.append(ET.Comment(f" {text.replace('--', '- -')} "))


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
