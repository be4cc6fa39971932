"""Figures as data, without a plotting library: panels over one horizontal axis, and their marks.

`strainwave.report.plotly_backend` and `strainwave.report.matplotlib_backend` draw these
records. `curves` holds charts used in several places; each module of the report makes its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np

from strainwave.domain import FloatArray, IntArray

Dash = tuple[float, ...]
"""Lengths of dashes and gaps [px]; empty for a solid line."""

Symbol = Literal["circle", "circle-open", "x"]

SOLID: Dash = ()
DOTTED: Dash = (3.0, 3.0)

MAX_POINTS = 1200  # points of one line: two per pixel column of a figure 600 px wide
MIN_BAND_SHARE = 1e-2  # of a modulus: a lower band edge of zero has no value in dB
_HEAT_MAP_ROWS_PER_PANEL = 6  # row names stay legible at this density


class Colour(StrEnum):
    """Colours of Okabe and Ito, which colour-blind readers can distinguish, and grey.

    Every colour of the palette has its own dash, so that no line is distinguished by colour alone.
    """

    MEASURED = "#0072B2"
    MODEL = "#D55E00"
    LINEAR = "#009E73"
    TUNED = "#CC79A7"
    SKY = "#56B4E9"
    AMBER = "#E69F00"
    RESIDUAL = "#888888"


PALETTE = tuple(Colour)[:-1]
DASHES: tuple[Dash, ...] = (
    SOLID,
    (6.0, 3.0),
    (2.0, 2.0),
    (8.0, 3.0, 2.0, 3.0),
    (10.0, 4.0),
    (4.0, 2.0, 1.0, 2.0),
)
SHORT_DASH: Dash = (4.0, 2.0)
"""Dash of the second of two lines."""


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
    labels: tuple[str, ...] = ()  # text beside each point
    is_above: bool = True  # of the labels; below the points otherwise


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
    has_equal_scales: bool = False  # whether both axes have the same scale

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


def _engineering(value: float) -> str:
    """A number with its SI prefix: 500m, 2, 10k."""
    exponent = int(np.floor(np.log10(value) / 3.0 + 1e-9))
    prefix = {-3: "n", -2: "µ", -1: "m", 0: "", 1: "k", 2: "M"}[exponent]
    return f"{value / 1e3**exponent:g}{prefix}"


_TICKS = [float(f"{one}e{decade}") for decade in range(-6, 7) for one in (1, 2, 5)]
FREQUENCY_TICKS = {value: _engineering(value) for value in _TICKS}
"""Ticks of logarithmic horizontal axes and their labels."""


def decimate(y: FloatArray, limit: int = MAX_POINTS) -> IntArray:
    """Rows to draw: minimum and maximum of each bin, so that every peak stays; NaN stays a gap.

    `y` has shape (n_samples,) or (n_samples, n_lines); lines that share their rows each keep their
    peaks. About `limit` rows are returned.
    """
    columns = y.reshape(len(y), -1)
    n, count = columns.shape
    if n <= limit:
        return np.arange(n)
    edges = np.linspace(0, n, max(1, limit // (2 * count)) + 1).astype(np.intp)
    low, last = edges[:-1, None], edges[1:, None] - 1
    bins = np.minimum(low + np.arange(np.diff(edges).max()), last)  # short bins repeat their end
    inside = columns[bins]
    gap = np.isnan(inside)
    has_gaps = bool(gap.any())
    least = np.argmin(np.where(gap, np.inf, inside) if has_gaps else inside, axis=1)
    greatest = np.argmax(np.where(gap, -np.inf, inside) if has_gaps else inside, axis=1)
    is_selected = np.zeros(n, dtype=bool)
    is_selected[low + least] = is_selected[low + greatest] = True
    return np.flatnonzero(is_selected)


def spread_evenly(f: FloatArray, low: float, high: float, limit: int) -> IntArray:
    """Indices of frequencies from `low` to `high`, at most `limit`, even over log frequency."""
    inside = np.flatnonzero((f >= low) & (f <= high))
    if len(inside) <= limit:
        return inside
    targets = np.geomspace(f[inside[0]], f[inside[-1]], limit)
    return np.unique(np.searchsorted(f, targets).clip(inside[0], inside[-1]))


def decibel(modulus: FloatArray) -> FloatArray:
    """20 log10 of a modulus; -6000 dB for zero."""
    return np.asarray(20.0 * np.log10(np.maximum(modulus, 1e-300)))


def line_panel(
    title: str,
    x: FloatArray,
    y: FloatArray,
    name: str,
    colour: str = Colour.MEASURED,
    limit: int = MAX_POINTS,
) -> Panel:
    """A panel with one line, decimated to about `limit` points."""
    rows = decimate(y, limit)
    return Panel(Axis(title), (Line(x[rows], y[rows], name, colour),))
