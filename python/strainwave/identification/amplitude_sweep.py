"""RecordModels of several amplitudes -> Sweep: the equivalent stiffness over the amplitude."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from strainwave.domain import RecordModel, Sweep, SweepPoint

_LEAST = 3  # amplitudes that make a trend
_CERTAIN = 3.0  # deviations from which a slope is not chance


def sweeps(records: Sequence[RecordModel]) -> tuple[Sweep, ...]:
    """One sweep a joint that was excited at three amplitudes or more, the other joints free.

    The squared anti-resonance k/m_L is proportional to the stiffness; a gear whose spring hardens
    with torque shows a slope against the amplitude. The slope is that of a weighted line, its
    deviation scaled by how far the points lie from one.

    Parameters
    ----------
    records : sequence of RecordModel

    Returns
    -------
    tuple of Sweep
    """
    found = []
    for joint in sorted({record.signals.joint for record in records}):
        own = [r for r in records if r.signals.joint == joint and _others_free(r)]
        points = sorted(_points(own), key=lambda point: point.amplitude)
        if len({point.amplitude for point in points}) >= _LEAST:
            found.append(_sweep(joint, tuple(points)))
    return tuple(found)


def _others_free(record: RecordModel) -> bool:
    """A sweep compares like with like; records made for a sweep are alike by intent."""
    experiment = record.signals.experiment
    return experiment.use == "sweep" or "servo" not in experiment.control


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
    s = np.array([point.squared_anti_resonance_std for point in points])
    X = np.column_stack([np.ones_like(x), x]) / s[:, None]
    (_, slope), *_ = np.linalg.lstsq(X, y / s)
    covariance = np.linalg.inv(X.T @ X)
    residual = y / s - X @ np.linalg.lstsq(X, y / s)[0]
    scale = max(1.0, float(residual @ residual) / max(1, len(x) - 2))
    std = float(np.sqrt(covariance[1, 1] * scale))
    sure = abs(slope) > _CERTAIN * std
    verdict: Literal["hardening", "softening", "no-trend"]
    verdict = "no-trend" if not sure else "hardening" if slope > 0.0 else "softening"
    return Sweep(joint, points, float(slope), std, verdict)
