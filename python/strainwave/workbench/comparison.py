"""Results side by side: parameters with intervals, responses, steps, poles and zeros.

Figures of a report file, which has them as JSON.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg

import strainwave as sw
from strainwave.domain import ComplexArray, Parameter
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.formatting import plus_minus
from strainwave.domain.keys import Key, label_of
from strainwave.errors import InvalidInput
from strainwave.export import arm_of
from strainwave.export.state_space import Matrices, joint_model, state_space
from strainwave.presentation.figures import (
    DASHES,
    PALETTE,
    Axis,
    Figure,
    Line,
    Markers,
    Panel,
)
from strainwave.presentation.figures.curves import Curve, bode

_PERIODS = 8.0  # of the resonance, in a step response
_STEP_POINTS = 600
_MIN_PENCIL = 1e-10  # of the largest; eigenvalues of smaller ones are at infinity
_MAX_SHOWN_STD = 0.2  # relative; wider intervals would set the scale of the figure


@dataclass(frozen=True, slots=True)
class NamedResult:
    """A result with the name under which it is compared."""

    name: str
    path: Path
    result: sw.Result


def read_results(paths: Mapping[str, Path]) -> list[NamedResult]:
    """Results by name. Raises InvalidInput for fewer than two, or a file that is no result."""
    if len(paths) < 2:
        raise InvalidInput("a comparison needs two results", remedy="choose at least two")
    return [NamedResult(name, path, sw.read_result(path)) for name, path in paths.items()]


def parameter_rows(results: Sequence[NamedResult]) -> list[dict[str, Any]]:
    """One row per parameter: value, interval and change from the first result."""
    keys = dict.fromkeys(p.key for one in results for p in one.result if p.value is not None)
    return [_row(key, results) for key in keys]


def _row(key: Key, results: Sequence[NamedResult]) -> dict[str, Any]:
    estimates = [_estimate(one, key) for one in results]
    unit = next(p.unit for p in estimates if p is not None)
    cells = [_cell(p, None if p is estimates[0] else estimates[0]) for p in estimates]
    return {"label": label_of(*key), "unit": unit, "cells": cells}


def _estimate(one: NamedResult, key: Key) -> Parameter | None:
    return one.result[key] if key in one.result else None  # noqa: SIM401 - it has no `get`


def _cell(parameter: Parameter | None, first: Parameter | None) -> dict[str, Any]:
    """A value with its interval, and its change from the first result in standard deviations."""
    if parameter is None or parameter.value is None:
        return {"text": "", "low": None, "high": None, "change": None}
    low, high = parameter.ci95 or (None, None)
    text = f"{parameter.value:.5g}"
    if parameter.std is not None:
        text = " ± ".join(plus_minus(parameter.value, parameter.std))
    change = None
    if first is not None and first.value is not None:
        spread = float(np.hypot(first.std or 0.0, parameter.std or 0.0))
        change = (parameter.value - first.value) / spread if spread > 0.0 else None
    return {"text": text, "low": low, "high": high, "change": change}


def interval_figure(results: Sequence[NamedResult]) -> Figure:
    """Values over those of the first result, with 95 % intervals."""
    marks, keys = [], []
    first = results[0].result
    for parameter in first:
        estimates = [_estimate(one, parameter.key) for one in results]
        if parameter.value and all(map(_is_narrow, estimates)):
            keys.append((parameter.key, parameter.value))
    names = tuple(label_of(*key) for key, _ in keys)
    for one, colour in zip(results, _colours(len(results)), strict=True):
        values = [(one.result[key].value or np.nan) / reference for key, reference in keys]
        stds = [(one.result[key].std or np.nan) / abs(reference) for key, reference in keys]
        error = CI95_STDS * np.array(stds)
        marks.append(Markers(names, np.array(values), one.name, colour, 6.0, error=error))
    axis = Axis(f"value / value of {results[0].name}")
    return Figure(Axis(""), (Panel(axis, tuple(marks), 1.6),))


def _is_narrow(parameter: Parameter | None) -> bool:
    if parameter is None or not parameter.value or parameter.std is None:
        return False
    return parameter.std < _MAX_SHOWN_STD * abs(parameter.value)


def joints_of(results: Sequence[NamedResult]) -> list[int]:
    """Joints that have a linear model of their own in every result."""
    count = min(len(_arm(one).study.arm.joints) for one in results)
    return [
        joint for joint in range(1, count + 1) if all(_has_model(one, joint) for one in results)
    ]


def _has_model(one: NamedResult, joint: int) -> bool:
    try:
        joint_model(_arm(one), joint)
    except InvalidInput:
        return False
    return True


def _arm(one: NamedResult) -> Any:
    return arm_of(one.result.document, one.path)


def bode_figure(results: Sequence[NamedResult], joint: int) -> Figure:
    """Responses of motor velocity to motor torque, with 95 % bands."""
    curves = []
    for one in results:
        response = one.result.frequency_response(joint)
        stds = response.magnitude_std, response.phase_std
        curves.append(Curve(one.name, response.frequencies_hz, response.response, *stds))
    return bode(curves, f"Joint {joint}: motor torque to motor velocity")


def step_figure(results: Sequence[NamedResult], joint: int) -> Figure:
    """Motor and link velocity after a step of the motor torque of 1 N m."""
    from scipy import signal  # takes half a second

    lines: list[list[Line]] = [[], []]
    duration = _PERIODS / min(_resonance_hz(one, joint) for one in results)
    time = np.linspace(0.0, duration, _STEP_POINTS)
    styles = zip(results, _colours(len(results)), _dashes(len(results)), strict=True)
    for one, colour, dash in styles:
        model = state_space(_arm(one), joint)
        C, D = np.vstack([model.C[0], np.eye(3)[2]]), np.zeros((2, 1))
        _, response = signal.step(signal.StateSpace(model.A, model.B[:, :1], C, D), T=time)
        for panel, velocity in zip(lines, np.asarray(response).T, strict=True):
            panel.append(Line(time, velocity, one.name, colour, dash))
    names = ("motor velocity [rad/s]", "link velocity [rad/s]")
    panels = (Panel(Axis(name), tuple(each)) for name, each in zip(names, lines, strict=True))
    return Figure(Axis("time after a motor torque of 1 N m [s]"), tuple(panels))


def _resonance_hz(one: NamedResult, joint: int) -> float:
    poles = np.linalg.eigvals(state_space(_arm(one), joint).A)
    return float(np.abs(poles).max() / (2.0 * np.pi))


def pole_figure(results: Sequence[NamedResult], joint: int) -> Figure:
    """Poles (crosses) and zeros (circles) of motor torque to motor velocity."""
    marks = []
    for one, colour in zip(results, _colours(len(results)), strict=True):
        model = state_space(_arm(one), joint)
        poles = np.asarray(np.linalg.eigvals(model.A), dtype=np.complex128)
        zeros = _zeros(model)
        pole_name, zero_name = f"{one.name}, poles", f"{one.name}, zeros"
        marks.append(Markers(poles.real, poles.imag, pole_name, colour, 9.0, symbol="x"))
        marks.append(Markers(zeros.real, zeros.imag, zero_name, colour, 9.0, symbol="circle-open"))
    axis = Axis("imaginary part [rad/s]")
    return Figure(Axis("real part [rad/s]"), (Panel(axis, tuple(marks), 2.0),))


def _zeros(model: Matrices) -> ComplexArray:
    """Zeros of motor torque to motor velocity: finite eigenvalues of the system pencil."""
    order = len(model.A)
    system = np.block([[model.A, model.B[:, :1]], [model.C[:1], model.D[:1, :1]]])
    mass = np.zeros_like(system)
    mass[:order, :order] = np.eye(order)
    alpha, beta = linalg.eig(system, mass, right=False, homogeneous_eigvals=True)
    is_finite = np.abs(beta) > _MIN_PENCIL * np.abs(beta).max()
    return np.asarray(alpha[is_finite] / beta[is_finite], dtype=np.complex128)


def check_fits(results: Sequence[NamedResult]) -> list[dict[str, Any]]:
    """Fits of check records in percent, one row per record and channel."""
    rows = dict.fromkeys(
        (record, channel)
        for one in results
        for record, fits in one.result.checks.items()
        for channel in fits
    )
    return [
        {
            "record": record,
            "channel": channel,
            "fits": [one.result.checks.get(record, {}).get(channel) for one in results],
        }
        for record, channel in rows
    ]


def _colours(count: int) -> list[str]:
    return [PALETTE[k % len(PALETTE)] for k in range(count)]


def _dashes(count: int) -> list[tuple[float, ...]]:
    return [DASHES[k % len(DASHES)] for k in range(count)]


_MAX_BYTES = 64 << 20  # of a report


def report_figures(path: Path) -> dict[str, dict[str, Any]]:
    """`title`, `data` and `layout` of the figures of a report, by key.

    Empty if the file is missing, damaged or no report. Reports of earlier versions have no titles.
    """
    try:
        text = path.read_text(encoding="utf-8") if path.stat().st_size <= _MAX_BYTES else ""
        json_text = text.partition(' id="figures">')[2].partition("</script>")[0]
        figures: dict[str, dict[str, Any]] = json.loads(json_text or "{}")
    except (OSError, ValueError):
        return {}
    return {
        key: {"title": key} | figure
        for key, figure in figures.items()
        if isinstance(figure, dict) and isinstance(figure.get("data"), list)
    }
