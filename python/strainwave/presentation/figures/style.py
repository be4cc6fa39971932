"""Colours and dashes. The colours are those of Okabe and Ito, safe for colour-blind readers.

Measured data are blue, the model is vermilion. Every colour has its own dash, so that no line is
distinguished by colour alone.
"""

from __future__ import annotations

from strainwave.presentation.figures.records import SOLID, Dash

MEASURED_COLOUR = "#0072B2"
MODEL_COLOUR = "#D55E00"
LINEAR_COLOUR = "#009E73"
TUNED_COLOUR = "#CC79A7"
RESIDUAL_COLOUR = "#888888"

PALETTE = (MEASURED_COLOUR, MODEL_COLOUR, LINEAR_COLOUR, TUNED_COLOUR, "#56B4E9", "#E69F00")
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
