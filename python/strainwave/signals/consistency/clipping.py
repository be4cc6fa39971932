"""Sensors at the end of their range: flat tops at the largest or smallest reading."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import Correction, Log, Suspicion
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import resolution_of
from strainwave.signals.hygiene.flat_tops import SHARE, ends_of_range

_KINDS = ("a", "gyro", "theta_l", "deflection", "torque", "omega_m")
_NOISY = ("a", "gyro")  # never three times the same, but at the end of the range
_GOES_ON = 0.01  # share of its motion that the motor makes while a sensor of its joint stands still
_STEPS = 2.0  # of the sensor's resolution that it need not show


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
                log.name: (_share(log, name, rests=kind not in _NOISY), log.channels[name])
                for log in logs
                if name in log.channels
            }
            worst = [record for record, (share, _) in shares.items() if share > SHARE]
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
                corrections=(Correction("log", name, "unusable", None),),
            )


def _share(log: Log, name: str, *, rests: bool) -> float:
    """Share of the samples in runs of equal values at either extreme.

    Of a channel that may rest there, those in which the motor goes on.
    """
    values, motor = log.channels[name], log.channels.get(f"theta_m{name[-1]}")
    runs = [run for ends in ends_of_range(values, rests=rests) for run in ends.tolist()]
    if rests and motor is not None:
        steps = resolution_of(values) / float(np.ptp(values)) if runs else 0.0
        least = (_GOES_ON + _STEPS * steps) * float(np.ptp(motor))
        runs = [(start, stop) for start, stop in runs if np.ptp(motor[start:stop]) > least]
    return float(sum(stop - start for start, stop in runs)) / len(values)
