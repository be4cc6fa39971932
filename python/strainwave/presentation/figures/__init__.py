"""Figures as data, without a plotting library: records, style, and charts used in several places.

`curves` holds the shared charts; each module of the report makes its own from these records.
"""

from strainwave.presentation.figures.records import (
    DOTTED,
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
    LINEAR_COLOUR,
    MEASURED_COLOUR,
    MODEL_COLOUR,
    PALETTE,
    RESIDUAL_COLOUR,
    SHORT_DASH,
    TUNED_COLOUR,
)

__all__ = [
    "DASHES",
    "DOTTED",
    "FREQUENCY_TICKS",
    "LINEAR_COLOUR",
    "MAX_POINTS",
    "MEASURED_COLOUR",
    "MIN_BAND_SHARE",
    "MODEL_COLOUR",
    "PALETTE",
    "RESIDUAL_COLOUR",
    "SHORT_DASH",
    "SOLID",
    "TUNED_COLOUR",
    "Area",
    "Axis",
    "Bars",
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
