"""Records over time: measured and predicted channels, with the residuals below each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import Joint, Prediction, channel_parts
from strainwave.domain.link_sensors import all_types
from strainwave.presentation.figures import (
    MAX_POINTS,
    Axis,
    Colour,
    Dash,
    Figure,
    Line,
    Panel,
    decimate,
)

_MODEL_DASH: Dash = (6.0, 4.0)  # the measured line shows through
_RESIDUAL_HEIGHT = 0.45  # of a residual panel relative to the panel above
_MOTOR_UNITS = {"u": "V", "torque": "N m", "theta_m": "rad", "omega_m": "rad/s", "ref": "rad/s"}
_MOTOR_UNITS |= {"temperature": "°C"}
_PRISMATIC_MOTOR_UNITS = _MOTOR_UNITS | {
    "torque": "N",
    "theta_m": "m",
    "omega_m": "m/s",
    "ref": "m/s",
}


def prediction_figure(
    prediction: Prediction,
    joints: Sequence[Joint] = (),
    limit: int = MAX_POINTS,
    channels: Sequence[str] = (),
) -> Figure:
    """Measured and predicted channels of a record over time, and the residuals of each.

    All channels are shown unless some are named. A line has at most `limit` points.
    """
    panels: list[Panel] = []
    for channel in channels or prediction.channels:
        column = prediction.channels.index(channel)
        measured, predicted = prediction.measured[:, column], prediction.predicted[:, column]
        residuals = measured - predicted
        rows = decimate(np.column_stack([measured, predicted, residuals]), limit)
        time = prediction.time[rows]
        both = (
            Line(time, measured[rows], "measured", Colour.MEASURED, width=2.5),
            Line(time, predicted[rows], "model", Colour.MODEL, _MODEL_DASH),
        )
        residual = Line(time, residuals[rows], "residual", Colour.RESIDUAL, width=1.0)
        unit = unit_of(channel, joints)
        panels.append(Panel(Axis(f"{channel} [{unit}]"), both))
        panels.append(Panel(Axis(f"residual [{unit}]"), (residual,), _RESIDUAL_HEIGHT))
    return Figure(Axis("time [s]"), tuple(panels))


def unit_of(channel: str, joints: Sequence[Joint] = ()) -> str:
    """The unit of a log channel such as `u1` or `omega_m2`; joints are revolute by default."""
    kind, number = channel_parts(channel)
    is_prismatic = 0 < number <= len(joints) and joints[number - 1].motion == "prismatic"
    for sensor in all_types():
        if kind in sensor.channel_kinds:
            prismatic = sensor.prismatic_unit or sensor.unit
            return (prismatic if is_prismatic else sensor.unit).replace("^2", "²")
    return (_PRISMATIC_MOTOR_UNITS if is_prismatic else _MOTOR_UNITS).get(kind, "")
