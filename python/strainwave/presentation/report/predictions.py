"""Records over time: what was measured, what the model predicts, and what is between."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import Joint, Prediction
from strainwave.presentation.report.figures import (
    MEASURED,
    MODEL,
    MOST_POINTS,
    RESIDUAL,
    Figure,
    line,
    panels,
    place,
    rounded,
    thinned,
)

_UNITS = {"u": "V", "torque": "N m", "omega_m": "rad/s", "a": "m/s²"}
_STRAIGHT = {"u": "V", "torque": "N", "omega_m": "m/s", "a": "m/s²"}


def of_prediction(
    prediction: Prediction,
    joints: Sequence[Joint] = (),
    most: int = MOST_POINTS,
    channels: Sequence[str] = (),
) -> Figure:
    """A record's channels over time, one above the other: measured, predicted, and the difference.

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
    dict
        A plotly figure: `data` and `layout`.
    """
    data: list[Figure] = []
    names = channels or prediction.channels
    for k, channel in enumerate(names):
        column = prediction.channels.index(channel)
        measured, predicted = prediction.measured[:, column], prediction.predicted[:, column]
        pick = thinned(np.column_stack([measured, predicted, measured - predicted]), most)
        time = rounded(prediction.time[pick])
        looks = (
            (measured - predicted, "difference", RESIDUAL, "solid", 1.0),
            (measured, "measured", MEASURED, "solid", 2.5),
            (predicted, "model", MODEL, "6px,4px", 1.5),
        )
        for y, name, colour, dash, width in looks:
            drawn = line(time, y[pick], name, colour, dash=dash, width=width)
            data.append(drawn | place(k, name, first=k == 0))
    titles = [f"{name} [{unit_of(name, joints)}]" for name in names]
    return {"data": data, "layout": panels("time [s]", titles)}


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
