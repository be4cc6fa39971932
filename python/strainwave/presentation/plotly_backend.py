"""Figures -> plotly's dictionaries, as the report's page draws them; needs no plotting library."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.presentation.figures import (
    RESIDUAL,
    SOLID,
    TICKS,
    Axis,
    Band,
    Bars,
    Dash,
    Figure,
    HeatMap,
    Line,
    Mark,
    Markers,
    Upright,
)

_BETWEEN = 0.08  # of the height of one panel, left free above the next
_FEW = 3  # panels: where there are more, units have a line of their own
_TICKS = 3  # of a low panel, or they would touch
_LOW = 0.6  # height of a panel, from which it is not low
_LETTERS = 10  # pixels high, so that thirty names of a heat map stand one below the other
_OPACITY = 0.18  # of a band
_THIN = 1.2  # [px] of an error bar


def plotly(figure: Figure) -> dict[str, Any]:
    """A figure as plotly draws it.

    Colours of lines are those of the light page; the page exchanges them where it is dark.

    Parameters
    ----------
    figure : Figure

    Returns
    -------
    dict
        `data` and `layout`.
    """
    domains = _domains([panel.height for panel in figure.panels])
    legend = figure.legend
    numbers = _Numbers()
    data, seen = [], set()
    for k, panel in enumerate(figure.panels):
        for mark in panel.marks:
            trace = _trace(mark, numbers) | {"yaxis": f"y{_number(k)}"}
            name = trace.get("name")
            if name is not None:
                first = name in legend and name not in seen and not isinstance(mark, Band)
                trace |= {"legendgroup": name, "showlegend": first}
                seen |= {name} if first else set()
            data.append(trace)
    layout: dict[str, Any] = {"xaxis": _horizontal(figure.x) | {"anchor": f"y{_number(k)}"}}
    for k, (panel, domain) in enumerate(zip(figure.panels, domains, strict=True)):
        layout[f"yaxis{_number(k)}"] = own = _axis(panel.axis) | {"domain": domain}
        if len(domains) > _FEW:
            own["title"]["text"] = panel.axis.title.replace(" [", "<br>[")
        if panel.height < _LOW:
            own["nticks"] = _TICKS
    if figure.uprights:
        layout["shapes"] = [_line(one) for one in figure.uprights]
        layout["annotations"] = [
            _words(one, domains[one.panel], log=figure.x.log) for one in figure.uprights if one.text
        ]
    for mark in figure.marks:
        if isinstance(mark, HeatMap):
            _name_all(layout, mark)
        elif isinstance(mark, Markers) and isinstance(mark.x, tuple):
            layout["xaxis"]["tickangle"] = -90
    return {"data": data, "layout": layout}


class _Numbers:
    """Arrays as lists; one that several marks share is converted once."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[FloatArray, list[float | None]]] = {}

    def __call__(self, values: FloatArray) -> list[float | None]:
        key = id(values)
        if key not in self._known:
            self._known[key] = values, rounded(values)
        return self._known[key][1]


def rounded(values: FloatArray) -> list[float | None]:
    """Numbers for a plot: to five digits of the largest, more than a screen shows; NaN is a gap.

    Parameters
    ----------
    values : (n,)

    Returns
    -------
    list of float or None
    """
    finite = np.isfinite(values)
    scale = float(np.abs(values).max(initial=0.0, where=finite))
    digits = 5 - math.floor(math.log10(scale)) if scale > 0.0 else 5
    shown: list[float | None] = np.round(values, digits).tolist()
    if not finite.all():
        for gap in np.flatnonzero(~finite).tolist():
            shown[gap] = None
    return shown


def _trace(mark: Mark, numbers: _Numbers) -> dict[str, Any]:
    if isinstance(mark, Line | Markers):
        return _points(mark, numbers)
    if isinstance(mark, Band):
        return _band(mark, numbers)
    if isinstance(mark, Bars):
        return {
            "type": "bar",
            "name": mark.name,
            "x": numbers(mark.x),
            "y": numbers(mark.y),
            "width": mark.width,
            "marker": {"color": mark.colour},
        }
    return {
        "type": "heatmap",
        "x": list(mark.names),
        "y": list(mark.names),
        "z": np.round(mark.values, 3).tolist(),
        "zmin": mark.low,
        "zmax": mark.high,
        "colorscale": [[0.5 * k, colour] for k, colour in enumerate(mark.colours)],
    }


def _points(mark: Line | Markers, numbers: _Numbers) -> dict[str, Any]:
    """A line, points, or both, with error bars where there are any."""
    trace: dict[str, Any] = {
        "type": "scatter",
        "name": mark.name,
        "x": list(mark.x) if isinstance(mark.x, tuple) else numbers(mark.x),
        "y": numbers(mark.y),
    }
    if isinstance(mark, Line):
        trace["mode"] = "lines+markers" if mark.size else "lines"
        trace["line"] = {"color": mark.colour, "dash": _dash(mark.dash), "width": mark.width}
    else:
        trace["mode"] = "markers"
    if mark.size:
        trace["marker"] = {"color": mark.colour, "size": mark.size}
    if isinstance(mark, Markers) and mark.opacity < 1.0:
        trace["marker"]["opacity"] = mark.opacity
    if mark.error is not None:
        bars = {"type": "data", "array": numbers(mark.error)}
        trace["error_y"] = bars | {"color": mark.colour, "thickness": _THIN}
    return trace


def _band(mark: Band, numbers: _Numbers) -> dict[str, Any]:
    """An outline: there along the lower edge, back along the upper."""
    red, green, blue = (int(mark.colour[k : k + 2], 16) for k in (1, 3, 5))
    x = numbers(mark.x)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": mark.name,
        "x": x + x[::-1],
        "y": rounded(np.concatenate([mark.low, mark.high[::-1]])),
        "fill": "toself",
        "fillcolor": f"rgba({red},{green},{blue},{_OPACITY})",
        "line": {"width": 0},
        "hoverinfo": "skip",
    }


def _axis(axis: Axis) -> dict[str, Any]:
    found: dict[str, Any] = {"title": {"text": axis.title}}
    if axis.log:
        found |= {"type": "log", "exponentformat": "power"}  # or 0.01 stands beside 100µ
    if axis.range is not None:
        found["range"] = list(axis.range)
    if axis.step is not None:
        found["dtick"] = axis.step
    return found


def _horizontal(axis: Axis) -> dict[str, Any]:
    """The shared axis: on a logarithmic one each tick has its whole label."""
    ticks = {"tickvals": list(TICKS), "ticktext": list(TICKS.values())} if axis.log else {}
    return _axis(axis) | ticks


def _domains(heights: Sequence[float]) -> list[list[float]]:
    """Lower and upper edge of each panel, as shares of the figure."""
    share = np.array(heights, dtype=float)
    free = _BETWEEN / len(heights)
    share *= (1.0 - free * (len(heights) - 1)) / share.sum()
    found, top = [], 1.0
    for height in share.tolist():
        bottom = max(0.0, top - height)
        found.append([round(bottom, 4), round(top, 4)])
        top = bottom - free
    return found


def _line(one: Upright) -> dict[str, Any]:
    look = {"color": RESIDUAL, "width": 1, "dash": _dash(one.dash)}
    ends = {"x0": one.x, "x1": one.x, "y0": 0, "y1": 1}
    return {"type": "line", "xref": "x", "yref": "paper", **ends, "line": look}


def _words(one: Upright, domain: Sequence[float], *, log: bool) -> dict[str, Any]:
    """Words beside an upright line; on a logarithmic axis they stand at the logarithm."""
    low, high = domain
    return {
        "xref": "x",
        "yref": "paper",
        "x": float(np.log10(one.x)) if log else one.x,
        "y": low + one.height * (high - low),
        "text": one.text,
        "xanchor": "right" if one.before else "left",
        "yanchor": "top",
        "showarrow": False,
    }


def _name_all(layout: dict[str, Any], mark: HeatMap) -> None:
    """Every name is written, with room for the longest."""
    every = {"dtick": 1, "tickfont": {"size": _LETTERS}}
    layout["yaxis"] |= {"autorange": "reversed", **every}
    layout["xaxis"] |= {"tickangle": -90, **every}
    room = 10 + round(0.6 * _LETTERS * max(len(name) for name in mark.names))
    layout["margin"] = {"l": room, "b": room}


def _dash(dash: Dash) -> str:
    return "solid" if dash == SOLID else ",".join(f"{length:g}px" for length in dash)


def _number(panel: int) -> str:
    return str(panel + 1) if panel else ""
