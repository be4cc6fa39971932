"""Records over time: what was measured and what the model predicts; below, the residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import Joint, Prediction
from strainwave.presentation.figures import (
    MEASURED,
    MODEL,
    MOST_POINTS,
    RESIDUAL,
    Axis,
    Dash,
    Figure,
    Line,
    Panel,
    thinned,
)

_WIDE: Dash = (6.0, 4.0)  # of the model, over what was measured
_RESIDUALS = 0.45  # height of a panel of residuals beside the one above it
_UNITS = {"u": "V", "torque": "N m", "omega_m": "rad/s", "a": "m/s²"}
_STRAIGHT = {"u": "V", "torque": "N", "omega_m": "m/s", "a": "m/s²"}


def of_prediction(
    prediction: Prediction,
    joints: Sequence[Joint] = (),
    most: int = MOST_POINTS,
    channels: Sequence[str] = (),
) -> Figure:
    """A record's channels over time: measured and predicted, and beneath each its residuals.

    Parameters
    ----------
    prediction : Prediction
    joints : sequence of Joint
        Of the arm: a prismatic one has other units.
    most : int
        Points of a line.
    channels : sequence of str
        Those to show; all where none is named.

    Returns
    -------
    Figure
    """
    panels: list[Panel] = []
    for channel in channels or prediction.channels:
        column = prediction.channels.index(channel)
        measured, predicted = prediction.measured[:, column], prediction.predicted[:, column]
        residuals = measured - predicted
        pick = thinned(np.column_stack([measured, predicted, residuals]), most)
        time = prediction.time[pick]
        both = (
            Line(time, measured[pick], "measured", MEASURED, width=2.5),
            Line(time, predicted[pick], "model", MODEL, _WIDE),
        )
        beneath = Line(time, residuals[pick], "residuals", RESIDUAL, width=1.0)
        panels.append(Panel(Axis(f"{channel} [{unit_of(channel, joints)}]"), both))
        panels.append(Panel(Axis(""), (beneath,), _RESIDUALS))
    return Figure(Axis("time [s]"), tuple(panels))


def unit_of(channel: str, joints: Sequence[Joint] = ()) -> str:
    """The unit of a log's channel.

    Parameters
    ----------
    channel : str
        `u1`, `omega_m2`, ...
    joints : sequence of Joint
        Revolute where there are none.

    Returns
    -------
    str
    """
    kind = channel.rstrip("0123456789")
    number = int(channel[len(kind) :] or 1)
    straight = number <= len(joints) and joints[number - 1].motion == "prismatic"
    return (_STRAIGHT if straight else _UNITS).get(kind, "")
