"""Saturated sensors: runs of equal samples at the largest or smallest reading."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True)
class Clipping:
    """Shares of the samples of one channel at its largest or smallest reading, by record."""

    channel: str
    shares: Mapping[str, float]
    ranges: Mapping[str, tuple[float, float]]  # smallest and largest reading, by record

    @property
    def worst(self) -> str:
        """The record with the largest share."""
        return max(self.shares, key=lambda record: self.shares[record])

    @property
    def relation(self) -> Relation:
        """The largest share as a relation."""
        share, place = self.shares[self.worst], Place(channel=self.channel)
        return Relation(
            "clipped", place, share, 0.0, 0.0, share <= MAX_SATURATED_SHARE, MAX_SATURATED_SHARE
        )

    @property
    def suspicions(self) -> Iterator[Suspicion]:
        """A suspicion if the share is too large in a record."""
        records = [name for name, share in self.shares.items() if share > MAX_SATURATED_SHARE]
        if not records:
            return
        low, high = self.ranges[self.worst]
        others = tuple(record for record in records if record != self.worst)
        yield Suspicion(
            code="clipped",
            places=(Place(channel=self.channel),),
            clause=Clause(
                "clipped",
                channel=self.channel,
                low=low,
                high=high,
                share=self.shares[self.worst],
                experiment=self.worst,
                others=Clause("also-in", records=others) if others else None,
            ),
            remedy_clause=Clause("remedy/clipped"),
            corrections=(Correction("log", self.channel, "unusable", None),),
        )


def measure_clipping(logs: Sequence[Log], arm: Arm) -> Iterator[Clipping]:
    """Yield the shares of the samples at a sensor's limit, for each sensor channel."""
    for kind in _KINDS:
        for i in range(1, arm.n_joints + 1):
            name = f"{kind}{i}"
            given = [log for log in logs if name in log.channels]
            if given:
                rests = kind not in _NOISY_KINDS
                motor = f"theta_m{i}"
                travel = max(
                    (np.ptp(log.channels[motor]) for log in logs if motor in log.channels),
                    default=0.0,
                )
                shares = {
                    log.name: _clipped_share(log, name, float(travel), rests=rests) for log in given
                }
                values = {log.name: log.channels[name] for log in given}
                ranges = {key: (float(v.min()), float(v.max())) for key, v in values.items()}
                yield Clipping(name, shares, ranges)


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
