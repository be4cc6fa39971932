"""Observations of the input check: values that are 1 or 0 if the input is consistent.

`measure_clipping` and `measure_standing_encoders` detect sensors that do not follow the motion.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import Clause, Correction, Log, Place, Relation, Suspicion, channel_parts
from strainwave.domain.keys import JointNumber
from strainwave.domain.results.consistency import Bound
from strainwave.dynamics.arm import Arm
from strainwave.input_check.evidence import Evidence, PredictedSignal, exchanged_tests
from strainwave.input_check.sensors import (
    IMU_ACCELEROMETERS,
    IMU_CHANNELS,
    LINK_CHANNELS,
    compare_motor_signals,
    regress_readings,
)
from strainwave.input_check.timing import find_excited_inputs, pool_delays
from strainwave.input_check.torque_fit import friction_shares, recall_quality
from strainwave.input_check.torque_rows import implied_density, regress_torques
from strainwave.numerics.statistics import pool_estimates
from strainwave.signals.hygiene.defects import resolution_of
from strainwave.signals.hygiene.noisy_sensors import MAX_SATURATED_SHARE, find_saturated_runs


@dataclass(frozen=True, slots=True)
class Expected:
    """What consistent input gives for one kind of observation, and what a contradiction means."""

    code: str  # of a contradiction without a cause
    tolerance: float  # relative difference from an expected 1, absolute from 0; a bound
    model_error: float = 0.0  # of springs, friction and servo lag in one record, without noise
    expected: float | None = 1.0  # None: any positive value
    bound: Bound = "equal"
    certain: float = 5.0  # smallest significance of a contradiction, in standard deviations


EXPECTED: Mapping[str, Expected] = {
    "count": Expected("wrong-unit", 0.03),  # rounding of the counts in a data sheet
    "prbs-clock": Expected("clock-drift", 2e-3),  # crystal clocks are accurate to 1e-4
    "servo-clock": Expected("clock-drift", 2e-3),
    "level": Expected("wrong-unit", 1.0),  # the amplifier gain can differ from 1
    "limit": Expected("wrong-unit", 1.0),  # the stated limit can exclude an added PRBS
    "excited-joint": Expected("swapped-channels", 0.0),
    "reference": Expected("wrong-unit", 0.5, 0.02),  # units differ by a factor of 2
    "velocity": Expected("wrong-unit", 0.05, 0.005),
    "scale": Expected("wrong-unit", 0.05, 0.008),  # range that the whole-arm fit corrects
    "own-joint": Expected("wrong-geometry", 0.08, 0.012),
    "origin-motion": Expected("wrong-geometry", 0.12, 0.008),
    "gravity": Expected("wrong-unit", 0.08, 0.01),
    "rotation-ratio": Expected("wrong-gear-ratio", 0.12, 0.02),
    "tilt": Expected("wrong-geometry", 0.3, 0.01, 0.0),  # tables are level to 17 degrees
    "delay": Expected("misaligned", 5e-3, 4e-4, 0.0),  # [s] the whole-arm fit corrects less
    "drift": Expected("clock-drift", 2e-4, 0.0, 0.0),  # [s/s]; the floor of the delay is added
    "input-delay": Expected("misaligned", 1.25e-3, 0.0, 0.0),  # [s] buses need up to 1 ms
    "inertia": Expected("wrong-sign", 0.0, 0.0, None),
    "torque-fit": Expected("wrong-geometry", 0.0),  # better explanations were tested
    "torque-sensor": Expected("wrong-unit", 0.3, 0.15),  # losses of a gear grow with its load
    # share of friction in a motor's torque; gears have 0.1 to 0.7
    "friction": Expected("effort-without-friction", 0.0, 0.0, 0.03, "least", 2.0),
    "presence": Expected("dead-channel", 0.0, 0.0, 0.1, "least"),  # of a silent channel
    "mass": Expected("wrong-unit", 0.0, bound="most"),
    "explained-share": Expected("wrong-unit", 0.0, 0.0, 0.95, "least"),
}
"""One row per kind of observation."""

_MIN_MOTOR_EXPLAINED_SHARE = 0.8
"""The same of servo outputs, torques and accelerometers of IMUs; friction and elasticity reduce
it."""
_IMU_TOLERANCE, _OF_IMU_SCALES = 0.25, ("scale", "own-joint", "gravity")
"""Tolerance of a scale of an IMU's accelerometers; some axes read only a small part of a motion,
which the elasticity of the gears changes. Units and axes differ by more."""
_MAX_INPUT_DELAY_SAMPLES = 1.25
"""Tolerated delay of a command in sampling periods; logs hold the value before or after a tick."""
_MAX_DENSITY = 3000.0
"""Largest mass over the cube of the reach of an arm [kg/m^3]; arms with a load have 5 to 300."""
# Largest error of the own-joint scale that counts as correct; calibrations are accurate to 1 %.
# The tolerated relative error of link_length is then smaller.
_MAX_SCALE_ERROR, _LENGTH_TOLERANCE = 0.025, 0.04
_OF_PARTS = ("own-joint", "origin-motion", "gravity", "rotation-ratio")
# Minimum explained share for the delay and the parts of a reading to be evaluated.
_MIN_PARTLY_EXPLAINED_SHARE = 0.5
# Minimum signal-to-noise ratio of a link sensor's record.
_MIN_SIGNAL_TO_NOISE = 5.0


def observe(
    kind: str, place: Place, value: float, std: float = 0.0, tolerance: float | None = None
) -> Relation:
    """One value that tests the consistency of the input; `tolerance` replaces that of its kind.

    `place` is a channel, a record, or the joint of an equation.
    """
    test, channel_kind = EXPECTED[kind], channel_parts(place.channel or "")[0]
    expected, tolerance = test.expected, tolerance or test.tolerance
    if channel_kind in IMU_ACCELEROMETERS and kind in _OF_IMU_SCALES:
        tolerance = _IMU_TOLERANCE
    is_partial = channel_kind in IMU_ACCELEROMETERS or channel_kind not in LINK_CHANNELS
    if kind == "explained-share" and is_partial:
        expected = _MIN_MOTOR_EXPLAINED_SHARE
    if expected == 1.0 and value < 1.0:  # a factor in either direction
        tolerance /= 1.0 + tolerance
    random = test.certain * std
    accuracy = max(tolerance, random)
    if expected == 1.0 and value <= 0.0:
        accuracy = 1.0 + random  # a negative ratio is another sign
    excess = value - (expected or 0.0)
    if test.bound == "least" or expected is None:
        excess = -excess
    elif test.bound == "equal":
        excess = abs(excess)
    is_consistent = not excess > accuracy
    return Relation(kind, place, value, std, expected, is_consistent, accuracy, test.bound)


def is_of_link(each: Relation) -> bool:
    """Whether a relation is about a link sensor."""
    return channel_parts(each.place.channel or "")[0] in LINK_CHANNELS


def worst_relations(observations: Iterable[Relation]) -> tuple[Relation, ...]:
    """The observations, each place once with its worst value.

    The explained share of a motor signal tests nothing: friction and servo limits reduce it.
    """
    worst: dict[tuple[str, Place], Relation] = {}
    for each in observations:
        if each.kind != "explained-share" or is_of_link(each):
            known = worst.setdefault((each.kind, each.place), each)
            if known.is_consistent and not each.is_consistent:
                worst[each.kind, each.place] = each
    return tuple(worst.values())


def compute_observations(evidence: Evidence) -> Iterator[Relation]:
    """Compute the observations of the input check, those of little effort first."""
    yield from _observe_clocks(evidence)
    yield from _observe_test_signals(evidence)
    yield from _observe_input_delays(evidence)
    yield from _observe_ratios(compare_motor_signals(evidence))
    if (density := implied_density(evidence)) is not None:
        yield observe("mass", Place(part="arm"), density / _MAX_DENSITY)
    yield from _observe_torque_fit(evidence)
    for channel, readings in regress_readings(evidence):
        yield from _observe_sensor(Place(channel=channel), readings)
    for each in regress_torques(evidence):
        yield observe("inertia", Place(channel=each.channel), *each.values["inertia"])
        joint = channel_parts(each.channel)[1]
        yield observe("explained-share", Place(joint=joint), each.explained)


def _observe_clocks(evidence: Evidence) -> Iterator[Relation]:
    """Compare encoder counts, clocks and amplitudes with those of the study."""
    servo = evidence.arm.servo
    for joint, count in evidence.counts.items():
        if per_turn := evidence.arm.joints[joint - 1].encoder_counts:
            ratio = count * per_turn / (2.0 * np.pi)
            yield observe("count", Place(channel=f"theta_m{joint}"), ratio, 1e-3 * ratio)
    for record in evidence.records:
        experiment, place = record.experiment, Place.in_records(record.experiment.name)
        if record.prbs_clock is not None and experiment.prbs is not None:
            ratio = record.prbs_clock / experiment.prbs.clock
            yield observe("prbs-clock", place, ratio, 2e-4 * ratio)
        if record.servo_clock is not None and servo is not None:
            ratio = record.servo_clock / servo.period
            yield observe("servo-clock", place, ratio, 2e-4 * ratio)
        name = f"u{experiment.joint}"
        if name in record.levels and experiment.prbs is not None:
            ratio = record.levels[name] / experiment.prbs.amplitude
            yield observe("level", Place(channel=name), max(ratio, 1e-12), 1e-3 * ratio)


def _observe_test_signals(evidence: Evidence) -> Iterator[Relation]:
    """Compare the stated excited joint and the servo limit with the commands.

    A stated PRBS that is in no command contradicts if the command of a motion contains one.
    """
    silent, signalling = exchanged_tests(evidence)
    for name in silent if signalling else ():
        yield observe("excited-joint", Place.in_records(name), -1.0)
    for record in evidence.records:
        experiment, excited = record.experiment, record.excited
        joint = experiment.joint
        if joint is not None and excited and experiment.use in ("frequency", "sweep"):
            is_stated = bool({f"u{joint}", f"torque{joint}"} & excited)
            place = Place.in_records(experiment.name, joint=joint)
            yield observe("excited-joint", place, 2.0 * is_stated - 1.0)
        if evidence.arm.servo is None:
            continue
        for i, control in enumerate(experiment.control, start=1):
            voltage = record.channels.get(f"u{i}")
            if control == "servo" and voltage is not None:
                share = float(np.max(np.abs(voltage))) / evidence.arm.servo.limit
                place = Place(channel=f"u{i}")
                yield observe("limit", place, max(1.0, share), 1e-3 * share)


def _observe_input_delays(evidence: Evidence) -> Iterator[Relation]:
    for joint in range(1, evidence.arm.n_joints + 1):
        profiles = [(r, r.delays[joint]) for r in evidence.records if joint in r.delays]
        delay = pool_delays([profile for _, profile in profiles])
        if delay is None:
            continue
        record, profile = profiles[0]
        name = next((n for n in (f"torque{joint}", f"u{joint}") if n in record.channels), "")
        removed = record.removed_delays
        corrected = removed.get(name, 0.0) - removed.get(f"theta_m{joint}", 0.0)
        tolerance = _MAX_INPUT_DELAY_SAMPLES * profile.sample_time
        tolerance = max(EXPECTED["input-delay"].tolerance, tolerance)
        value = delay.value - corrected
        yield observe("input-delay", Place(channel=name), value, delay.std, tolerance)


def _observe_torque_fit(evidence: Evidence) -> Iterator[Relation]:
    """Unexplained variance of all torques over that with the best explanation.

    And the median share of friction in the torques of motors.
    """
    if "desired" in {each.meaning for each in evidence.study.channels.values()}:
        return  # torques of a set-point, not of the motion
    fit, best = recall_quality(evidence), evidence.best_fit
    if fit is None or best is None:
        return
    (cost, tolerance), place = best, Place(part="arm")
    ratio = max(float(np.exp(2.0 * (fit.cost - cost))), 1.0)
    yield observe("torque-fit", place, ratio, 0.0, tolerance)
    # sensors behind the gears measure no friction
    shares = friction_shares(evidence)
    joints = [i for i in shares if not evidence.arm.joints[i - 1].torque_at_link]
    names = [f"torque{i}" for i in joints if f"torque{i}" in evidence.channels]
    meanings = {evidence.channel(name).meaning for name in names}
    if names and meanings <= {"motor", "without-gravity"}:
        value, std = np.median([*shares.values()], axis=0).tolist()
        yield observe("friction", place, value, std)


def _observe_ratios(ratios: Iterable[PredictedSignal]) -> Iterator[Relation]:
    by_channel: dict[str, list[PredictedSignal]] = {}
    for each in ratios:
        by_channel.setdefault(each.channel, []).append(each)
    for channel, comparisons in by_channel.items():
        place, best = Place(channel=channel), max(each.explained for each in comparisons)
        yield observe("explained-share", place, best)
        (kind,) = comparisons[0].values
        least = None if kind == "velocity" else EXPECTED["explained-share"].expected
        if best > (least or _MIN_PARTLY_EXPLAINED_SHARE):
            yield from _pooled(kind, place, [e for e in comparisons if e.explained > 0.8 * best])


def _pooled(
    kind: str, place: Place, records: Sequence[PredictedSignal], tolerance: float | None = None
) -> Iterator[Relation]:
    """Mean of one kind of number over the records that have it."""
    estimates = [(each.values[kind], each.seconds) for each in records if kind in each.values]
    if not estimates:
        return
    size = max(abs(value) for (value, _), _ in estimates) if EXPECTED[kind].expected else 1.0
    floor, of_delay = size * EXPECTED[kind].model_error, 2.0 * EXPECTED["delay"].model_error
    stds = [
        float(np.hypot(std, of_delay / seconds if kind == "drift" else floor))
        for (_, std), seconds in estimates
    ]
    value, std = pool_estimates([value for (value, _), _ in estimates], stds)
    yield observe(kind, place, value, std, tolerance)


def _observe_sensor(place: Place, records: Sequence[PredictedSignal]) -> Iterator[Relation]:
    """Observations of one link channel."""
    silent = [r for r in records if r.signal <= _MIN_SIGNAL_TO_NOISE < r.expected_signal]
    if silent:
        yield observe("presence", place, max(each.size for each in silent))
    readings = [each for each in records if each.signal > _MIN_SIGNAL_TO_NOISE]
    if not readings:
        return
    best = max(each.explained for each in readings)
    yield observe("explained-share", place, best)
    is_own_scale_correct = False
    for kind in ("scale", "delay", "tilt", "drift", *_OF_PARTS):
        if kind != "scale" and best < _MIN_PARTLY_EXPLAINED_SHARE:
            return
        is_length = kind == "origin-motion" and is_own_scale_correct
        for each in _pooled(kind, place, readings, _LENGTH_TOLERANCE if is_length else None):
            if kind == "own-joint":
                is_own_scale_correct = abs(each.measured - 1.0) < _MAX_SCALE_ERROR
            yield each


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
