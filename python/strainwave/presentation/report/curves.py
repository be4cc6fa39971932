"""Figures of the comparisons: responses, lines over time, spectra, points with error bars.

No two lines of a figure look alike: colours are Okabe and Ito's, and every colour has its dash. The
truth is grey and wide, and lies below the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import ComplexArray, FloatArray
from strainwave.presentation.report.figures import (
    MEASURED,
    MODEL,
    RESIDUAL,
    Figure,
    band,
    decibel,
    line,
    panels,
    place,
    rounded,
    thinned,
)

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
DASHES = ("solid", "6px,3px", "2px,2px", "8px,3px,2px,3px", "10px,4px", "4px,2px,1px,2px")
TRUTH = RESIDUAL
_REACH = 1.96  # of a 95 % band, in deviations


@dataclass(frozen=True, slots=True)
class Curve:
    """One frequency response by name."""

    name: str
    frequencies_hz: FloatArray  # (n_frequencies,)
    response: ComplexArray  # (n_frequencies,)
    magnitude_std: FloatArray | None = None  # of the modulus; None: no band is drawn
    phase_std: FloatArray | None = None  # [rad]
    true: bool = False  # drawn grey and wide, below the others


@dataclass(frozen=True, slots=True)
class Series:
    """One line over a common axis, by name."""

    name: str
    x: FloatArray
    y: FloatArray
    true: bool = False


@dataclass(frozen=True, slots=True)
class Points:
    """Points with error bars, or a line without, by name."""

    name: str
    x: FloatArray
    y: FloatArray
    std: FloatArray | None = None
    true: bool = False


def bode(curves: Sequence[Curve], caption: str) -> Figure:
    """Magnitude [dB] over phase [degree] of several responses, with their 95 % bands.

    Parameters
    ----------
    curves : sequence of Curve
    caption : str
        Stands above the figure.

    Returns
    -------
    dict
        A plotly figure; its caption is `layout.meta`.
    """
    data: list[Figure] = []
    for curve, (colour, dash, width) in zip(curves, _looks([c.true for c in curves]), strict=True):
        frequency = rounded(curve.frequencies_hz)
        size = np.abs(curve.response)
        phase = np.rad2deg(np.unwrap(np.angle(curve.response)))
        phase = phase - 360.0 * np.round(phase[len(phase) // 2] / 360.0)
        if curve.magnitude_std is not None:
            reach = _REACH * curve.magnitude_std
            low = np.maximum(size - reach, 1e-2 * size)  # a band down to zero has no bottom in dB
            edges = decibel(low), decibel(size + reach)
            drawn = band(frequency, *edges, colour)
            data.append(drawn | place(0, curve.name, first=False))
        if curve.phase_std is not None:
            reach = np.minimum(np.rad2deg(_REACH * curve.phase_std), 180.0)
            drawn = band(frequency, phase - reach, phase + reach, colour)
            data.append(drawn | place(1, curve.name, first=False))
        for panel, y in enumerate((decibel(size), phase)):
            drawn = line(frequency, y, curve.name, colour, dash=dash, width=width)
            data.append(drawn | place(panel, curve.name, first=panel == 0))
    layout = panels("frequency [Hz]", ["magnitude [dB]", "phase [°]"], log=True)
    layout["yaxis2"]["dtick"] = 90
    return {"data": data, "layout": {"meta": caption} | layout}


def pair(measured: Series, model: Series, quantity: str, caption: str) -> Figure:
    """What was measured over time, the model's answer, and their difference.

    Parameters
    ----------
    measured, model : Series
        On one time base [s].
    quantity : str
        With its unit, of the vertical axis.
    caption : str

    Returns
    -------
    dict
    """
    pick = thinned(np.column_stack([measured.y, model.y, measured.y - model.y]))
    time = rounded(measured.x[pick])
    return {
        "data": [
            line(time, measured.y[pick], measured.name, MEASURED),
            line(time, model.y[pick], model.name, MODEL, dash="4px,2px"),
            line(time, (measured.y - model.y)[pick], "difference", RESIDUAL, width=1),
        ],
        "layout": _axes("time [s]", quantity, caption),
    }


def lines(series: Sequence[Series], axis: str, quantity: str, caption: str) -> Figure:
    """Several lines over one axis.

    Parameters
    ----------
    series : sequence of Series
    axis, quantity : str
        Titles of the axes, with units.
    caption : str

    Returns
    -------
    dict
    """
    data = []
    for one, (colour, dash, width) in zip(series, _looks([s.true for s in series]), strict=True):
        pick = thinned(one.y)
        data.append(
            line(rounded(one.x[pick]), one.y[pick], one.name, colour, dash=dash, width=width)
        )
    return {"data": data, "layout": _axes(axis, quantity, caption)}


def spectrum(series: Sequence[Series], quantity: str, caption: str) -> Figure:
    """Power spectral densities in dB over the logarithm of frequency.

    Parameters
    ----------
    series : sequence of Series
        Densities, not their logarithms, over Hz; lines at 0 Hz are left out.
    quantity : str
        Unit of the density.
    caption : str

    Returns
    -------
    dict
    """
    inside = [Series(s.name, s.x[s.x > 0.0], 0.5 * decibel(s.y[s.x > 0.0]), s.true) for s in series]
    figure = lines(inside, "frequency [Hz]", f"density [dB re {quantity}]", caption)
    figure["layout"]["xaxis"]["type"] = "log"
    return figure


def scatter(points: Sequence[Points], axis: str, quantity: str, caption: str) -> Figure:
    """Points with 95 % error bars, joined by thin lines; without bars, the lines alone.

    Parameters
    ----------
    points : sequence of Points
    axis, quantity : str
    caption : str

    Returns
    -------
    dict
    """
    data = []
    for one, (colour, dash, width) in zip(points, _looks([p.true for p in points]), strict=True):
        trace = line(rounded(one.x), one.y, one.name, colour, dash=dash, width=width)
        if one.std is not None:
            trace |= {"mode": "lines+markers", "marker": {"color": colour}}
            bar = rounded(_REACH * one.std)
            trace["error_y"] = {"type": "data", "array": bar, "color": colour, "thickness": 1.2}
        data.append(trace)
    return {"data": data, "layout": _axes(axis, quantity, caption)}


def _axes(axis: str, quantity: str, caption: str) -> Figure:
    return {
        "meta": caption,
        "xaxis": {"title": {"text": axis}},
        "yaxis": {"title": {"text": quantity}},
    }


def _looks(true: Sequence[bool]) -> list[tuple[str, str, float]]:
    """Colour, dash and width of each line: no two look alike, also without colour."""
    looks, k = [], 0
    for is_true in true:
        if is_true:
            looks.append((TRUTH, "solid", 4.0))
        else:
            looks.append((PALETTE[k % len(PALETTE)], DASHES[k % len(DASHES)], 1.5))
            k += 1
    return looks
