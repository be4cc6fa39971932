"""Flat tops: a sensor at the end of its range."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, IntArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import (
    NOISY,
    Defect,
    of_kinds,
    resolution_of,
)
from strainwave.signals.standstill import runs_of

RUN = 3
"""Equal samples at the extreme that make a flat top."""

SHARE = 1e-2
"""Of a record at the end of the range, from which a channel is `clipped` and the input refused."""

_LONGER = 6.0  # times as often as one count inside; a turning angle is there 2.4 times as often
_FEWEST_VALUES = 50  # different ones, below which a coarse channel has flat tops of its own
_FEWEST = 6  # samples at the end of the range in all: a peak has three or four
_CUT = 4.0  # steps of the resolution by which a signal leaves the end of its range at once


def detect(log: Log, _: Arm) -> list[Defect]:
    """Flat tops of noisy sensors, which never read the same three times but at their ends.

    More than `SHARE` of a record is a fault of the input, see `strainwave.signals.consistency`.
    """
    found = []
    for name, x in of_kinds(log, NOISY).items():
        for ends in ends_of_range(x, rests=False):
            runs = cut(x, ends)
            samples = int((runs[:, 1] - runs[:, 0]).sum())
            if _FEWEST <= samples <= SHARE * len(x):
                words = f"is at the end of its range, {x[runs[0, 0]]:.4g},"
                found += [
                    Defect("flat-tops", name, start, stop, float(abs(x[start])), words)
                    for start, stop in runs.tolist()
                ]
    return found


def cut(values: FloatArray, runs: IntArray) -> IntArray:
    """The runs that a signal enters or leaves faster than a peak of a smooth one.

    Parameters
    ----------
    values : (n_samples,)
    runs : (n_runs, 2)
        First sample and the one behind the last of each.

    Returns
    -------
    (n_cut, 2)
    """
    step = _CUT * resolution_of(values)
    before = np.abs(values[np.maximum(runs[:, 0] - 1, 0)] - values[runs[:, 0]])
    after = np.abs(values[np.minimum(runs[:, 1], len(values) - 1)] - values[runs[:, 0]])
    return runs[np.maximum(before, after) > step]


def ends_of_range(values: FloatArray, *, rests: bool) -> list[IntArray]:
    """Runs of equal values at the smallest and the largest, where these may be ends of a range.

    Zero is no end of a range, nor is, of an angle that may rest where it went, what it usually is.

    Parameters
    ----------
    values : (n_samples,)
    rests : bool
        Whether the channel may rest somewhere.

    Returns
    -------
    list of (n_runs, 2)
        First sample and the one behind the last of each.
    """
    low, high = float(values.min()), float(values.max())
    middle, size = float(np.median(values)), high - low
    if size == 0.0 or len(np.unique(values[:: max(1, len(values) // 4096)])) < _FEWEST_VALUES:
        return []
    found = []
    for extreme in (low, high):
        at_standstill = rests and abs(extreme - middle) < 0.25 * size
        if at_standstill or abs(extreme) < 1e-9 * size:
            continue
        at = np.abs(values - extreme) <= 1e-9 * size
        turns = at.sum() < _LONGER * _next_to(values, extreme, 1e-9 * size)
        if rests and turns:
            continue
        runs = runs_of(at)
        runs = runs[runs[:, 1] - runs[:, 0] >= RUN]
        found.append(cut(values, runs) if turns else runs)
    return found


def _next_to(values: FloatArray, extreme: float, alike: float) -> int:
    """How many samples are at the value that lies next to an extreme: an encoder's next count."""
    inside = np.abs(values - extreme)
    inside = inside[inside > alike]
    return int(np.count_nonzero(inside <= inside.min() + alike))
