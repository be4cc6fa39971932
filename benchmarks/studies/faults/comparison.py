"""Differences between an input after corrections and the input without the fault.

Both are read, so that a correction counts by its effect: a scale of a channel and a constant of the
study may correct the same fault. What the corrected input lacks (a removed channel, a removed
record) is no difference.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from benchmarks.studies.faults.inputs import Input
from strainwave.domain import FloatArray, Log, Study, channel_parts
from strainwave.io.logs import read_logs

_SMOOTHING = 0.01  # [s] of the comparison of channels; a shifted log is interpolated
_ANGLES = ("theta_m", "theta_l", "deflection")


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Largest difference that counts as none."""

    ratio: float = 0.005  # of channels, ratios and constants
    length: float = 0.02  # share of lengths
    angle: float = 0.02  # [rad] at the link, of zeros, axes and gravity
    delay: float = 2e-3  # [s]
    lag: float = 1e-4  # [s] of current loops
    rest: float = 0.05  # rms share of a channel that scale, zero and delay do not explain


EXACT = Tolerance(*(6 * (1e-6,)))
"""Tells a correction that changes nothing."""


def differences(actual: Input, true: Input, tolerance: Tolerance) -> list[str]:
    """Names of the constants and channels that differ."""
    found = list(_differing_constants(actual.study, true.study, tolerance))
    true_logs = {log.name: log for log in read_logs(true.study, data=true.tables)}
    for log in read_logs(actual.study, data=actual.tables):
        other = true_logs.get(log.name)
        if other is None:
            found.append(log.name)
            continue
        drives = [
            study.arm.joints[i].torque_per_command
            for study in (actual.study, true.study)
            for i in range(study.arm.n_joints)
        ]
        found += _differing_channels(log, other, true.study, np.reshape(drives, (2, -1)), tolerance)
    return found


def _differing_constants(actual: Study, true: Study, tolerance: Tolerance) -> Iterator[str]:
    for i, (a, b) in enumerate(zip(actual.arm.joints, true.arm.joints, strict=True), start=1):
        if abs(a.gear_ratio / b.gear_ratio - 1.0) > tolerance.ratio:
            yield f"gear_ratio {i}"
        counts = [joint.encoder_counts or 0.0 for joint in (a, b)]
        if abs(counts[0] - counts[1]) > tolerance.ratio * counts[1]:
            yield f"encoder_counts {i}"
        near, far = a.accelerometer_distance, b.accelerometer_distance
        if near and far and abs(near / far - 1.0) > tolerance.length:
            yield f"accelerometer_distance {i}"
        loops = [joint.current_loop_hz for joint in (a, b)]
        lags = [1.0 / (2.0 * np.pi * hz) if hz else 0.0 for hz in loops]
        if abs(lags[0] - lags[1]) > tolerance.lag:
            yield f"current_loop_hz {i}"
        for name in (f"torque{i}", f"u{i}"):
            meanings = [
                study.channels[name].meaning if name in study.channels else "motor"
                for study in (actual, true)
            ]
            if meanings[0] != meanings[1]:
                yield f"meaning of {name}"
    yield from _differing_frames(actual, true, tolerance)
    experiments = {each.name: each for each in true.experiments}
    for each in actual.experiments:
        other = experiments.get(each.name)
        if other is None:
            continue
        if (each.payload is None) != (other.payload is None) or each.joint != other.joint:
            yield f"payload or joint of {each.name}"
        if each.prbs and other.prbs:
            clock = each.prbs.clock / other.prbs.clock
            amplitude = each.prbs.amplitude / other.prbs.amplitude
            if max(abs(clock - 1.0), abs(amplitude - 1.0)) > tolerance.ratio:
                yield f"prbs of {each.name}"


def _differing_frames(actual: Study, true: Study, tolerance: Tolerance) -> Iterator[str]:
    """Axes as lines at zero angle, up to a shift of the whole arm; and gravity."""
    (p, d), (q, e) = (_axes(study) for study in (actual, true))
    turned = np.arccos(np.clip(np.sum(d * e, axis=1), -1.0, 1.0))
    projectors = np.eye(3) - e[:, :, None] * e[:, None, :]
    moved = (projectors @ (p - p[0] - q + q[0])[:, :, None])[:, :, 0]
    along = projectors @ e[0]
    moved -= along * (np.vdot(along, moved) / max(np.vdot(along, along), 1e-12))
    reach = float(np.linalg.norm(np.ptp(q, axis=0)))
    for i in range(len(q)):
        if turned[i] > tolerance.angle or np.linalg.norm(moved[i]) > tolerance.length * reach:
            yield f"axis {i + 1}"
    down = [np.array(study.arm.gravity or (0.0, 0.0, 0.0)) for study in (actual, true)]
    if np.linalg.norm(down[0] - down[1]) > tolerance.angle * np.linalg.norm(down[1]):
        yield "gravity"


def _axes(study: Study) -> tuple[FloatArray, FloatArray]:
    """Points on the axes and their directions at zero angle, in the frame of the base."""
    place, attitude = np.zeros(3), Rotation.identity()
    points, directions = [], []
    for joint in study.arm.joints:
        place = place + attitude.apply(joint.origin.xyz)
        attitude = attitude * Rotation.from_euler("xyz", joint.origin.rpy)
        axis = np.array(joint.axis, dtype=np.float64)
        points.append(place)
        directions.append(attitude.apply(axis / np.linalg.norm(axis)))
    return np.array(points), np.array(directions)


def _differing_channels(
    actual: Log, true: Log, study: Study, drives: FloatArray, tolerance: Tolerance
) -> Iterator[str]:
    """Channels of one record; `drives` (2, n_joints), torque per voltage of both studies."""
    if abs(actual.sample_time / true.sample_time - 1.0) > tolerance.ratio:
        yield f"{actual.name} time"
        return
    for name, values in actual.channels.items():
        kind, i = channel_parts(name)
        if name not in true.channels:
            continue
        n = min(len(values), len(true.channels[name]))
        x, y = values[:n], true.channels[name][:n]
        if kind == "u":
            x, y = drives[0, i - 1] * x, drives[1, i - 1] * y
        scale, delay, offset, rest = _compare(x, y, true.sample_time)
        zero = abs(offset) if kind in _ANGLES else 0.0
        if kind == "theta_m":  # a whole turn of the link is no difference
            zero = abs(math.remainder(zero * study.arm.joints[i - 1].gear_ratio, 2.0 * np.pi))
        if (
            abs(scale - 1.0) > tolerance.ratio
            or abs(delay) > tolerance.delay
            or zero > tolerance.angle
            or rest > tolerance.rest
        ):
            yield f"{actual.name} {name}"


def _compare(x: FloatArray, y: FloatArray, T: float) -> tuple[float, float, float, float]:
    """Scale, delay [s], offset and unexplained share: x(t) = scale y(t - delay) + offset + rest."""
    edge = min(round(5.0 * _SMOOTHING / T) + 1, len(x) // 4)
    x, y = (gaussian_filter1d(v, _SMOOTHING / T)[edge:-edge] for v in (x, y))
    size = max(float(np.std(y)), 1e-9 * float(np.abs(y).max()), 1e-300)
    if np.std(y) <= 1e-9 * np.abs(y).max():
        return 1.0, 0.0, float(np.mean(x - y)), float(np.std(x)) / size
    columns = np.column_stack([(y - y.mean()) / size, np.gradient(y, T)])
    length = np.linalg.norm(columns, axis=0)
    solution = np.linalg.lstsq(columns / length, (x - x.mean()) / size, rcond=None)[0] / length
    rest = (x - x.mean()) / size - columns @ solution
    scale = float(solution[0])
    delay = -float(solution[1]) * size / scale if scale else np.inf
    return scale, delay, float(x.mean() - scale * y.mean()), float(np.sqrt(np.mean(rest**2)))
