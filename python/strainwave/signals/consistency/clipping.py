"""Saturated sensors: runs of equal samples at the largest or smallest reading."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import Clause, Correction, Log, Place, Relation, Suspicion, channel_parts
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import resolution_of
from strainwave.signals.hygiene.flat_tops import MAX_SATURATED_SHARE, find_saturated_runs

_IMU_KINDS = ("ax", "ay", "az", "gx", "gy", "gz")
_KINDS = ("a", "gyro", *_IMU_KINDS, "theta_l", "deflection", "tau_l", "torque", "omega_m")
# Kinds whose noise prevents runs of equal samples unless the sensor is saturated.
_NOISY_KINDS = ("a", "gyro", *_IMU_KINDS)
# Share of its range in all records that the motor must cover during a run for the run to count.
_MIN_MOTOR_MOTION_SHARE = 0.01
# Sensor resolutions of motion that a constant reading can hide.
_HIDDEN_RESOLUTIONS = 2.0


def measure_clipping(logs: Sequence[Log], arm: Arm) -> Iterator[tuple[Relation, Suspicion | None]]:
    """Yield the largest share of the samples at a sensor's limit, for each sensor channel.

    With a suspicion if the share is too large in a record.
    """
    for name in (f"{kind}{i}" for kind in _KINDS for i in range(1, arm.n_joints + 1)):
        given = {log.name: log for log in logs if name in log.channels}
        if not given:
            continue
        kind, i = channel_parts(name)
        motors = [x for log in logs if (x := log.channels.get(f"theta_m{i}")) is not None]
        travel, rests = max(map(np.ptp, motors), default=0.0), kind not in _NOISY_KINDS
        shares = {
            record: _clipped_share(log, name, float(travel), rests=rests)
            for record, log in given.items()
        }
        worst = max(shares, key=lambda record: shares[record])
        share, limit, place = shares[worst], MAX_SATURATED_SHARE, Place(channel=name)
        relation = Relation("clipped", place, share, 0.0, 0.0, share <= limit, limit)
        if share <= limit:
            yield relation, None
            continue
        others = tuple(r for r, x in shares.items() if x > limit and r != worst)
        clause = Clause(
            "clipped",
            channel=name,
            low=float(given[worst].channels[name].min()),
            high=float(given[worst].channels[name].max()),
            share=share,
            experiment=worst,
            others=Clause("also-in", records=others) if others else None,
        )
        change, remedy = Correction("log", name, "unusable", None), Clause("remedy/clipped")
        yield (
            relation,
            Suspicion(
                code="clipped",
                places=(place,),
                clause=clause,
                remedy_clause=remedy,
                corrections=(change,),
            ),
        )


def _clipped_share(log: Log, name: str, travel: float, *, rests: bool) -> float:
    """Share of the samples in runs of equal values at either extreme.

    If `rests` is true, counts only the runs during which the motor moves. `travel` is its range in
    all records; in a record in which it rests, its range is noise.
    """
    values, motor = log.channels[name], log.channels.get(f"theta_m{channel_parts(name)[1]}")
    runs = [run for ends in find_saturated_runs(values, rests=rests) for run in ends.tolist()]
    if rests and motor is not None:
        relative_resolution = resolution_of(values) / float(np.ptp(values)) if runs else 0.0
        min_motion = (_MIN_MOTOR_MOTION_SHARE + _HIDDEN_RESOLUTIONS * relative_resolution) * travel
        runs = [(start, stop) for start, stop in runs if np.ptp(motor[start:stop]) > min_motion]
    return float(sum(stop - start for start, stop in runs)) / len(values)
