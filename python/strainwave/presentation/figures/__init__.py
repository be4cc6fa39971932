"""Figures as data, without a plotting library: records, style, and charts used in several places.

`curves` holds the shared charts; each module of the report makes its own from these records.
"""

from strainwave.presentation.figures.records import (
    DOTTED,
    FREQUENCY_AXIS,
    SOLID,
    Area,
    Axis,
    Bars,
    Dash,
    Figure,
    HeatMap,
    Line,
    Mark,
    Markers,
    Panel,
    Symbol,
    Upright,
)
from strainwave.presentation.figures.samples import (
    FREQUENCY_TICKS,
    MAX_POINTS,
    MIN_BAND_SHARE,
    decibel,
    decimate,
    spread_evenly,
)
from strainwave.presentation.figures.style import (
    DASHES,
    PALETTE,
    SHORT_DASH,
    Colour,
)

__all__ = [
    "DASHES",
    "DOTTED",
    "FREQUENCY_AXIS",
    "FREQUENCY_TICKS",
    "MAX_POINTS",
    "MIN_BAND_SHARE",
    "PALETTE",
    "SHORT_DASH",
    "SOLID",
    "Area",
    "Axis",
    "Bars",
    "Colour",
    "Dash",
    "Figure",
    "HeatMap",
    "Line",
    "Mark",
    "Markers",
    "Panel",
    "Symbol",
    "Upright",
    "decibel",
    "decimate",
    "spread_evenly",
]
