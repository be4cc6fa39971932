"""Detection of spikes: outliers of a few samples."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from strainwave.domain import FloatArray, Log, channel_parts
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import (
    Defect,
    count_of,
    encoder_kinds,
    noisy_kinds,
    of_kinds,
)
from strainwave.signals.hygiene.isolated import (
    MAX_RETURN_ERROR,
    MAX_SPIKE_SAMPLES,
    classify_jumps,
)
from strainwave.signals.standstill import runs_of

# Minimum distance of a spike from the usual voltages, relative to their range.
_MIN_RANGE_MARGIN = {"open": 0.3, "servo": 1.0}
_EXCLUDED_SHARE = 1e-3  # share of samples on each side that the usual range excludes


def detect(log: Log, arm: Arm) -> list[Defect]:
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
