"""Detection of flat tops: a sensor in saturation at an end of its range."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, IntArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import Defect, noisy_kinds, of_kinds, resolution_of
from strainwave.signals.standstill import runs_of

MIN_REPEATED_SAMPLES = 3
"""Minimum number of equal samples at an extreme value that are a flat top."""

MAX_SATURATED_SHARE = 1e-2
"""Share of saturated samples above which a channel is `clipped` and the input is rejected."""

# Minimum ratio of the number of samples at the extreme value to the number at the adjacent value.
# At the reversal of an angle, the ratio is 2.4.
_MIN_EXTREME_COUNT_RATIO = 6.0
# minimum number of distinct values; coarser channels have flat tops anyway
_MIN_DISTINCT_VALUES = 50
# minimum total number of samples at an end of the range; a peak has 3 or 4
_MIN_SATURATED_SAMPLES = 6
_MIN_EDGE_STEPS = 4.0  # minimum step into or out of a flat top, in units of the resolution


def detect_flat_tops(log: Log, _: Arm) -> list[Defect]:
    """Detect flat tops of noisy sensors.

    These sensors repeat a value `MIN_REPEATED_SAMPLES` times only in saturation.
    More than `MAX_SATURATED_SHARE` of a record is a fault that the input check reports, see
    `strainwave.input_check`.
    """
    detections = []
    for name, x in of_kinds(log, noisy_kinds()).items():
        for end_runs in find_saturated_runs(x, rests=False):
            runs = select_abrupt_runs(x, end_runs)
            samples = int((runs[:, 1] - runs[:, 0]).sum())
            if _MIN_SATURATED_SAMPLES <= samples <= MAX_SATURATED_SHARE * len(x):
                level = float(x[runs[0, 0]])
                detections += [
                    Defect("flat-tops", name, start, stop, float(abs(x[start])), level)
                    for start, stop in runs.tolist()
                ]
    return detections


def select_abrupt_runs(values: FloatArray, runs: IntArray) -> IntArray:
    """Runs, (n_runs, 2), that a signal enters or leaves faster than the peak of a smooth signal.

    Each run is its first sample and the index after its last sample.
    """
    step = _MIN_EDGE_STEPS * resolution_of(values)
    before = np.abs(values[np.maximum(runs[:, 0] - 1, 0)] - values[runs[:, 0]])
    after = np.abs(values[np.minimum(runs[:, 1], len(values) - 1)] - values[runs[:, 0]])
    return runs[np.maximum(before, after) > step]


def find_saturated_runs(values: FloatArray, *, rests: bool) -> list[IntArray]:
    """Runs of equal values, (n_runs, 2), at the minimum and maximum, if these limit the range.

    Zero does not limit a range. For a channel that can rest (`rests`), an extreme near its median
    is a rest position and does not limit the range either. Each run is its first sample and the
    index after its last sample.
    """
    low, high = float(values.min()), float(values.max())
    median, span = float(np.median(values)), high - low
    if span == 0.0 or len(np.unique(values[:: max(1, len(values) // 4096)])) < _MIN_DISTINCT_VALUES:
        return []
    flat_tops = []
    for extreme in (low, high):
        at_standstill = rests and abs(extreme - median) < 0.25 * span
        if at_standstill or abs(extreme) < 1e-9 * span:
            continue
        at_extreme = np.abs(values - extreme) <= 1e-9 * span
        tolerance = 1e-9 * span
        inside = np.abs(values - extreme)
        inside = inside[inside > tolerance]
        adjacent = int(np.count_nonzero(inside <= inside.min() + tolerance))
        is_reversal = at_extreme.sum() < _MIN_EXTREME_COUNT_RATIO * adjacent
        if rests and is_reversal:
            continue
        runs = runs_of(at_extreme)
        runs = runs[runs[:, 1] - runs[:, 0] >= MIN_REPEATED_SAMPLES]
        flat_tops.append(select_abrupt_runs(values, runs) if is_reversal else runs)
    return flat_tops
