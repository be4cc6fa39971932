"""Isolated increments of a channel that motion cannot cause, and spikes: outliers of few samples.

The increments of a motion change by its acceleration. An increment that differs from both
neighbours far more than is usual is due to counting, transmission or a disturbance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray, Log, channel_parts
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import (
    Defect,
    count_of,
    encoder_kinds,
    noisy_kinds,
    of_kinds,
    resolution_of,
    usual_change,
)
from strainwave.signals.standstill import runs_of

MAX_SPIKE_SAMPLES = 3
"""Maximum duration of a spike [samples]."""

MAX_RETURN_ERROR = 0.35
"""Maximum residual offset after a spike, relative to its size."""

_MIN_RECORD_RATIO = 3.0  # minimum ratio to the usual value in the record
_MIN_LOCAL_RATIO = 5.0  # minimum ratio to the usual value nearby
# minimum size in units of the resolution; larger than quantization effects
_MIN_RESOLUTION_STEPS = 4.0
_COMPARISON_SAMPLES = 48  # number of samples on each side for comparison
_EXCLUDED_SAMPLES = 4  # number of adjacent samples on each side excluded from the comparison
# maximum number of candidates; more are a property of the channel, not defects
_MAX_CANDIDATES = 4000


@dataclass(frozen=True, slots=True)
class Jump:
    """An isolated increment."""

    sample: int  # first sample after the increment
    size: float  # difference from the adjacent increments


def classify_jumps(signal: FloatArray, count: float) -> tuple[list[tuple[int, int]], list[Jump]]:
    """Classify the jumps of a signal, (n_samples,), as spikes or permanent steps.

    A signal returns from a spike within `MAX_SPIKE_SAMPLES` samples.
    `count` is the quantization step, or zero if unknown. Returns spikes as (first sample, index
    after the last one), and permanent steps.
    """
    spikes: list[tuple[int, int]] = []
    steps: list[Jump] = []
    last_stop = 0  # end of the last spike
    for jump in detect_jumps(signal, count):
        start = jump.sample
        if start <= last_stop:
            continue
        speed = signal[start] - signal[start - 1] - jump.size
        ends = np.arange(start, min(start + MAX_SPIKE_SAMPLES, len(signal) - 1) + 1)
        offset = signal[ends] - signal[start - 1] - speed * (ends - start + 1)
        returns = ends[np.abs(offset) < MAX_RETURN_ERROR * abs(jump.size)].tolist()
        if returns:
            last_stop = returns[0]
            spikes.append((start, last_stop))
        else:
            steps.append(jump)
    return spikes, steps


def detect_jumps(signal: FloatArray, count: float) -> list[Jump]:
    """Detect all isolated increments of a signal, (n_samples,), in order of time.

    `count` is the quantization step, or zero if unknown.
    """
    if len(signal) < 4 * _COMPARISON_SAMPLES:
        return []
    increment = np.diff(signal)
    change = np.abs(np.diff(increment))
    contrast = np.zeros(len(increment))
    np.minimum(change[1:], change[:-1], out=contrast[1:-1])
    threshold = max(
        _MIN_RESOLUTION_STEPS * (count or resolution_of(signal)),
        _MIN_RECORD_RATIO * usual_change(contrast),
    )
    candidates = np.flatnonzero(contrast > threshold)
    if not 0 < len(candidates) <= _MAX_CANDIDATES:
        return []
    jumps = []
    for k in candidates.tolist():
        if contrast[k] > _MIN_LOCAL_RATIO * _usual_nearby(contrast, k):
            before = increment[max(0, k - _EXCLUDED_SAMPLES) : k]
            adjacent = np.r_[before, increment[k + 1 : k + 1 + _EXCLUDED_SAMPLES]]
            jumps.append(Jump(k + 1, float(increment[k] - np.median(adjacent))))
    return jumps


def _usual_nearby(contrast: FloatArray, k: int) -> float:
    """Usual value near a sample: the larger one of both sides, because a motion can begin there."""
    sides = [
        contrast[max(0, k - _COMPARISON_SAMPLES) : max(0, k - _EXCLUDED_SAMPLES)],
        contrast[k + _EXCLUDED_SAMPLES + 1 : k + 1 + _COMPARISON_SAMPLES],
    ]
    return max(
        (float(np.partition(s, -4)[-4]) for s in sides if len(s) > _EXCLUDED_SAMPLES),
        default=np.inf,
    )


# Minimum distance of a spike from the usual voltages, relative to their range.
_MIN_RANGE_MARGIN = {"open": 0.3, "servo": 1.0}
_EXCLUDED_SHARE = 1e-3  # share of samples on each side that the usual range excludes


def detect_spikes(log: Log, arm: Arm) -> list[Defect]:
    """Detect spikes of sensors that motion cannot cause, and of voltages outside their usual range.

    A voltage can step, so a spike must be well outside the range of the other samples.
    """
    detections = []
    for name, x in of_kinds(log, (*encoder_kinds(), *noisy_kinds())).items():
        detections += [
            _spike_defect(name, x, *span) for span in classify_jumps(x, count_of(name, arm))[0]
        ]
    for name, x in of_kinds(log, ("u",)).items():
        margin = _MIN_RANGE_MARGIN[log.experiment.control[channel_parts(name)[1] - 1]]
        detections += [_spike_defect(name, x, *span) for span in _find_outside_range(x, margin)]
    return detections


def _spike_defect(name: str, x: FloatArray, start: int, stop: int) -> Defect:
    """Defect record of a spike; its size is relative to the adjacent samples."""
    baseline = 0.5 * (x[max(0, start - 1)] + x[min(len(x) - 1, stop)])
    size = float(np.max(np.abs(x[start:stop] - baseline)))
    return Defect("spikes", name, start, stop, size)


def _find_outside_range(x: FloatArray, min_margin: float) -> Iterator[tuple[int, int]]:
    """Short runs outside the usual range by at least `min_margin` times this range."""
    k = max(1, int(_EXCLUDED_SHARE * len(x)))
    if len(x) <= 4 * k:
        return
    ordered = np.partition(x, (k, len(x) - 1 - k))
    low, high = float(ordered[k]), float(ordered[-1 - k])
    margin = min_margin * (high - low)
    for start, stop in runs_of((x > high + margin) | (x < low - margin)).tolist():
        if start == 0 or stop == len(x) or stop - start > MAX_SPIKE_SAMPLES:
            continue
        before = x[start - 1]
        if abs(x[stop] - before) < MAX_RETURN_ERROR * abs(x[start] - before):
            yield start, stop
