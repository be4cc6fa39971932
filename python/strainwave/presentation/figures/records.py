"""Figures as data: panels one above the other over one axis, and what is drawn in them.

Nothing here knows a plotting library. `strainwave.presentation.plotly_backend` and
`strainwave.presentation.matplotlib_backend` draw these records, and nothing else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from strainwave.domain import FloatArray

Dash = tuple[float, ...]
"""Lengths of dashes and gaps [px]; empty: a solid line."""

SOLID: Dash = ()
DOTTED: Dash = (3.0, 3.0)

_ROWS = 6  # of a heat map in the height of a panel: their names still stand apart


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Points joined in their order; NaN is a gap."""

    x: FloatArray
    y: FloatArray
    name: str  # lines of one name are one entry of the legend
    colour: str  # "#rrggbb"
    dash: Dash = SOLID
    width: float = 1.5  # [px]
    legend: bool = True  # whether the legend has it
    size: float = 0.0  # [px] of a dot at each point; 0: none
    error: FloatArray | None = None  # half-length of the vertical bar at each point


@dataclass(frozen=True, slots=True, eq=False)
class Markers:
    """Points that no line joins."""

    x: FloatArray | tuple[str, ...]  # numbers, or names along the axis
    y: FloatArray
    name: str
    colour: str
    size: float = 4.0  # [px]
    opacity: float = 1.0
    error: FloatArray | None = None  # half-length of the vertical bar at each point


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """The area between two lines, as the 95 % band around a third."""

    x: FloatArray
    low: FloatArray
    high: FloatArray
    colour: str  # of the third, from which it is made pale
    name: str  # of the third, with which it is hidden


@dataclass(frozen=True, slots=True, eq=False)
class Bars:
    """Upright bars around the middles of bins."""

    x: FloatArray
    y: FloatArray
    width: float
    name: str
    colour: str


@dataclass(frozen=True, slots=True, eq=False)
class HeatMap:
    """A square matrix as colours, its first row at the top."""

    names: tuple[str, ...]  # of rows and of columns
    values: FloatArray  # (n_names, n_names)
    low: float
    high: float
    colours: tuple[str, str, str]  # of low, of the middle, of high


Mark = Line | Markers | Band | Bars | HeatMap


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis with its title."""

    title: str  # with unit
    log: bool = False
    range: tuple[float, float] | None = None  # None: what is drawn
    step: float | None = None  # between ticks; None: as fits


@dataclass(frozen=True, slots=True)
class Panel:
    """Marks over one vertical axis, the last on top."""

    axis: Axis
    marks: tuple[Mark, ...]
    height: float = 1.0  # relative to the other panels


@dataclass(frozen=True, slots=True)
class Upright:
    """A vertical line through all panels, with words beside it."""

    x: float
    text: str = ""
    panel: int = 0  # in which the words stand, from 0 at the top
    height: float = 1.0  # of the words' upper edge, as a share of that panel
    before: bool = False  # whether the words stand left of the line, not right of it
    dash: Dash = DOTTED


@dataclass(frozen=True, slots=True)
class Figure:
    """Panels one above the other, which share their horizontal axis."""

    x: Axis
    panels: tuple[Panel, ...]  # from the top
    uprights: tuple[Upright, ...] = ()
    caption: str = ""

    @property
    def marks(self) -> list[Mark]:
        """Of all panels, from the top."""
        return [mark for panel in self.panels for mark in panel.marks]

    @property
    def height(self) -> float:
        """In heights of a panel of one line; names of a heat map need room."""
        rows = max((len(m.names) for m in self.marks if isinstance(m, HeatMap)), default=0)
        names = 1 + math.ceil(rows / _ROWS) if rows else 0
        return max(sum(panel.height for panel in self.panels), names)

    @property
    def legend(self) -> list[str]:
        """Names of its entries, each once; none where there is nothing to distinguish."""
        names = [
            mark.name
            for mark in self.marks
            if isinstance(mark, Line | Markers | Bars) and getattr(mark, "legend", True)
        ]
        found = list(dict.fromkeys(names))
        return found if len(found) > 1 else []
