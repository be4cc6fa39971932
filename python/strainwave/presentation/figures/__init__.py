"""Figures as data, without a plotting library: records, style, and charts used in several places.

`curves` holds the shared charts; each module of the report makes its own from these records.
"""

from strainwave.presentation.figures.records import (
    DOTTED,
    SOLID,
    Axis,
    Band,
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
    MAX_POINTS,
    MIN_BAND_SHARE,
    NORMAL_99,
    TICKS,
    decibel,
    decimate,
    spread_evenly,
)
from strainwave.presentation.figures.style import (
    BRIEF,
    DASHES,
    LINEAR,
    MEASURED,
    MODEL,
    PALETTE,
    RESIDUAL,
    TUNED,
)

__all__ = [
    "BRIEF",
    "DASHES",
    "DOTTED",
    "LINEAR",
    "MAX_POINTS",
    "MEASURED",
    "MIN_BAND_SHARE",
    "MODEL",
    "NORMAL_99",
    "PALETTE",
    "RESIDUAL",
    "SOLID",
    "TICKS",
    "TUNED",
    "Axis",
    "Band",
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
