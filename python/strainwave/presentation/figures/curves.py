"""Shared charts: frequency responses, lines over time, spectra, points with error bars.

No two lines of a figure look alike: every colour has its own dash. True values are grey and wide,
and lie below the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from strainwave.domain import ComplexArray, FloatArray
from strainwave.domain.distributions import CI95_STDS
from strainwave.presentation.figures.records import (
    SOLID,
    Area,
    Axis,
    Dash,
    Figure,
    Line,
    Mark,
    Panel,
)
from strainwave.presentation.figures.samples import MIN_BAND_SHARE, decibel, decimate
from strainwave.presentation.figures.style import (
    DASHES,
    MEASURED_COLOUR,
    MODEL_COLOUR,
    PALETTE,
    RESIDUAL_COLOUR,
    SHORT_DASH,
)

_TRUE_COLOUR = RESIDUAL_COLOUR
_TRUE_WIDTH = 4.0  # [px]
_POINT_SIZE = 6.0  # [px] of a point with an error bar
_RESIDUAL_HEIGHT = 0.4  # of the residual panel relative to the panel above


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
    """Magnitude [dB] and phase [degree] of frequency responses, with their 95 % bands."""
    magnitudes: list[Mark] = []
    phases: list[Mark] = []
    for curve, (colour, dash, width) in zip(curves, _styles([c.true for c in curves]), strict=True):
        f, name = curve.frequencies_hz, curve.name
        modulus = np.abs(curve.response)
        phase = np.rad2deg(np.unwrap(np.angle(curve.response)))
        phase = phase - 360.0 * np.round(phase[len(phase) // 2] / 360.0)
        if curve.magnitude_std is not None:
            half = CI95_STDS * curve.magnitude_std
            low = np.maximum(modulus - half, MIN_BAND_SHARE * modulus)
            magnitudes.append(Area(f, decibel(low), decibel(modulus + half), colour, name))
        if curve.phase_std is not None:
            half = np.minimum(np.rad2deg(CI95_STDS * curve.phase_std), 180.0)
            phases.append(Area(f, phase - half, phase + half, colour, name))
        magnitudes.append(Line(f, decibel(modulus), name, colour, dash, width))
        phases.append(Line(f, phase, name, colour, dash, width))
    panels = (
        Panel(Axis("magnitude [dB]"), tuple(magnitudes)),
        Panel(Axis("phase [°]", step=90.0), tuple(phases)),
    )
    return Figure(Axis("frequency [Hz]", log=True), panels, caption=caption)


def pair(measured: Series, model: Series, quantity: str, caption: str) -> Figure:
    """Measured and predicted values of a quantity over time, and their difference below."""
    residual = measured.y - model.y
    rows = decimate(np.column_stack([measured.y, model.y, residual]))
    time = measured.x[rows]
    both = (
        Line(time, measured.y[rows], measured.name, MEASURED_COLOUR),
        Line(time, model.y[rows], model.name, MODEL_COLOUR, SHORT_DASH),
    )
    difference = Line(time, residual[rows], "difference", RESIDUAL_COLOUR, width=1.0)
    panels = Panel(Axis(quantity), both), Panel(Axis(""), (difference,), _RESIDUAL_HEIGHT)
    return Figure(Axis("time [s]"), panels, caption=caption)


def lines(series: Sequence[Series], axis: str, quantity: str, caption: str) -> Figure:
    """Several lines over one axis; `axis` and `quantity` are axis titles with units."""
    return Figure(Axis(axis), (Panel(Axis(quantity), _lines(series)),), caption=caption)


def spectrum(series: Sequence[Series], quantity: str, caption: str) -> Figure:
    """Power spectral densities in dB over log frequency; `quantity` is the unit of the density."""
    positive = [
        Series(s.name, s.x[s.x > 0.0], 0.5 * decibel(s.y[s.x > 0.0]), s.true) for s in series
    ]
    panel = Panel(Axis(f"density [dB re {quantity}]"), _lines(positive))
    return Figure(Axis("frequency [Hz]", log=True), (panel,), caption=caption)


def scatter(points: Sequence[Points], axis: str, quantity: str, caption: str) -> Figure:
    """Points with 95 % error bars joined by thin lines; lines alone where `std` is None."""
    marks = []
    styles = _styles([p.true for p in points])
    for curve, (colour, dash, width) in zip(points, styles, strict=True):
        error, size = (None, 0.0) if curve.std is None else (CI95_STDS * curve.std, _POINT_SIZE)
        marks.append(
            Line(curve.x, curve.y, curve.name, colour, dash, width, size=size, error=error)
        )
    return Figure(Axis(axis), (Panel(Axis(quantity), tuple(marks)),), caption=caption)


def _lines(series: Sequence[Series]) -> tuple[Line, ...]:
    marks = []
    for one, (colour, dash, width) in zip(series, _styles([s.true for s in series]), strict=True):
        rows = decimate(one.y)
        marks.append(Line(one.x[rows], one.y[rows], one.name, colour, dash, width))
    return tuple(marks)


class _Style(NamedTuple):
    colour: str
    dash: Dash
    width: float


def _styles(true: Sequence[bool]) -> list[_Style]:
    """Style of each line; no two are alike, even without colour."""
    styles, k = [], 0
    for is_true in true:
        if is_true:
            styles.append(_Style(_TRUE_COLOUR, SOLID, _TRUE_WIDTH))
        else:
            styles.append(_Style(PALETTE[k % len(PALETTE)], DASHES[k % len(DASHES)], 1.5))
            k += 1
    return styles
