"""Colours and dashes. The colours are those of Okabe and Ito, safe for colour-blind readers.

Measured data are blue, the model is vermilion. Every colour has its own dash, so that no line is
distinguished by colour alone.
"""

from __future__ import annotations

from enum import StrEnum

from strainwave.presentation.figures.records import SOLID, Dash


class Colour(StrEnum):
    """Colours of lines and points, in the order in which lines without a meaning take them."""

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
