"""Figures as data: panels over one shared horizontal axis, and the marks in them.

This module needs no plotting library. `strainwave.presentation.plotly_backend` and
`strainwave.presentation.matplotlib_backend` draw these records.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from strainwave.domain import FloatArray

Dash = tuple[float, ...]
"""Lengths of dashes and gaps [px]; empty for a solid line."""

Symbol = Literal["circle", "circle-open", "x"]

SOLID: Dash = ()
DOTTED: Dash = (3.0, 3.0)

_HEAT_MAP_ROWS_PER_PANEL = 6  # row names stay legible at this density


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Points joined in order; NaN is a gap."""

    x: FloatArray
    y: FloatArray
    name: str  # lines of one name share a legend entry
    colour: str  # "#rrggbb"
    dash: Dash = SOLID
    width: float = 1.5  # [px]
    legend: bool = True  # whether the legend lists it
    size: float = 0.0  # [px] of a dot at each point; 0 for none
    error: FloatArray | None = None  # half-length of a vertical error bar at each point


@dataclass(frozen=True, slots=True, eq=False)
class Markers:
    """Separate points."""

    x: FloatArray | tuple[str, ...]  # numbers, or category names
    y: FloatArray
    name: str
    colour: str
    size: float = 4.0  # [px]
    opacity: float = 1.0
    error: FloatArray | None = None  # half-length of a vertical error bar at each point
    symbol: Symbol = "circle"


@dataclass(frozen=True, slots=True, eq=False)
class Area:
    """The area between two curves, for example a 95 % confidence band."""

    x: FloatArray
    low: FloatArray
    high: FloatArray
    colour: str  # of the line that the band belongs to; drawn transparent
    name: str  # of that line: both are hidden together


@dataclass(frozen=True, slots=True, eq=False)
class Bars:
    """Vertical bars centred on bins."""

    x: FloatArray
    y: FloatArray
    width: float
    name: str
    colour: str


@dataclass(frozen=True, slots=True, eq=False)
class HeatMap:
    """A square matrix as colours, first row at the top."""

    names: tuple[str, ...]  # of rows and columns
    values: FloatArray  # (n_names, n_names)
    low: float
    high: float
    colours: tuple[str, str, str]  # at the low, middle and high value


Mark = Line | Markers | Area | Bars | HeatMap


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis and its title."""

    title: str  # with unit
    log: bool = False
    range: tuple[float, float] | None = None  # None for the range of the data
    step: float | None = None  # between ticks; None for automatic


FREQUENCY_AXIS = Axis("frequency [Hz]", log=True)


@dataclass(frozen=True, slots=True)
class Panel:
    """Marks over one vertical axis; the last is on top."""

    axis: Axis
    marks: tuple[Mark, ...]
    height: float = 1.0  # relative to the other panels


@dataclass(frozen=True, slots=True)
class Upright:
    """A vertical line through all panels, with an optional label."""

    x: float
    text: str = ""
    panel: int = 0  # of the label, from 0 at the top
    height: float = 1.0  # upper edge of the label, as a share of the panel
    before: bool = False  # whether the label is left of the line
    dash: Dash = DOTTED


@dataclass(frozen=True, slots=True)
class Figure:
    """Panels one above the other that share the horizontal axis."""

    x: Axis
    panels: tuple[Panel, ...]  # from the top
    uprights: tuple[Upright, ...] = ()
    caption: str = ""

    @property
    def marks(self) -> list[Mark]:
        """The marks of all panels, from the top."""
        return [mark for panel in self.panels for mark in panel.marks]

    @property
    def height(self) -> float:
        """Height in units of one panel; a heat map takes the room its row names need."""
        rows = max((len(m.names) for m in self.marks if isinstance(m, HeatMap)), default=0)
        names = 1 + math.ceil(rows / _HEAT_MAP_ROWS_PER_PANEL) if rows else 0
        return max(sum(panel.height for panel in self.panels), names)

    @property
    def legend(self) -> list[str]:
        """Names of the legend entries; empty if there is only one."""
        names = [
            mark.name
            for mark in self.marks
            if isinstance(mark, Line | Markers | Bars) and getattr(mark, "legend", True)
        ]
        entries = list(dict.fromkeys(names))
        return entries if len(entries) > 1 else []
