"""Amplitude dependence of a joint: responses by amplitude, and equivalent stiffness."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import FloatArray, Identification, RecordModel, Sweep
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.formatting import plus_minus
from strainwave.identification.amplitude_sweep import MIN_TREND_STD_ERRORS
from strainwave.identification.joint_model.agreement import motor_response, vector_of
from strainwave.presentation.figures import (
    DASHES,
    FREQUENCY_AXIS,
    SHORT_DASH,
    Axis,
    Colour,
    Figure,
    Line,
    Markers,
    Panel,
)
from strainwave.presentation.figures.curves import ResponseMarks
from strainwave.presentation.report.bode import response_title

_CURVE_POINTS = 200
_COLOURS = (Colour.MEASURED, Colour.LINEAR, Colour.MODEL, Colour.RESIDUAL)
_DASHES = DASHES[:3]  # one for each turn of the colours
_TRENDS = {"hardening": "hardening", "softening": "softening", "no-trend": "no significant trend"}


def swept_records(identification: Identification) -> dict[int, list[RecordModel]]:
    """PRBS records of each joint that has a sweep, in order of amplitude."""
    records: dict[int, list[RecordModel]] = {}
    for record in identification.records:
        if record.joint_model is not None and record.signals.experiment.prbs is not None:
            records.setdefault(record.signals.joint, []).append(record)
    return {
        joint: sorted(in_order, key=_amplitude)
        for joint, in_order in records.items()
        if any(record.signals.experiment.use == "sweep" for record in in_order)
    }


def response_figure(records: Sequence[RecordModel]) -> Figure:
    """Motor torque to motor velocity by the joint model of each record: magnitude and phase."""
    marks = ResponseMarks()
    for k, record in enumerate(records):
        joint = record.joint_model
        if joint is None:
            continue
        f: FloatArray = np.geomspace(*joint.band_hz, _CURVE_POINTS)
        G = motor_response(vector_of(joint), record.signals.gear_ratio, f)
        name = f"{_amplitude(record):g} V, {record.signals.experiment.name}"
        turn, position = divmod(k, len(_COLOURS))
        marks.add_line(f, G, name, _COLOURS[position], _DASHES[turn % len(_DASHES)])
    return Figure(FREQUENCY_AXIS, marks.panels(response_title(is_prismatic=False)))


def stiffness_figure(sweep: Sweep) -> Figure:
    """Equivalent stiffness over amplitude with 95 % bars, and the fitted line."""
    x = np.array([point.amplitude for point in sweep.points])
    y = np.array([point.gear_stiffness for point in sweep.points])
    std = np.array([point.gear_stiffness_std for point in sweep.points])
    marks = Markers(x, y, "equivalent stiffness", Colour.MEASURED, 8.0, error=CI95_STDS * std)
    # the tested slope is that of the squared anti-resonance, which is proportional to the stiffness
    squared = np.array([point.squared_anti_resonance for point in sweep.points])
    weights = 1.0 / np.array([point.squared_anti_resonance_std for point in sweep.points]) ** 2
    centre, level = np.average(x, weights=weights), np.average(squared, weights=weights)
    ratio = float(np.mean(y / squared))
    ends = np.array([x.min(), x.max()])
    line = ratio * (level + sweep.slope * (ends - centre))
    trend = Line(ends, line, "weighted line", Colour.RESIDUAL, SHORT_DASH)
    panel = Panel(Axis("equivalent stiffness [N m/rad]"), (trend, marks))
    return Figure(Axis("amplitude of the excitation [V]"), (panel,))


def trend_title(sweep: Sweep) -> str:
    """The trend in words, with the test statistic."""
    return f"{_TRENDS[sweep.verdict]} ({abs(sweep.slope) / sweep.slope_std:.1f} standard errors)"


def describe_trend(sweep: Sweep) -> str:
    """The test behind the trend: slope, standard error and limit."""
    value, std = plus_minus(sweep.slope, sweep.slope_std)
    return (
        f"Slope of the squared anti-resonance: {value} ± {std} rad²/s² per V,"
        f" {abs(sweep.slope) / sweep.slope_std:.1f} standard errors from zero; a trend is"
        f" significant from {MIN_TREND_STD_ERRORS:g} standard errors."
    )


def _amplitude(record: RecordModel) -> float:
    prbs = record.signals.experiment.prbs
    return prbs.amplitude if prbs is not None else 0.0
