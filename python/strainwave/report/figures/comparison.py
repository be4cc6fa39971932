"""Charts of results side by side: changes of parameters, and linear models of one joint.

Models and results are ordered by name; changes and ratios refer to the first.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from typing import Literal

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, Parameter
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.dynamics.two_inertia import TwoInertia, coefficients, state_space
from strainwave.numerics.linalg import exponential
from strainwave.report.figures import DASHES, PALETTE, Axis, Figure, Line, Markers, Panel, Symbol
from strainwave.report.figures.curves import Curve, Series

Scale = Literal["percent", "std"]
"""Unit of a change: percent of the first value, or standard deviations of the first result."""

_MAX_SHOWN_STD = 0.2  # relative; wider intervals would set the scale of a figure in percent
_PERIODS = 8.0  # of the slowest model's fastest pole, in a step response
_STEP_POINTS = 600
_ROOT_SIZE = 9.0  # [px]


def changes(
    results: Mapping[str, Iterable[Parameter]], scale: Scale
) -> tuple[tuple[list[str], list[str]], list[Series], str]:
    """Rows (group, name) of the parameters by joint, their changes with half-lengths, and a title.

    In percent, parameters without a narrow interval are left out.
    """
    first, *_ = results
    rows = [(p, p.value, p.std) for p in results[first] if p.value and p.std]
    if scale == "percent":
        rows = [row for row in rows if row[2] < _MAX_SHOWN_STD * abs(row[1])]
    rows.sort(key=lambda row: row[0].joint or 0)
    joints = [f"joint {p.joint}" if p.joint else "arm" for p, _, _ in rows]
    sizes = np.array([0.01 * abs(v) if scale == "percent" else std for _, v, std in rows])
    series = []
    for name, parameters in results.items():
        known = {p.key: (p.value, p.std) for p in parameters}
        table = np.array([known.get(p.key, (None, None)) for p, _, _ in rows], dtype=float)
        values, stds = table.reshape(-1, 2).T  # NaN: the result has none
        change = (values - np.array([value for _, value, _ in rows])) / sizes
        series.append(Series(name, change, CI95_STDS * stds / sizes))
    unit = "%" if scale == "percent" else f"standard deviations of {first}"
    return (joints, [p.name for p, _, _ in rows]), series, f"change from {first} [{unit}]"


def ratios(responses: Sequence[Curve]) -> list[Curve]:
    """Responses over the first, at its frequencies."""
    f, first = responses[0].frequencies_hz, responses[0].response
    curves = [Curve(responses[0].name, f, np.ones_like(first))]
    for one in responses[1:]:
        inside = (f >= one.frequencies_hz[0]) & (f <= one.frequencies_hz[-1])
        logarithm = np.log(np.abs(one.response)) + 1j * np.unwrap(np.angle(one.response))
        at = np.interp(np.log(f[inside]), np.log(one.frequencies_hz), logarithm)
        if inside.any():
            curves.append(Curve(one.name, f[inside], np.exp(at) / first[inside]))
    return curves


def step_responses(models: Mapping[str, TwoInertia]) -> Figure:
    """Motor and link velocity after a step of the motor torque of 1 N m."""
    fastest = [np.abs(_roots(model)[0]).max() / (2.0 * np.pi) for model in models.values()]
    time = np.linspace(0.0, _PERIODS / min(fastest), _STEP_POINTS)
    lines: list[list[Line]] = [[], []]
    styles = zip(models.items(), cycle(PALETTE), cycle(DASHES), strict=False)
    for (name, model), colour, dash in styles:
        for panel, velocity in zip(lines, _step_response(model, time), strict=True):
            panel.append(Line(time, velocity, name, colour, dash))
    titles = ("motor velocity [rad/s]", "link velocity [rad/s]")
    panels = (Panel(Axis(title), tuple(each)) for title, each in zip(titles, lines, strict=True))
    return Figure(Axis("time after a motor torque of 1 N m [s]"), tuple(panels))


def _step_response(model: TwoInertia, time: FloatArray) -> FloatArray:
    """Motor and link velocity (2, n_samples) at equidistant times; the torque is a fourth state."""
    linear = state_space(model)
    system = np.zeros((4, 4))
    system[:3] = np.column_stack([linear.A, linear.B[:, 0]])
    advance = exponential(system * (time[1] - time[0]))
    states = [np.array([0.0, 0.0, 0.0, 1.0])]
    for _ in time[1:]:
        states.append(advance @ states[-1])
    return np.asarray(linear.C @ np.array(states).T[:3])


def poles_and_zeros(models: Mapping[str, TwoInertia]) -> Figure:
    """Poles (crosses) and zeros (circles) of motor torque to motor velocity."""
    kinds: tuple[tuple[str, Symbol], ...] = (("poles", "x"), ("zeros", "circle-open"))
    marks = [
        Markers(roots.real, roots.imag, f"{name}, {kind}", colour, _ROOT_SIZE, symbol=symbol)
        for (name, model), colour in zip(models.items(), cycle(PALETTE), strict=False)
        for roots, (kind, symbol) in zip(_roots(model), kinds, strict=True)
    ]
    axis = Axis("imaginary part [rad/s]")
    return Figure(Axis("real part [rad/s]"), (Panel(axis, tuple(marks), 2.0),))


def _roots(model: TwoInertia) -> tuple[ComplexArray, ComplexArray]:
    """Poles and zeros of (17)."""
    b, a = coefficients(model)
    return np.roots(a[::-1]).astype(complex), np.roots(b[::-1]).astype(complex)
