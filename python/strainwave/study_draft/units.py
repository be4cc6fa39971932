"""Units identified by numbers: an angle and its velocity, or a factor near a known one."""

from __future__ import annotations

from math import pi

import numpy as np

from strainwave.study_draft.names import UNITS

NEAR = 0.03  # of a ratio to one that two units have
_UNIT_RATIOS = (  # angle's change per integral of the velocity -> scales of both
    (1.0, 1.0, 1.0, "in matching units"),
    (180.0 / pi, pi / 180.0, 1.0, "the angle in degrees, the velocity in rad/s"),
    (pi / 180.0, 1.0, pi / 180.0, "the angle in rad, the velocity in deg/s"),
    (pi / 30.0, 1.0, pi / 30.0, "the angle in rad, the velocity in rpm"),
    (6.0, pi / 180.0, pi / 30.0, "the angle in degrees, the velocity in rpm"),
    (0.5 / pi, 2.0 * pi, 1.0, "the angle in turns, the velocity in rad/s"),
    (1.0 / 60.0, 2.0 * pi, pi / 30.0, "the angle in turns, the velocity in rpm"),
)


def unit_pair(ratio: float) -> tuple[float, float, str] | None:
    """Factors to SI of an angle and a velocity, by the angle's change per integral of the velocity.

    Parameters
    ----------
    ratio : float

    Returns
    -------
    (float, float, str) or None
        Of the angle, of the velocity, and what to say; None: no two units have that ratio.
    """
    for known, of_angle, of_velocity, said in _UNIT_RATIOS:
        if abs(ratio / known - 1.0) < NEAR:
            return of_angle, of_velocity, said
    return None


def nearest_unit(scale: float) -> float:
    """The factor to SI nearest to one that was measured."""
    known = {1.0, 1e-3, *UNITS["velocity"].values(), *UNITS["angle"].values()}
    return min(known, key=lambda each: abs(np.log(scale / each)))
