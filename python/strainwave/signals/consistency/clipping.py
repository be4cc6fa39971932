"""Saturated sensors: runs of equal samples at the largest or smallest reading."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import Clause, Correction, Log, Place, Suspicion, channel_parts
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import resolution_of
from strainwave.signals.hygiene.flat_tops import MAX_SATURATED_SHARE, find_saturated_runs

_KINDS = ("a", "gyro", "theta_l", "deflection", "torque", "omega_m")
# Kinds whose noise prevents runs of equal samples unless the sensor is saturated.
_NOISY_KINDS = ("a", "gyro")
# Share of the motor's range that the motor must cover during a run for the run to count.
_MIN_MOTOR_MOTION_SHARE = 0.01
# Sensor resolutions of motion that a constant reading can hide.
_HIDDEN_RESOLUTIONS = 2.0


def detect_clipping(logs: Sequence[Log], arm: Arm) -> Iterator[Suspicion]:
    """Yield one suspicion per channel that repeatedly stays at its largest or smallest reading."""
    for kind in _KINDS:
        for i in range(1, arm.n_joints + 1):
            name = f"{kind}{i}"
            shares = {
                log.name: (
                    _clipped_share(log, name, rests=kind not in _NOISY_KINDS),
                    log.channels[name],
                )
                for log in logs
                if name in log.channels
            }
            records = [
                record for record, (share, _) in shares.items() if share > MAX_SATURATED_SHARE
            ]
            if not records:
                continue
            first = max(records, key=lambda record: shares[record][0])
            share, values = shares[first]
            others = tuple(record for record in records if record != first)
            yield Suspicion(
                code="clipped",
                places=(Place(channel=name),),
                clause=Clause(
                    "clipped",
                    channel=name,
                    low=float(values.min()),
                    high=float(values.max()),
                    share=share,
                    experiment=first,
                    others=Clause("also-in", records=others) if others else None,
                ),
                remedy_clause=Clause("remedy/clipped"),
                corrections=(Correction("log", name, "unusable", None),),
            )


def _clipped_share(log: Log, name: str, *, rests: bool) -> float:
    """Share of the samples in runs of equal values at either extreme.

    If `rests` is true, counts only the runs during which the motor moves.
    """
    values, motor = log.channels[name], log.channels.get(f"theta_m{channel_parts(name)[1]}")
    runs = [run for ends in find_saturated_runs(values, rests=rests) for run in ends.tolist()]
    if rests and motor is not None:
        relative_resolution = resolution_of(values) / float(np.ptp(values)) if runs else 0.0
        min_motion = (_MIN_MOTOR_MOTION_SHARE + _HIDDEN_RESOLUTIONS * relative_resolution) * float(
            np.ptp(motor)
        )
        runs = [(start, stop) for start, stop in runs if np.ptp(motor[start:stop]) > min_motion]
    return float(sum(stop - start for start, stop in runs)) / len(values)
