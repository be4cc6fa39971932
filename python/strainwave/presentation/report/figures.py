"""Plots as plain plotly dictionaries: building them needs no plotting library.

Colours are Okabe and Ito's, which the colour-blind can distinguish; measured is always dark blue,
the model always vermilion. The page exchanges colours where it is dark;
`strainwave.presentation.matplotlib_backend` draws the same dictionaries without a browser, and
knows what is used here and no more.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from strainwave.domain import FloatArray, IntArray

MEASURED = "#0072B2"
MODEL = "#D55E00"
LINEAR = "#009E73"
TUNED = "#CC79A7"
RESIDUAL = "#888888"
MOST_POINTS = 1200  # of a line; one with more is thinned: a screen is no wider

Figure = dict[str, Any]

_BETWEEN = 0.08  # of the height of one panel, left free above the next


def _engineering(value: float) -> str:
    """A number with the prefix of its thousand: 500m, 2, 10k."""
    exponent = int(np.floor(np.log10(value) / 3.0 + 1e-9))
    prefix = {-3: "n", -2: "µ", -1: "m", 0: "", 1: "k", 2: "M"}[exponent]
    return f"{value / 1e3**exponent:g}{prefix}"


_TICKS = [float(f"{one}e{decade}") for decade in range(-6, 7) for one in (1, 2, 5)]
TICKS = {value: _engineering(value) for value in _TICKS}
"""Of logarithmic axes, each with its whole label."""


def panels(
    axis: str, titles: Sequence[str], *, log: bool = False, heights: Sequence[float] = ()
) -> Figure:
    """A layout of panels one above the other over one horizontal axis.

    Parameters
    ----------
    axis : str
        Title of the horizontal axis, with unit.
    titles : sequence of str
        Of the vertical axes, from the top.
    log : bool
        Whether the horizontal axis is logarithmic.
    heights : sequence of float
        One a panel; alike if not given.

    Returns
    -------
    dict
    """
    share = np.array(heights or [1.0] * len(titles), dtype=float)
    free = _BETWEEN / len(titles)
    share *= (1.0 - free * (len(titles) - 1)) / share.sum()
    layout: Figure = {"xaxis": {"title": {"text": axis}, "anchor": axis_name(len(titles) - 1)}}
    if log:
        layout["xaxis"] |= {
            "type": "log",
            "tickvals": list(TICKS),
            "ticktext": list(TICKS.values()),
        }
    top = 1.0
    for k, (title, height) in enumerate(zip(titles, share.tolist(), strict=True)):
        bottom = max(0.0, top - height)
        layout[f"yaxis{_number(k)}"] = {
            "title": {"text": title},
            "domain": [round(bottom, 4), round(top, 4)],
        }
        top = bottom - free
    return layout


def place(panel: int, name: str, *, first: bool) -> Figure:
    """What puts a trace into a panel, with one entry of the legend for all of its name.

    Parameters
    ----------
    panel : int
        From the top, from 0.
    name : str
    first : bool
        Whether this trace is the one in the legend.

    Returns
    -------
    dict
    """
    return {"yaxis": axis_name(panel), "legendgroup": name, "showlegend": first}


def axis_name(panel: int) -> str:
    """How a trace names a panel's vertical axis: y, y2, ..."""
    return f"y{_number(panel)}"


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
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": x,
        "y": rounded(y),
        "line": {"color": colour, "dash": dash, "width": width},
    }


def dots(x: list[float | None], y: FloatArray, name: str, colour: str, *, size: int = 4) -> Figure:
    """Points that no line joins."""
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": x,
        "y": rounded(y),
        "marker": {"color": colour, "size": size},
    }


def band(x: list[float | None], low: FloatArray, high: FloatArray, colour: str) -> Figure:
    """The 95 % band around a line.

    Parameters
    ----------
    x : list of float
    low, high : (n_points,)
    colour : str
        Of the line.

    Returns
    -------
    dict
    """
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return {
        "type": "scatter",
        "mode": "lines",
        "x": x + x[::-1],
        "y": rounded(np.concatenate([low, high[::-1]])),
        "fill": "toself",
        "fillcolor": f"rgba({red},{green},{blue},0.18)",
        "line": {"width": 0},
        "hoverinfo": "skip",
        "showlegend": False,
        "name": "95 %",
    }


def upright(
    x: float,
    text: str,
    *,
    height: float = 1.0,
    before: bool = False,
    log: bool = False,
    dash: str = "dot",
) -> Figure:
    """A vertical line through all panels, with words beside it: `shapes` and `annotations`.

    Parameters
    ----------
    x : float
    text : str
        Empty: the line alone.
    height : float
        Of the words' upper edge, as a share of the figure.
    before : bool
        Whether the words stand left of the line, not right of it.
    log : bool
        Whether the horizontal axis is logarithmic: words then stand at the logarithm.
    dash : str

    Returns
    -------
    dict
    """
    shape = {
        "type": "line",
        "xref": "x",
        "yref": "paper",
        "x0": x,
        "x1": x,
        "y0": 0,
        "y1": 1,
        "line": {"color": RESIDUAL, "width": 1, "dash": dash},
    }
    word = {
        "xref": "x",
        "yref": "paper",
        "x": float(np.log10(x)) if log else x,
        "y": height,
        "text": text,
        "xanchor": "right" if before else "left",
        "yanchor": "top",
        "showarrow": False,
    }
    return {"shapes": [shape], "annotations": [word] if text else []}


def marked(layout: Figure, marks: Sequence[Figure]) -> Figure:
    """A layout with several `upright` lines.

    Parameters
    ----------
    layout : dict
    marks : sequence of dict

    Returns
    -------
    dict
    """
    parts = {
        kind: [part for mark in marks for part in mark[kind]] for kind in ("shapes", "annotations")
    }
    return layout | parts


def thinned(y: FloatArray, most: int = MOST_POINTS) -> IntArray:
    """Rows to draw: lowest and highest of each bin, so that no peak is lost; NaN stays a gap.

    Parameters
    ----------
    y : (n_samples,) or (n_samples, n_lines)
        Of several lines that share their rows, each keeps its own peaks.
    most : int
        Rows, about.

    Returns
    -------
    (n_rows,)
    """
    columns = y.reshape(len(y), -1)
    n, count = columns.shape
    if n <= most:
        return np.arange(n)
    edges = np.linspace(0, n, max(1, most // (2 * count)) + 1).astype(np.intp)
    low, last = edges[:-1, None], edges[1:, None] - 1
    bins = np.minimum(low + np.arange(np.diff(edges).max()), last)  # short ones end in repetition
    inside = columns[bins]
    gap = np.isnan(inside)
    least = np.argmin(np.where(gap, np.inf, inside), axis=1)
    greatest = np.argmax(np.where(gap, -np.inf, inside), axis=1)
    return np.unique(low + np.hstack([least, greatest]))


def rounded(values: FloatArray) -> list[float | None]:
    """Numbers for a plot: to five digits of the largest, more than a screen shows; NaN is a gap."""
    finite = np.abs(values[np.isfinite(values)])
    scale = float(finite.max()) if finite.size else 0.0
    digits = 5 - int(np.floor(np.log10(scale))) if scale > 0 else 5
    shown: list[float | None] = np.round(values, digits).tolist()
    for gap in np.flatnonzero(~np.isfinite(values)).tolist():
        shown[gap] = None
    return shown


def decibel(size: FloatArray) -> FloatArray:
    """20 log10 of a modulus; of nothing, very little."""
    return np.asarray(20.0 * np.log10(np.maximum(size, 1e-300)))


def _number(panel: int) -> str:
    return str(panel + 1) if panel else ""
