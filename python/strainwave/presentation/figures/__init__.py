"""Figures as data, without a plotting library: the records, their style, and common charts.

`curves` makes the charts that several parts of the package share; each part of the report makes
its own from the records here.
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
    Upright,
)
from strainwave.presentation.figures.samples import MOST_POINTS, TICKS, decibel, thinned
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
    "MEASURED",
    "MODEL",
    "MOST_POINTS",
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
    "Upright",
    "decibel",
    "thinned",
]
