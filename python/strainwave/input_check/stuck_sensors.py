"""Sensors that do not follow the motion: saturated ones, and motor encoders that stand still."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import Clause, Correction, Log, Place, Relation, Suspicion, channel_parts
from strainwave.domain.keys import JointNumber
from strainwave.dynamics.arm import Arm
from strainwave.input_check.sensors import IMU_CHANNELS
from strainwave.input_check.timing import find_excited_inputs
from strainwave.signals.hygiene.defects import resolution_of
from strainwave.signals.hygiene.noisy_sensors import MAX_SATURATED_SHARE, find_saturated_runs

# Kinds whose noise prevents runs of equal samples unless the sensor is saturated.
_NOISY_KINDS = ("a", "gyro", *IMU_CHANNELS)
_KINDS = (*_NOISY_KINDS, "theta_l", "deflection", "tau_l", "torque", "omega_m")
# Share of its range in all records that the motor must cover during a run for the run to count.
_MIN_MOTOR_MOTION_SHARE = 0.01
# Sensor resolutions of motion that a constant reading can hide.
_HIDDEN_RESOLUTIONS = 2.0
# Kinds of channels whose integral is the travel of a motor, and those that are an angle themselves.
_RATES, _ANGLES = ("ref", "omega_m"), ("theta_l",)
# Travel over the largest of all joints and records above which a channel shows motion. The noise
# and the offset of the rate of a joint at rest integrate to less.
_MIN_TRAVEL_SHARE = 0.05
# Readings of an encoder that follows a motion; at rest it dithers by a count about one reading.
_MIN_READINGS = 4


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
        records = tuple(r for r, x in shares.items() if x > limit and r != worst)
        others = Clause("also-in", records=records) if records else None
        low, high = (float(f(given[worst].channels[name])) for f in (np.min, np.max))
        ends = {"low": low, "high": high, "share": share}
        clause = Clause("clipped", channel=name, experiment=worst, others=others, **ends)
        fault = Suspicion(
            code="clipped",
            places=(place,),
            clause=clause,
            remedy_clause=Clause("remedy/clipped"),
            corrections=(Correction("log", name, "unusable", None),),
        )
        yield relation, fault if share > limit else None


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


def measure_standing_encoders(
    logs: Sequence[Log], arm: Arm
) -> Iterator[tuple[Relation, Suspicion | None]]:
    """Yield the least number of readings of each motor encoder in a record of motion.

    With a suspicion if an encoder stands still: in some records, or in general. A reference that a
    servo follows, a logged rate, a link angle and a test signal show motion; a torque does not,
    since joints are held against gravity.
    """
    moving = _moving_joints(logs, arm.n_joints)
    for i in range(1, arm.n_joints + 1):
        name = f"theta_m{i}"
        readings = {
            log.name: len(np.unique(log.channels[name])) for log in logs if (log.name, i) in moving
        }
        if not readings:
            continue
        records = tuple(record for record, n in readings.items() if n < _MIN_READINGS)
        place = Place(records if len(records) < len(readings) else (), name)
        n, least = float(min(readings.values())), float(_MIN_READINGS)
        relation = Relation("readings", place, n, 0.0, least, n >= least, 0.0, "least")
        sources = tuple(dict.fromkeys(moving[record, i] for record in records))
        clause = Clause("dead-channel/encoder", channel=name, records=records, sources=sources)
        remedy = Clause("remedy/encoder", channel=name, records=records, sources=sources)
        fault = Suspicion(code="dead-channel", places=(place,), clause=clause, remedy_clause=remedy)
        yield relation, fault if records else None


def _moving_joints(logs: Sequence[Log], n_joints: int) -> dict[tuple[str, JointNumber], str]:
    """Records and joints that move, each with a channel that shows it."""
    moving = {
        (log.name, joint): name
        for log in logs
        if (joint := log.experiment.joint) and log.experiment.use in ("frequency", "sweep")
        for name in find_excited_inputs(log) & {f"u{joint}", f"torque{joint}"}
    }
    for kind in (*_RATES, *_ANGLES):
        travels = {}
        for log in logs:
            for i in range(1, n_joints + 1):
                signal = log.channels.get(f"{kind}{i}")
                is_followed = kind != "ref" or log.experiment.control[i - 1] == "servo"
                if signal is not None and is_followed:
                    angle = np.cumsum(signal) * log.sample_time if kind in _RATES else signal
                    travels[log.name, i] = float(np.ptp(angle))
        least = _MIN_TRAVEL_SHARE * max(travels.values(), default=0.0)
        moving |= {(name, i): f"{kind}{i}" for (name, i), x in travels.items() if x > least}
    return moving
