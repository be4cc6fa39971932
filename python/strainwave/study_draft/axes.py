"""Sensors on a link: which of their axes sees its motion, and which way round."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray
from strainwave.study_draft.names import UNITS, Named
from strainwave.study_draft.signal_features import relation

_OPPOSITE = -0.5  # correlation below which a sensor points the other way
_SI = {"acceleration": "m/s^2", "gyro": "rad/s", "deflection": "rad"}


def chosen_axis(
    columns: dict[str, FloatArray], quantity: str, angle: FloatArray | None, time: FloatArray
) -> tuple[str, float] | None:
    """The column that goes with the motor's motion, of those that change; None: none does.

    Parameters
    ----------
    columns : dict of str to (n_samples,)
        Of one quantity.
    quantity : "acceleration", "gyro" or "deflection"
    angle : (n_samples,), optional
        Of the motor.
    time : (n_samples,) [s]

    Returns
    -------
    (str, float) or None
        The column, and its correlation with the motion it should see.
    """
    alive = {name: values for name, values in columns.items() if np.ptp(values) > 0.0}
    scored = {
        name: _goes_with(angle, values - values.mean(), quantity, time)
        for name, values in alive.items()
    }
    best = max(scored, key=lambda name: abs(scored[name]), default=None)
    return None if best is None else (best, scored[best])


def scale_and_reason(each: Named, quantity: str, r: float, columns: int) -> tuple[float, str]:
    """Factor to SI, with its sign, and what to say.

    Parameters
    ----------
    each : Named
    quantity : "acceleration", "gyro" or "deflection"
    r : float
        Correlation with the motion.
    columns : int
        That there were to choose from.

    Returns
    -------
    float
    str
    """
    scale = UNITS[each.quantity or "gyro"].get(each.unit or "", 1.0)
    why = ""
    if columns > 1:
        why += f"; of {columns} columns the one that goes with the motor (r = {r:.2f})"
    if r < _OPPOSITE:
        scale, why = -scale, f"{why}; it points the other way, so the sign is turned"
    if each.unit is None:
        why += f"; unit taken as {_SI[quantity]}"
    return scale, why


def _goes_with(
    angle: FloatArray | None, values: FloatArray, quantity: str, time: FloatArray
) -> float:
    if angle is None or quantity == "deflection":
        return 0.0
    seen = np.gradient(angle, time) if quantity == "acceleration" else angle
    return relation(values, seen, time)[0]
