"""Sensors at the end of their range: flat tops at the largest or smallest reading."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import FloatArray, Log, Suspicion
from strainwave.dynamics.arm import Arm

_KINDS = ("a", "gyro", "theta_l", "deflection", "torque", "omega_m")
_NOISY = ("a", "gyro")  # never three times the same, but at the end of the range
_RUN = 3  # equal samples at the extreme that make a flat top
_SHARE = 1e-2  # of a record at the end of the range; robust weights cope with less
_LONGER = 6.0  # times as often as one count inside; a turning angle is there 2.4 times as often
_FEWEST_VALUES = 50  # different ones, below which a coarse channel has flat tops of its own


def clipped(logs: Sequence[Log], arm: Arm) -> Iterator[Suspicion]:
    """Channels that stay at their extremes again and again.

    Parameters
    ----------
    logs : sequence of Log
    arm : Arm

    Returns
    -------
    iterator of Suspicion
    """
    for kind in _KINDS:
        for i in range(1, arm.n_joints + 1):
            name = f"{kind}{i}"
            shares = {
                log.name: (_share(log.channels[name], rests=kind not in _NOISY), log.channels[name])
                for log in logs
                if name in log.channels
            }
            worst = [record for record, (share, _) in shares.items() if share > _SHARE]
            if not worst:
                continue
            first = max(worst, key=lambda record: shares[record][0])
            share, values = shares[first]
            others = f" (also in {', '.join(w for w in worst if w != first)})" if worst[1:] else ""
            yield Suspicion(
                code="clipped",
                where=name,
                message=(
                    f"{name} stays at {values.min():.4g} or {values.max():.4g} for "
                    f"{100.0 * share:.2g} % of {first}{others}: the sensor is at the end of "
                    "its range"
                ),
                remedy=(
                    "Lower the amplitude, or use a sensor of larger range; leave the channel out "
                    "of the study until then"
                ),
            )


def _share(values: FloatArray, *, rests: bool) -> float:
    """Share of the samples in runs of equal values at either extreme.

    Zero is no end of a range, nor is, of an angle that may rest where it went, what it usually is.
    """
    low, high = float(values.min()), float(values.max())
    middle, size = float(np.median(values)), high - low
    if size == 0.0 or len(np.unique(values[:: max(1, len(values) // 4096)])) < _FEWEST_VALUES:
        return 0.0
    share = 0.0
    for extreme in (low, high):
        at_standstill = rests and abs(extreme - middle) < 0.25 * size
        if at_standstill or abs(extreme) < 1e-9 * size:
            continue
        at = np.abs(values - extreme) <= 1e-9 * size
        if rests and at.sum() < _LONGER * _next_to(values, extreme, 1e-9 * size):
            continue
        edges = np.flatnonzero(np.diff(np.r_[0, at.astype(np.int8), 0]))
        runs = edges[1::2] - edges[::2]
        share += float(runs[runs >= _RUN].sum()) / len(values)
    return share


def _next_to(values: FloatArray, extreme: float, alike: float) -> int:
    """How many samples are at the value that lies next to an extreme: an encoder's next count."""
    inside = np.abs(values - extreme)
    inside = inside[inside > alike]
    return int(np.count_nonzero(inside <= inside.min() + alike))
