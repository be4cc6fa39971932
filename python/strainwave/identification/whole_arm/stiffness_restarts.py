"""Other starts for stiffness curves that ended as fewer slopes than they have.

A knee beyond the largest torque, one near zero, and one between equal slopes bend nothing: no
derivative would ever bring them back. Two knees close together are as good as one: the slope
between them is hardly felt, and a search that came there from far seldom gets them apart again.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from strainwave.domain.parameters import Values
from strainwave.identification.whole_arm.parametrisation import CURVE, KNEES

_SAME = 0.01  # relative difference below which two slopes are one
_NOTHING = 0.02  # share of the largest torque below which a knee is at zero
_CLOSE = 0.3  # relative distance below which two knees are one
_FEW = ((0.1, 0.3), (0.3, 0.7))  # of the largest torque: knees where no bend was found
_RISE = 1.05  # of slopes to start from that are one


def other_starts(values: Values, joint: int, largest_torque: float) -> Iterator[Values]:
    """Curves of three slopes near one that bends only once, or not at all.

    Parameters
    ----------
    values : dict
        Of the whole arm, where a search ended.
    joint : int
        Of a three-slope gear, from 1.
    largest_torque : float [N m]
        That it carries in the records.

    Yields
    ------
    dict
        The values with another curve; nothing if the curve bends twice.
    """
    slopes, knees = _bends(values, joint, largest_torque)
    if len(knees) == 2:
        return
    found: list[tuple[list[float], list[float]]] = []
    if knees:
        (low, high), (knee,) = slopes, knees
        between, beyond = float(np.sqrt(low * high)), 0.5 * (knee + largest_torque)
        found.append(([low, between, high], [0.75 * knee, min(1.5 * knee, beyond)]))
        found.append(([low, high, _RISE * high], [knee, beyond]))
        found.append(([low / _RISE, low, high], [0.5 * knee, knee]))
    else:
        spread = [slopes[0] / _RISE, slopes[0], slopes[0] * _RISE]
        found += [(spread, [share * largest_torque for share in shares]) for shares in _FEW]
    for curve, bends in found:
        named = dict(zip((*CURVE, *KNEES), (*curve, *bends), strict=True))
        yield {**values, **{(name, joint): value for name, value in named.items()}}


def _bends(values: Values, joint: int, largest: float) -> tuple[list[float], list[float]]:
    """The slopes that differ and lie within reach, and the knees between them."""
    slopes, knees = [values[CURVE[0], joint]], list[float]()
    for name, knee in zip(CURVE[1:], KNEES, strict=True):
        slope, torque = values[name, joint], values[knee, joint]
        if torque < _NOTHING * largest:
            slopes[-1] = slope
        elif torque < largest and abs(slope / slopes[-1] - 1.0) > _SAME:
            slopes.append(slope)
            knees.append(torque)
    if len(knees) == 2 and knees[1] < (1.0 + _CLOSE) * knees[0]:
        return [slopes[0], slopes[2]], [float(np.sqrt(knees[0] * knees[1]))]
    return slopes, knees
