"""Spikes: a few samples far off, and back again."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from strainwave.domain import FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import ENCODERS, NOISY, Defect, count_of, joint_of, of_kinds
from strainwave.signals.hygiene.isolated import LONGEST, spikes_and_steps
from strainwave.signals.standstill import runs_of

_RETURN = 0.35  # of its size, by which the signal behind it may differ from that before
_BEYOND = {"open": 0.3, "servo": 1.0}  # ranges of all other voltages, by which a spike is outside
_FEWEST = 1e-3  # share of a record that may be outside its usual range


def detect(log: Log, arm: Arm) -> list[Defect]:
    """Spikes of sensors, which no motion explains, and of voltages, beyond all others.

    A voltage may step, so only what lies well outside the range of all others counts.
    """
    found = []
    for name, x in of_kinds(log, (*ENCODERS, *NOISY)).items():
        found += [_spike(name, x, *span) for span in spikes_and_steps(x, count_of(name, arm))[0]]
    for name, x in of_kinds(log, ("u",)).items():
        beyond = _BEYOND[log.experiment.control[joint_of(name) - 1]]
        found += [_spike(name, x, *span) for span in _beyond_range(x, beyond)]
    return found


def _spike(name: str, x: FloatArray, start: int, stop: int) -> Defect:
    around = 0.5 * (x[max(0, start - 1)] + x[min(len(x) - 1, stop)])
    size = float(np.max(np.abs(x[start:stop] - around)))
    return Defect("spikes", name, start, stop, size, "a spike")


def _beyond_range(x: FloatArray, beyond: float) -> Iterator[tuple[int, int]]:
    """Short runs outside the range of nearly all other samples, by so many ranges."""
    k = max(1, int(_FEWEST * len(x)))
    if len(x) <= 4 * k:
        return
    ordered = np.partition(x, (k, len(x) - 1 - k))
    low, high = float(ordered[k]), float(ordered[-1 - k])
    allowed = beyond * (high - low)
    for start, stop in runs_of((x > high + allowed) | (x < low - allowed)).tolist():
        alone = start > 0 and stop < len(x) and stop - start <= LONGEST
        if alone and abs(x[stop] - x[start - 1]) < _RETURN * abs(x[start] - x[start - 1]):
            yield start, stop
