"""Plots as plain plotly dictionaries: building them needs no plotting library.

Colours are Okabe and Ito's, which the colour-blind can tell apart; measured is always dark blue,
the model always vermilion.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from strainwave.records import FloatArray, Prediction

MEASURED = "#0072B2"
MODEL = "#D55E00"
RESIDUAL = "#888888"
MOST_POINTS = 2000  # a trace with more is thinned: a screen is no wider

Figure = dict[str, Any]

_UNITS = {"u": "V", "torque": "N m", "omega_m": "rad/s", "a": "m/s^2"}


def time_fit(prediction: Prediction, channel: int) -> Figure:
    """One channel over time, measured and predicted, and their difference.

    Parameters
    ----------
    prediction : Prediction
    channel : int
        Column of the prediction.

    Returns
    -------
    dict
        A plotly figure: `data` and `layout`.
    """
    measured = prediction.measured[:, channel]
    predicted = prediction.predicted[:, channel]
    pick = thinned(prediction.time, measured)
    time = rounded(prediction.time[pick])
    unit = _UNITS.get(prediction.channels[channel].rstrip("0123456789"), "")
    return {
        "data": [
            line(time, measured[pick], "measured", MEASURED),
            line(time, predicted[pick], "model", MODEL, dash="4px,2px"),
            line(time, (measured - predicted)[pick], "difference", RESIDUAL, width=1),
        ],
        "layout": {
            "xaxis": {"title": {"text": "time [s]"}},
            "yaxis": {"title": {"text": f"{prediction.channels[channel]} [{unit}]"}},
        },
    }


def line(
    x: list[float | None],
    y: FloatArray,
    name: str,
    colour: str,
    *,
    dash: str = "solid",
    width: float = 1.5,
) -> Figure:
    """One trace of a figure."""
    return {
        "type": "scattergl" if len(x) > MOST_POINTS else "scatter",
        "mode": "lines",
        "name": name,
        "x": x,
        "y": rounded(y),
        "line": {"color": colour, "dash": dash, "width": width},
    }


def thinned(time: FloatArray, y: FloatArray) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Rows to draw: lowest and highest of each bin, so that no peak is lost; NaN stays a gap."""
    n = len(time)
    if n <= MOST_POINTS:
        return np.arange(n)
    edges = np.linspace(0, n, MOST_POINTS // 2 + 1).astype(np.intp)
    low, last = edges[:-1, None], edges[1:, None] - 1
    bins = np.minimum(low + np.arange(np.diff(edges).max()), last)  # short ones end in repetition
    inside = y[bins]
    gap = np.isnan(inside)
    least = np.argmin(np.where(gap, np.inf, inside), axis=1)
    most = np.argmax(np.where(gap, -np.inf, inside), axis=1)
    return np.unique(low[:, 0] + np.stack([least, most]))


def rounded(values: FloatArray) -> list[float | None]:
    """Numbers for a plot: to five digits of the largest, more than a screen shows; NaN is a gap."""
    finite = np.abs(values[np.isfinite(values)])
    scale = float(finite.max()) if finite.size else 0.0
    digits = 5 - int(np.floor(np.log10(scale))) if scale > 0 else 5
    shown: list[float | None] = np.round(values, digits).tolist()
    for gap in np.flatnonzero(~np.isfinite(values)).tolist():
        shown[gap] = None
    return shown
