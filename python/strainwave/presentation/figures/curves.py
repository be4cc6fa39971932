"""Charts of any arm's data: responses, lines over time, spectra, points with error bars.

No two lines of a figure look alike: every colour has its dash. The truth is grey and wide, and lies
below the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import ComplexArray, FloatArray
from strainwave.presentation.figures.records import (
    SOLID,
    Axis,
    Band,
    Dash,
    Figure,
    Line,
    Mark,
    Panel,
)
from strainwave.presentation.figures.samples import decibel, thinned
from strainwave.presentation.figures.style import (
    BRIEF,
    DASHES,
    MEASURED,
    MODEL,
    PALETTE,
    RESIDUAL,
)

_TRUTH = RESIDUAL
_REACH = 1.96  # of a 95 % band, in deviations
_DOT = 6.0  # [px] of a point with an error bar
_SMALL = 0.4  # height of a panel of residuals beside the one above it


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
    Figure
    """
    magnitude: list[Mark] = []
    phases: list[Mark] = []
    for curve, (colour, dash, width) in zip(curves, _looks([c.true for c in curves]), strict=True):
        f, name = curve.frequencies_hz, curve.name
        size = np.abs(curve.response)
        phase = np.rad2deg(np.unwrap(np.angle(curve.response)))
        phase = phase - 360.0 * np.round(phase[len(phase) // 2] / 360.0)
        if curve.magnitude_std is not None:
            reach = _REACH * curve.magnitude_std
            low = np.maximum(size - reach, 1e-2 * size)  # a band down to zero has no bottom in dB
            magnitude.append(Band(f, decibel(low), decibel(size + reach), colour, name))
        if curve.phase_std is not None:
            reach = np.minimum(np.rad2deg(_REACH * curve.phase_std), 180.0)
            phases.append(Band(f, phase - reach, phase + reach, colour, name))
        magnitude.append(Line(f, decibel(size), name, colour, dash, width))
        phases.append(Line(f, phase, name, colour, dash, width))
    panels = (
        Panel(Axis("magnitude [dB]"), tuple(magnitude)),
        Panel(Axis("phase [°]", step=90.0), tuple(phases)),
    )
    return Figure(Axis("frequency [Hz]", log=True), panels, caption=caption)


def pair(measured: Series, model: Series, quantity: str, caption: str) -> Figure:
    """What was measured over time and the model's answer; below, their difference.

    Parameters
    ----------
    measured, model : Series
        On one time base [s].
    quantity : str
        With its unit, of the vertical axis.
    caption : str

    Returns
    -------
    Figure
    """
    residual = measured.y - model.y
    pick = thinned(np.column_stack([measured.y, model.y, residual]))
    time = measured.x[pick]
    both = (
        Line(time, measured.y[pick], measured.name, MEASURED),
        Line(time, model.y[pick], model.name, MODEL, BRIEF),
    )
    left = Line(time, residual[pick], "difference", RESIDUAL, width=1.0)
    panels = Panel(Axis(quantity), both), Panel(Axis(""), (left,), _SMALL)
    return Figure(Axis("time [s]"), panels, caption=caption)


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
    Figure
    """
    return Figure(Axis(axis), (Panel(Axis(quantity), _lines(series)),), caption=caption)


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
    Figure
    """
    inside = [Series(s.name, s.x[s.x > 0.0], 0.5 * decibel(s.y[s.x > 0.0]), s.true) for s in series]
    panel = Panel(Axis(f"density [dB re {quantity}]"), _lines(inside))
    return Figure(Axis("frequency [Hz]", log=True), (panel,), caption=caption)


def scatter(points: Sequence[Points], axis: str, quantity: str, caption: str) -> Figure:
    """Points with 95 % error bars, joined by thin lines; without bars, the lines alone.

    Parameters
    ----------
    points : sequence of Points
    axis, quantity : str
    caption : str

    Returns
    -------
    Figure
    """
    drawn = []
    for one, (colour, dash, width) in zip(points, _looks([p.true for p in points]), strict=True):
        error, dot = (None, 0.0) if one.std is None else (_REACH * one.std, _DOT)
        drawn.append(Line(one.x, one.y, one.name, colour, dash, width, size=dot, error=error))
    return Figure(Axis(axis), (Panel(Axis(quantity), tuple(drawn)),), caption=caption)


def _lines(series: Sequence[Series]) -> tuple[Line, ...]:
    drawn = []
    for one, (colour, dash, width) in zip(series, _looks([s.true for s in series]), strict=True):
        pick = thinned(one.y)
        drawn.append(Line(one.x[pick], one.y[pick], one.name, colour, dash, width))
    return tuple(drawn)


def _looks(true: Sequence[bool]) -> list[tuple[str, Dash, float]]:
    """Colour, dash and width of each line: no two look alike, also without colour."""
    looks, k = [], 0
    for is_true in true:
        if is_true:
            looks.append((_TRUTH, SOLID, 4.0))
        else:
            looks.append((PALETTE[k % len(PALETTE)], DASHES[k % len(DASHES)], 1.5))
            k += 1
    return looks
