"""Increments of a channel unlike those on either side of them, which no motion makes.

A motion's increments change by its acceleration; one that differs from both its neighbours far
more than the rest do, and stands alone, was not moved but counted, transmitted or disturbed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.signals.hygiene.defects import resolution_of, usual

LONGEST = 3
"""Samples of a spike."""

_RETURN = 0.35  # of a spike's size, by which the signal behind it may differ from that before
_ABOVE_ALL = 3.0  # times what is usual in the record
_ABOVE_NEAR = 5.0  # times what is usual about it
_COUNTS = 4.0  # steps of the channel's resolution, which quantisation cannot make
_NEAR = 48  # samples to either side that are compared
_OWN = 4  # of them that may belong to the same event
_MOST = 4000  # candidates; where there are more, the channel is like that


@dataclass(frozen=True, slots=True)
class Jump:
    """An increment that stands alone."""

    sample: int  # the first that it changes
    size: float  # by which it differs from the increments about it


def spikes_and_steps(
    signal: FloatArray, count: float = 0.0
) -> tuple[list[tuple[int, int]], list[Jump]]:
    """Jumps that come back within a few samples, and those that do not.

    Parameters
    ----------
    signal : (n_samples,)
    count : float
        By which it is quantised, where that is known.

    Returns
    -------
    spikes : list of (first sample, the one behind the last)
    steps : list of Jump
    """
    every = jumps(signal, count)
    spikes: list[tuple[int, int]] = []
    steps: list[Jump] = []
    behind = 0  # the last spike
    for jump in every:
        start = jump.sample
        if start <= behind:
            continue
        speed = signal[start] - signal[start - 1] - jump.size
        ends = np.arange(start, min(start + LONGEST, len(signal) - 1) + 1)
        off = signal[ends] - signal[start - 1] - speed * (ends - start + 1)
        back = ends[np.abs(off) < _RETURN * abs(jump.size)].tolist()
        if back:
            behind = back[0]
            spikes.append((start, behind))
        else:
            steps.append(jump)
    return spikes, steps


def jumps(signal: FloatArray, count: float = 0.0) -> list[Jump]:
    """All increments that no motion explains.

    Parameters
    ----------
    signal : (n_samples,)
    count : float
        By which it is quantised, where that is known.

    Returns
    -------
    list of Jump
        In order of time.
    """
    if len(signal) < 4 * _NEAR:
        return []
    increment = np.diff(signal)
    change = np.abs(np.diff(increment))
    apart = np.zeros(len(increment))
    np.minimum(change[1:], change[:-1], out=apart[1:-1])
    floor = max(_COUNTS * (count or resolution_of(signal)), _ABOVE_ALL * usual(apart))
    candidates = np.flatnonzero(apart > floor)
    if not 0 < len(candidates) <= _MOST:
        return []
    return [
        Jump(k + 1, _size(increment, k))
        for k in candidates.tolist()
        if apart[k] > _ABOVE_NEAR * _about(apart, k)
    ]


def _about(apart: FloatArray, k: int) -> float:
    """What is usual on that side of a sample where more is: a motion that begins goes on."""
    sides = [apart[max(0, k - _NEAR) : max(0, k - _OWN)], apart[k + _OWN + 1 : k + 1 + _NEAR]]
    return max((float(np.partition(s, -4)[-4]) for s in sides if len(s) > _OWN), default=np.inf)


def _size(increment: FloatArray, k: int) -> float:
    near = np.r_[increment[max(0, k - _OWN) : k], increment[k + 1 : k + 1 + _OWN]]
    return float(increment[k] - np.median(near))
