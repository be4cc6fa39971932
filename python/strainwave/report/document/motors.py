"""Response of each driven motor in the complete arm: measured, and simulated by the fitted arm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import FloatArray, MotorResponse
from strainwave.report import figures
from strainwave.report.document.bode import response_title
from strainwave.report.figures import Colour, Figure, Upright
from strainwave.report.figures.curves import ResponseMarks

_MIN_COHERENCE = 0.8  # of a reliable line
_MAX_POINTS = 400
_LABEL_STEP = 0.16  # height between the labels of neighbours, as a share of the panel


def motor_figure(response: MotorResponse, *, is_prismatic: bool = False) -> Figure:
    """Magnitude and phase; vertical lines show the modes of the fitted arm."""
    rows = figures.spread_evenly(response.frequencies_hz, 0.0, np.inf, _MAX_POINTS)
    f, reliable = response.frequencies_hz[rows], response.coherence[rows] >= _MIN_COHERENCE
    marks = ResponseMarks()
    marks.add_measured(f, response.measured[rows], reliable)
    marks.add_line(f, response.fitted[rows], "fitted arm, simulated", Colour.TUNED)
    panels = marks.panels(response_title(is_prismatic=is_prismatic), (1.2, 0.8))
    return Figure(figures.FREQUENCY_AXIS, panels, tuple(_uprights(response)))


def _uprights(response: MotorResponse) -> Iterator[Upright]:
    """A line for each mode. The first of a kind is named; neighbours have staggered labels."""
    f = response.frequencies_hz
    modes = [
        *((value, "anti-resonance", True) for value in _inside(response.anti_resonances_hz, f)),
        *((value, "resonance", False) for value in _inside(response.resonances_hz, f)),
    ]
    for k, (value, name, is_left) in enumerate(modes):
        is_repeated = k > 0 and name == modes[k - 1][1]
        yield Upright(
            value,
            f"{value:.3g} Hz" if is_repeated else f"{name} {value:.3g} Hz",
            panel=1,
            height=1.0 - _LABEL_STEP * (k % 2),
            before=is_left,
            dash=figures.SOLID if is_left else figures.DOTTED,
        )


def describe(response: MotorResponse) -> str:
    """Caption of the figure."""
    parts = []
    kinds = (
        ("anti-resonances", response.anti_resonances_hz),
        ("resonances", response.resonances_hz),
    )
    for name, values in kinds:
        inside = [f"{value:.4g}" for value in _inside(values, response.frequencies_hz)]
        if inside:
            parts.append(f"{name} of the fitted arm: {', '.join(inside)} Hz")
    reliable = response.coherence >= _MIN_COHERENCE
    if reliable.any():
        measured, fitted = response.measured[reliable], response.fitted[reliable]
        error = 100.0 * float(np.median(np.abs(measured - fitted) / np.abs(measured)))
        parts.append(
            f"median difference where the coherence is at least {_MIN_COHERENCE:g}: {error:.2g} %"
        )
    text = "; ".join(parts)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _inside(values: Sequence[float], f: FloatArray) -> list[float]:
    return [value for value in values if len(f) and f[0] <= value <= f[-1]]
