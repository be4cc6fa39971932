"""Detection of isolated increments of a channel that motion cannot cause.

The increments of a motion change by its acceleration. An increment that differs from both
neighbours far more than is usual is due to counting, transmission or a disturbance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.signals.hygiene.defects import resolution_of, usual_change

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
    return [
        Jump(k + 1, _jump_size(increment, k))
        for k in candidates.tolist()
        if contrast[k] > _MIN_LOCAL_RATIO * _usual_nearby(contrast, k)
    ]


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


def _jump_size(increment: FloatArray, k: int) -> float:
    """Difference of increment k from the median of the adjacent increments."""
    near = np.r_[
        increment[max(0, k - _EXCLUDED_SAMPLES) : k], increment[k + 1 : k + 1 + _EXCLUDED_SAMPLES]
    ]
    return float(increment[k] - np.median(near))
