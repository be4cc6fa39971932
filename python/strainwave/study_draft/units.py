"""Infer units from data: from an angle and its velocity, or from the nearest known factor."""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np

from strainwave.study_draft.names import UNITS

MAX_UNIT_RATIO_ERROR = 0.03  # relative tolerance between a measured and a known ratio


class UnitPair(NamedTuple):
    """Units of an angle and its velocity."""

    ratio: float  # change of the angle per integral of the velocity
    angle_scale: float  # SI factor
    text: str


_UNIT_PAIRS = (
    UnitPair(1.0, 1.0, "in matching units"),
    UnitPair(180.0 / pi, pi / 180.0, "the angle in degrees, the velocity in rad/s"),
    UnitPair(pi / 180.0, 1.0, "the angle in rad, the velocity in deg/s"),
    UnitPair(pi / 30.0, 1.0, "the angle in rad, the velocity in rpm"),
    UnitPair(6.0, pi / 180.0, "the angle in degrees, the velocity in rpm"),
    UnitPair(0.5 / pi, 2.0 * pi, "the angle in turns, the velocity in rad/s"),
    UnitPair(1.0 / 60.0, 2.0 * pi, "the angle in turns, the velocity in rpm"),
)


def unit_pair(ratio: float) -> UnitPair | None:
    """Infer the units of an angle and its velocity; None if no pair of units has this ratio."""
    matches = (p for p in _UNIT_PAIRS if abs(ratio / p.ratio - 1.0) < MAX_UNIT_RATIO_ERROR)
    return next(matches, None)


def nearest_unit(scale: float) -> float:
    """Return the known SI factor nearest to a measured factor."""
    known = {1.0, 1e-3, *UNITS["velocity"].values(), *UNITS["angle"].values()}
    return min(known, key=lambda each: abs(np.log(scale / each)))
