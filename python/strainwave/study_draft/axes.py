"""Select the axis of a link sensor that measures the link's motion, and its sign."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray
from strainwave.study_draft.names import UNITS, ParsedName
from strainwave.study_draft.signal_features import relation

_MAX_REVERSED_CORRELATION = -0.5  # correlation below which the sensor's sign is reversed
_SI_UNITS = {"acceleration": "m/s^2", "gyro": "rad/s", "deflection": "rad"}  # quantity -> SI unit


def chosen_axis(
    columns: dict[str, FloatArray], quantity: str, angle: FloatArray | None, time: FloatArray
) -> tuple[str, float] | None:
    """Select the varying column that correlates best with the motor's motion.

    `columns` maps a name to (n_samples,) for one `quantity`: "acceleration", "gyro" or
    "deflection". `angle` is the motor angle, `time` is in s. Returns the column and its
    correlation, or None if no column varies.
    """
    varying = {name: values for name, values in columns.items() if np.ptp(values) > 0.0}
    correlations = {
        name: _motion_correlation(angle, values - values.mean(), quantity, time)
        for name, values in varying.items()
    }
    best = max(correlations, key=lambda name: abs(correlations[name]), default=None)
    return None if best is None else (best, correlations[best])


def scale_and_reason(each: ParsedName, quantity: str, r: float, columns: int) -> tuple[float, str]:
    """Return the signed factor to SI units and its reason.

    `r` is the correlation with the motor's motion, `columns` the number of candidate columns.
    """
    scale = UNITS[each.quantity or "gyro"].get(each.unit or "", 1.0)
    reason = ""
    if columns > 1:
        reason += f"; of {columns} columns the one that correlates with the motor (r = {r:.2f})"
    if r < _MAX_REVERSED_CORRELATION:
        scale, reason = -scale, f"{reason}; it points the other way, so the sign is turned"
    if each.unit is None:
        reason += f"; assumed unit {_SI_UNITS[quantity]}"
    return scale, reason


def _motion_correlation(
    angle: FloatArray | None, values: FloatArray, quantity: str, time: FloatArray
) -> float:
    if angle is None or quantity == "deflection":
        return 0.0
    motion = np.gradient(angle, time) if quantity == "acceleration" else angle
    return relation(values, motion, time)[0]
