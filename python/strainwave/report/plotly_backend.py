"""Figures as Plotly JSON, which the report's page draws; needs no plotting library."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import cycle
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.report import figures
from strainwave.report.figures import Area, Axis, Colour, Dash, Figure, Line, Mark, Markers, Panel
from strainwave.report.figures.curves import Series

_Numbers = Callable[[FloatArray], "list[float | None]"]

_PANEL_GAP = 0.08  # free height between panels, as a share of a panel
_MAX_PANELS_WITH_LONG_TITLES = 3  # with more panels, the unit goes to a second line
_LOW_PANEL_HEIGHT = 0.6  # panels below this height have few ticks
_LOW_PANEL_TICKS = 3  # more tick labels would overlap
_MAX_DECADES_WITH_DIGITS = 1.5  # over a wider range, 2 and 5 between the decades are clutter
_HEAT_MAP_FONT_SIZE = 10  # [px] thirty names fit one below the other
_BAND_OPACITY = 0.18
_FADED_OPACITY = 0.55
_ERROR_BAR_WIDTH = 1.2  # [px]
# [px] of a figure with a row per name: around all rows, of a row, and of each of its dots
_WHISKER_MARGIN, _WHISKER_ROW, _WHISKER_STEP = 90, 12, 9
_SYMBOL_LINE_WIDTH = 1.5  # [px]
_SYMBOLS = {"x": "x-thin-open", "circle-open": "circle-open"}
_MAX_DIGITS, _LARGEST = 290, 1e300  # so that rounding does not overflow
_SIGNIFICANT_DIGITS = 5  # of the largest value, on log axes of each: more than a screen resolves


def plotly(figure: Figure) -> dict[str, Any]:
    """The `data` and `layout` of a figure.

    Colours are those of the light page; the page's script replaces them in dark mode.
    """
    domains = _domains([panel.height for panel in figure.panels])
    legend = figure.legend
    has_log_axis = figure.x.log or any(panel.axis.log for panel in figure.panels)
    lists: dict[int, list[float | None]] = {}

    def numbers(values: FloatArray) -> list[float | None]:
        """An array as a list; one that several marks share is converted once."""
        if id(values) not in lists:
            lists[id(values)] = rounded(values, of_each=has_log_axis)
        return lists[id(values)]

    data, legend_names = [], set()
    for k, panel in enumerate(figure.panels):
        for mark in panel.marks:
            trace = _trace(mark, numbers) | {"yaxis": f"y{_number(k)}"}
            name = trace.get("name")
            if name is not None:
                first = name in legend and name not in legend_names and not isinstance(mark, Area)
                trace |= {"legendgroup": name, "showlegend": first}
                legend_names |= {name} if first else set()
            data.append(trace)
    layout: dict[str, Any] = {"xaxis": _horizontal(figure.x) | {"anchor": f"y{_number(k)}"}}
    for k, (panel, domain) in enumerate(zip(figure.panels, domains, strict=True)):
        layout[f"yaxis{_number(k)}"] = axis = _axis(panel.axis) | {"domain": domain}
        if figure.has_equal_scales:
            axis |= {"scaleanchor": "x"}
        if len(domains) > _MAX_PANELS_WITH_LONG_TITLES:
            axis["title"]["text"] = panel.axis.title.replace(" [", "<br>[")
        if panel.axis.log and _decades(panel) > _MAX_DECADES_WITH_DIGITS:
            axis["dtick"] = 1
        if panel.height < _LOW_PANEL_HEIGHT:
            axis["nticks"] = _LOW_PANEL_TICKS
    if figure.uprights:
        layout["shapes"] = [
            {"type": "line", "xref": "x", "yref": "paper"}
            | {"x0": line.x, "x1": line.x, "y0": 0, "y1": 1}
            | {"line": {"color": Colour.RESIDUAL, "width": 1, "dash": _dash(line.dash)}}
            for line in figure.uprights
        ]
        layout["annotations"] = [
            _label(line, domains[line.panel], log=figure.x.log)
            for line in figure.uprights
            if line.text
        ]
    for mark in figure.marks:
        if isinstance(mark, figures.HeatMap):
            # every row and column has its name, and the margin has room for the longest
            every = {"dtick": 1, "tickfont": {"size": _HEAT_MAP_FONT_SIZE}}
            layout["yaxis"] |= {"autorange": "reversed", **every}
            layout["xaxis"] |= {"tickangle": -90, **every}
            room = 10 + round(0.6 * _HEAT_MAP_FONT_SIZE * max(map(len, mark.names)))
            layout["margin"] = {"l": room, "b": room}
        elif isinstance(mark, Markers) and isinstance(mark.x, tuple):
            layout["xaxis"]["tickangle"] = -90
    return {"data": data, "layout": layout}


def whiskers(
    rows: tuple[Sequence[str], Sequence[str]], series: Sequence[Series], title: str
) -> dict[str, Any]:
    """Horizontal dots with error bars: one row per name, by groups, with all series beside it.

    `rows` are the groups and the names; the x of a series is its dots, y the half-lengths of the
    bars.
    """
    data = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": one.name,
            "x": rounded(one.x, of_each=True),
            "y": list(map(list, rows)),
            "error_x": {"type": "data", "array": rounded(one.y, of_each=True), "width": 3},
            "marker": {"color": colour, "size": 6},
        }
        for one, colour in zip(series, cycle(figures.PALETTE), strict=False)
    ]
    height = _WHISKER_MARGIN + (_WHISKER_ROW + _WHISKER_STEP * len(series)) * len(rows[1])
    names = {"type": "multicategory", "autorange": "reversed", "tickfont": {"size": 10}}
    axes = {"xaxis": {"title": {"text": title}, "zeroline": True}, "yaxis": names}
    return {"data": data, "layout": {**axes, "scattermode": "group", "height": height}}


def faded(figure: dict[str, Any], name: str) -> dict[str, Any]:
    """The figure with all lines faint and dashed but those of a name, which are solid."""
    for trace in figure["data"]:
        if trace.get("name") != name:
            trace["opacity"] = _FADED_OPACITY
        if "fill" not in trace:
            trace["line"]["dash"] = "solid" if trace.get("name") == name else "6px,4px"
    return figure


def rounded(values: FloatArray, *, of_each: bool = False) -> list[float | None]:
    """Values rounded to five digits of their range, or of each; None for one that is not finite."""
    finite = np.isfinite(values)
    if of_each:
        return [
            float(f"{value:.{_SIGNIFICANT_DIGITS}g}") if is_finite else None
            for value, is_finite in zip(values.tolist(), finite.tolist(), strict=True)
        ]
    shown = values[finite]
    with np.errstate(over="ignore"):  # of a range of 1e308 and more
        scale = float(np.ptp(shown)) if len(shown) else 0.0
    scale = min(scale or float(np.abs(shown).max(initial=0.0)), _LARGEST)
    digits = _SIGNIFICANT_DIGITS - (math.floor(math.log10(scale)) if scale > 0.0 else 0)
    numbers: list[float | None] = np.round(
        np.where(finite, values, 0.0), min(digits, _MAX_DIGITS)
    ).tolist()
    for gap in np.flatnonzero(~finite).tolist():
        numbers[gap] = None
    return numbers


def _trace(mark: Mark, numbers: _Numbers) -> dict[str, Any]:
    if isinstance(mark, Line | Markers):
        return _points(mark, numbers)
    if isinstance(mark, Area):
        return _band(mark, numbers)
    if isinstance(mark, figures.Bars):
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
    trace: dict[str, Any] = {
        "type": "scatter",
        "name": mark.name,
        "x": list(mark.x) if isinstance(mark.x, tuple) else numbers(mark.x),
        "y": numbers(mark.y),
    }
    if isinstance(mark, Line):
        trace["mode"] = "lines+markers" if mark.size else "lines"
        # simplification displaces the corners of a flat polyline by tens of pixels
        style = {"dash": _dash(mark.dash), "width": mark.width, "simplify": False}
        trace["line"] = {"color": mark.colour} | style
    else:
        trace["mode"] = "markers"
    if mark.size:
        trace["marker"] = {"color": mark.colour, "size": mark.size}
    if isinstance(mark, Markers):
        if mark.labels:
            position = "top right" if mark.is_above else "bottom right"
            label = {"text": list(mark.labels), "textposition": position, "cliponaxis": False}
            trace |= {"mode": "markers+text", **label}
        trace["marker"] |= {"opacity": mark.opacity} if mark.opacity < 1.0 else {}
        if mark.symbol != "circle":
            line = {"width": _SYMBOL_LINE_WIDTH}
            trace["marker"] |= {"symbol": _SYMBOLS[mark.symbol], "line": line}
    if mark.error is not None:
        bars = {"type": "data", "array": numbers(mark.error)}
        trace["error_y"] = bars | {"color": mark.colour, "thickness": _ERROR_BAR_WIDTH}
    return trace


def _band(mark: Area, numbers: _Numbers) -> dict[str, Any]:
    """A closed outline: along the lower edge and back along the upper edge."""
    red, green, blue = (int(mark.colour[k : k + 2], 16) for k in (1, 3, 5))
    x = numbers(mark.x)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": mark.name,
        "x": x + x[::-1],
        "y": numbers(mark.low) + numbers(mark.high)[::-1],
        "fill": "toself",
        "fillcolor": f"rgba({red},{green},{blue},{_BAND_OPACITY})",
        "line": {"width": 0, "color": mark.colour},
        "hoverinfo": "skip",
    }


def _axis(axis: Axis) -> dict[str, Any]:
    layout: dict[str, Any] = {"title": {"text": axis.title}}
    if axis.log:
        layout |= {"type": "log", "exponentformat": "power"}  # the default mixes 0.01 and 100µ
    if axis.range is not None:
        layout["range"] = list(axis.range)
    if axis.step is not None:
        layout["dtick"] = axis.step
    return layout


def _decades(panel: Panel) -> float:
    lines = [mark.y for mark in panel.marks if not isinstance(mark, Area | figures.HeatMap)]
    y = np.concatenate(lines) if lines else np.zeros(0)
    y = y[np.isfinite(y) & (y > 0.0)]
    return float(np.ptp(np.log10(y))) if len(y) else 0.0


def _horizontal(axis: Axis) -> dict[str, Any]:
    """The shared axis; a logarithmic one has complete labels at 1, 2 and 5."""
    if not axis.log:
        return _axis(axis)
    ticks = {
        "tickvals": list(figures.FREQUENCY_TICKS),
        "ticktext": list(figures.FREQUENCY_TICKS.values()),
    }
    return _axis(axis) | ticks


def _domains(heights: Sequence[float]) -> list[list[float]]:
    share = np.array(heights, dtype=float)
    free = _PANEL_GAP / len(heights)
    share *= (1.0 - free * (len(heights) - 1)) / share.sum()
    domains, top = [], 1.0
    for height in share.tolist():
        bottom = max(0.0, top - height)
        domains.append([round(bottom, 4), round(top, 4)])
        top = bottom - free
    return domains


def _label(line: figures.Upright, domain: Sequence[float], *, log: bool) -> dict[str, Any]:
    """The label of a vertical line; Plotly places it at the logarithm on a logarithmic axis."""
    low, high = domain
    return {
        "xref": "x",
        "yref": "paper",
        "x": float(np.log10(line.x)) if log else line.x,
        "y": low + line.height * (high - low),
        "text": line.text,
        "xanchor": "right" if line.before else "left",
        "yanchor": "top",
        "showarrow": False,
    }


def _dash(dash: Dash) -> str:
    return "solid" if dash == figures.SOLID else ",".join(f"{length:g}px" for length in dash)


def _number(panel: int) -> str:
    return str(panel + 1) if panel else ""
