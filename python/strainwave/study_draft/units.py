"""Infer units from data: from an angle and its velocity, or from the nearest known factor."""

from __future__ import annotations

from math import pi

import numpy as np

from strainwave.study_draft.names import UNITS

MAX_UNIT_RATIO_ERROR = 0.03  # relative tolerance between a measured and a known ratio
_UNIT_RATIOS = (  # change of angle per integral of velocity, SI factors of angle and velocity, text
    (1.0, 1.0, 1.0, "in matching units"),
    (180.0 / pi, pi / 180.0, 1.0, "the angle in degrees, the velocity in rad/s"),
    (pi / 180.0, 1.0, pi / 180.0, "the angle in rad, the velocity in deg/s"),
    (pi / 30.0, 1.0, pi / 30.0, "the angle in rad, the velocity in rpm"),
    (6.0, pi / 180.0, pi / 30.0, "the angle in degrees, the velocity in rpm"),
    (0.5 / pi, 2.0 * pi, 1.0, "the angle in turns, the velocity in rad/s"),
    (1.0 / 60.0, 2.0 * pi, pi / 30.0, "the angle in turns, the velocity in rpm"),
)


def unit_pair(ratio: float) -> tuple[float, float, str] | None:
    """Infer the units of an angle and its velocity.

    `ratio` is the change of the angle per integral of the velocity. Returns the SI factors of angle
    and velocity and a description, or None if no pair of units has this ratio.
    """
    for known, angle_scale, velocity_scale, description in _UNIT_RATIOS:
        if abs(ratio / known - 1.0) < MAX_UNIT_RATIO_ERROR:
            return angle_scale, velocity_scale, description
    return None


def nearest_unit(scale: float) -> float:
    """Return the known SI factor nearest to a measured factor."""
    known = {1.0, 1e-3, *UNITS["velocity"].values(), *UNITS["angle"].values()}
    return min(known, key=lambda each: abs(np.log(scale / each)))
