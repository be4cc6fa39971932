"""Parts of a figure by name."""

from __future__ import annotations

from typing import TypeVar

from strainwave.report.figures import Area, Bars, Figure, HeatMap, Line, Mark, Markers

T = TypeVar("T", Line, Markers, Area, Bars, HeatMap)


def marks(figure: Figure, kind: type[T], panel: int = 0) -> list[T]:
    return [mark for mark in figure.panels[panel].marks if isinstance(mark, kind)]


def line(figure: Figure, name: str, panel: int = 0) -> Line:
    (line,) = (mark for mark in marks(figure, Line, panel) if mark.name == name)
    return line


def names(figure: Figure, panel: int = 0) -> list[str]:
    drawn: list[Mark] = list(figure.panels[panel].marks)
    return [mark.name for mark in drawn if isinstance(mark, Line | Markers)]
