"""Shared charts: frequency responses, lines over time, spectra, points with error bars.

No two lines of a figure look alike: every colour has its own dash. True values are grey and wide,
and lie below the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, repeat

import numpy as np

from strainwave.domain import BoolArray, ComplexArray, FloatArray
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.report import figures
from strainwave.report.figures import Area, Axis, Colour, Dash, Figure, Line, Mark, Markers, Panel

_TRUE_STYLE = (Colour.RESIDUAL, figures.SOLID, 4.0)  # colour, dash, width [px]
_POINT_SIZE = 6.0  # [px] of a point with an error bar
_RESIDUAL_HEIGHT = 0.4  # of the residual panel relative to the panel above


@dataclass(frozen=True, slots=True)
class Curve:
    """One frequency response by name."""

    name: str
    frequencies_hz: FloatArray  # (n_frequencies,)
    response: ComplexArray  # (n_frequencies,)
    magnitude_std: FloatArray | None = None  # of the modulus; None: no band is drawn
    phase_std: FloatArray | None = None  # [rad]; given with `magnitude_std`
    true: bool = False  # drawn grey and wide, below the others


@dataclass(frozen=True, slots=True)
class Series:
    """One line over a common axis, by name; `scatter` draws points with error bars."""

    name: str
    x: FloatArray
    y: FloatArray
    std: FloatArray | None = None
    true: bool = False


class ResponseMarks:
    """Marks of frequency responses: magnitude [dB] above phase [degree].

    Responses are (n_frequencies,). The phase is within half a turn of zero unless `is_continuous`.
    """

    def __init__(self, *, is_continuous: bool = False) -> None:
        self._is_continuous = is_continuous
        self._magnitude: list[Mark] = []
        self._phase: list[Mark] = []

    def add_line(
        self,
        f: FloatArray,
        G: ComplexArray,
        name: str,
        colour: str,
        dash: Dash = figures.SOLID,
        width: float = 1.5,
    ) -> None:
        """Add a line; `width` in px."""
        style = (name, colour, dash, width)
        self._magnitude.append(Line(f, figures.decibel(np.abs(G)), *style))
        self._phase.append(Line(f, self._phase_of(G), *style))

    def add_measured(
        self,
        f: FloatArray,
        G: ComplexArray,
        is_reliable: BoolArray,
        size: float = 4.0,
        opacity: float = 1.0,
    ) -> None:
        """Add measured points, grey where they are unreliable; `size` in px."""
        kinds = (
            ("measured", Colour.MEASURED, is_reliable),
            ("measured, unreliable", Colour.RESIDUAL, ~is_reliable),
        )
        for name, colour, rows in kinds:
            if rows.any():
                magnitude, phase = figures.decibel(np.abs(G[rows])), self._phase_of(G[rows])
                style = (name, colour, size, opacity)
                self._magnitude.append(Markers(f[rows], magnitude, *style))
                self._phase.append(Markers(f[rows], phase, *style))

    def add_band(
        self,
        f: FloatArray,
        G: ComplexArray,
        stds: tuple[FloatArray, FloatArray],
        name: str,
        colour: str,
    ) -> None:
        """Add 95 % bands; `stds` are those of modulus over modulus and of the phase [rad]."""
        half, turn = (CI95_STDS * std for std in stds)
        modulus, phase = np.abs(G), self._phase_of(G)
        low, high = modulus * np.maximum(1.0 - half, figures.MIN_BAND_SHARE), modulus * (1.0 + half)
        turn = np.minimum(np.rad2deg(turn), 180.0)
        self._magnitude.append(Area(f, figures.decibel(low), figures.decibel(high), colour, name))
        self._phase.append(Area(f, phase - turn, phase + turn, colour, name))

    def panels(
        self, magnitude: str, heights: tuple[float, float] = (1.0, 1.0)
    ) -> tuple[Panel, Panel]:
        """Both panels; `magnitude` is the title of the upper axis."""
        return (
            Panel(Axis(magnitude), tuple(self._magnitude), heights[0]),
            Panel(Axis("phase [°]", step=90.0), tuple(self._phase), heights[1]),
        )

    def _phase_of(self, G: ComplexArray) -> FloatArray:
        phase = np.angle(G)
        if not self._is_continuous:
            return np.asarray(np.rad2deg(phase))
        phase = np.rad2deg(np.unwrap(phase))
        return np.asarray(phase - 360.0 * np.round(phase[len(phase) // 2] / 360.0))


def bode(curves: Sequence[Curve], caption: str) -> Figure:
    """Magnitude [dB] and phase [degree] of frequency responses, with their 95 % bands."""
    marks = ResponseMarks(is_continuous=True)
    styles = _styles([curve.true for curve in curves])
    for curve, (colour, dash, width) in zip(curves, styles, strict=True):
        f, G, name = curve.frequencies_hz, curve.response, curve.name
        if curve.magnitude_std is not None and curve.phase_std is not None:
            stds = curve.magnitude_std / np.abs(G), curve.phase_std
            marks.add_band(f, G, stds, name, colour)
        marks.add_line(f, G, name, colour, dash, width)
    return Figure(figures.FREQUENCY_AXIS, marks.panels("magnitude [dB]"), caption=caption)


def pair(measured: Series, model: Series, quantity: str, caption: str) -> Figure:
    """Measured and predicted values of a quantity over time, and their difference below."""
    residual = measured.y - model.y
    rows = figures.decimate(np.column_stack([measured.y, model.y, residual]))
    time = measured.x[rows]
    both = (
        Line(time, measured.y[rows], measured.name, Colour.MEASURED),
        Line(time, model.y[rows], model.name, Colour.MODEL, figures.SHORT_DASH),
    )
    difference = Line(time, residual[rows], "difference", Colour.RESIDUAL, width=1.0)
    panels = Panel(Axis(quantity), both), Panel(Axis(""), (difference,), _RESIDUAL_HEIGHT)
    return Figure(Axis("time [s]"), panels, caption=caption)


def lines(series: Sequence[Series], axis: str, quantity: str, caption: str) -> Figure:
    """Several lines over one axis; `axis` and `quantity` are axis titles with units."""
    return Figure(Axis(axis), (Panel(Axis(quantity), _lines(series)),), caption=caption)


def spectrum(series: Sequence[Series], quantity: str, caption: str) -> Figure:
    """Power spectral densities in dB over log frequency; `quantity` is the unit of the density."""
    positive = [
        Series(s.name, s.x[s.x > 0.0], 0.5 * figures.decibel(s.y[s.x > 0.0]), true=s.true)
        for s in series
    ]
    panel = Panel(Axis(f"density [dB re {quantity}]"), _lines(positive))
    return Figure(figures.FREQUENCY_AXIS, (panel,), caption=caption)


def scatter(points: Sequence[Series], axis: str, quantity: str, caption: str) -> Figure:
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
        rows = figures.decimate(one.y)
        marks.append(Line(one.x[rows], one.y[rows], one.name, colour, dash, width))
    return tuple(marks)


def _styles(true: Sequence[bool]) -> list[tuple[str, Dash, float]]:
    """Colour, dash and width [px] of each line; no two are alike, even without colour."""
    coloured = zip(cycle(figures.PALETTE), cycle(figures.DASHES), repeat(1.5), strict=False)
    return [_TRUE_STYLE if is_true else next(coloured) for is_true in true]
