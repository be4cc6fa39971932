"""Amplitude sweep: equivalent gear stiffness over the excitation amplitude."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from strainwave.domain import RecordModel, Sweep, SweepPoint

_MIN_AMPLITUDES = 3  # with two points, a line has no residual
MIN_TREND_STD_ERRORS = 3.0
"""Minimum slope over its standard error of a significant trend: 0.3 % false alarms."""


def compare_amplitudes(records: Sequence[RecordModel]) -> tuple[Sweep, ...]:
    """One sweep for each joint excited at three or more amplitudes with the other joints free.

    The squared anti-resonance k/m_L is proportional to the stiffness. The trend is the slope of a
    weighted line over the amplitude. The standard error of the slope includes the scatter of the
    points around a parabola, because the curvature of a hardening spring is not scatter.
    """
    results = []
    for joint in sorted({record.signals.joint for record in records}):
        # the other joints are free, or the record is part of a sweep by its `use`
        joint_records = [
            r
            for r in records
            if r.signals.joint == joint
            and (r.signals.experiment.use == "sweep" or "servo" not in r.signals.experiment.control)
        ]
        points = sorted(_points(joint_records), key=lambda point: point.amplitude)
        if len({point.amplitude for point in points}) >= _MIN_AMPLITUDES:
            results.append(_sweep(joint, tuple(points)))
    return tuple(results)


def _points(records: Iterable[RecordModel]) -> list[SweepPoint]:
    points = []
    for record in records:
        prbs, joint = record.signals.experiment.prbs, record.joint_model
        mode = None if joint is None else joint.anti_resonance
        if prbs is None or joint is None or mode is None or mode.frequency_std_hz is None:
            continue
        w = 2.0 * np.pi * mode.frequency_hz
        k = list(joint.values).index("gear_stiffness")
        points.append(
            SweepPoint(
                experiment=record.signals.experiment.name,
                amplitude=prbs.amplitude,
                squared_anti_resonance=w**2,
                squared_anti_resonance_std=2.0 * w * 2.0 * np.pi * mode.frequency_std_hz,
                gear_stiffness=joint.values["gear_stiffness"],
                gear_stiffness_std=float(np.sqrt(joint.covariance[k, k])),
            )
        )
    return points


def _sweep(joint: int, points: tuple[SweepPoint, ...]) -> Sweep:
    x = np.array([point.amplitude for point in points])
    y = np.array([point.squared_anti_resonance for point in points])
    std_y = np.array([point.squared_anti_resonance_std for point in points])
    X = np.column_stack([np.ones_like(x), x, x**2]) / std_y[:, None]
    line, parabola = (np.linalg.lstsq(X[:, :n], y / std_y)[0] for n in (2, 3))
    slope = float(line[1])
    residual = y / std_y - X @ parabola
    scale = max(1.0, float(residual @ residual) / max(1, len(x) - 3))
    std = float(np.sqrt(np.linalg.inv(X[:, :2].T @ X[:, :2])[1, 1] * scale))
    is_significant = abs(slope) > MIN_TREND_STD_ERRORS * std
    verdict: Literal["hardening", "softening", "no-trend"]
    verdict = "no-trend" if not is_significant else "hardening" if slope > 0.0 else "softening"
    return Sweep(joint, points, slope, std, verdict)
