"""Observations of the input check: values that are 1 or 0 if the input is consistent."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from strainwave.domain import Place, Relation, channel_parts
from strainwave.signals.consistency.evidence import (
    MIN_SHARE_OF_GAIN,
    Evidence,
    exchanged_tests,
    is_slow,
)
from strainwave.signals.consistency.input_delay import pool_delays
from strainwave.signals.consistency.motors import (
    Ratio,
    compare_torque_sensors,
    compute_reference_ratios,
    compute_servo_output_ratios,
    compute_velocity_ratios,
    effort_channel,
    estimate_torque_ratios,
    implied_mass,
    link_speed,
    regress_torques,
)
from strainwave.signals.consistency.regression import pool_estimates
from strainwave.signals.consistency.sensors import (
    IMU_ACCELEROMETERS,
    LINK_CHANNELS,
    Reading,
    regress_readings,
)
from strainwave.signals.consistency.torque_fit import (
    friction_shares,
    recall_quality,
)

Kind = Literal[
    "count",
    "prbs-clock",
    "servo-clock",
    "level",
    "reference",
    "servo",
    "velocity",
    "scale",
    "own-joint",
    "origin-motion",
    "gravity",
    "rotation-ratio",
    "delay",
    "drift",
    "inertia",
    "torque-ratio",
    "explained-share",
    "input-delay",
    "excited-joint",
    "limit",
    "tilt",
    "torque-fit",
    "torque-prediction",
    "presence",
    "torque-sensor",
    "friction",
    "mass",
    "speed",
]

# Minimum significance of a contradiction, in standard deviations.
_MIN_SIGNIFICANCE = 5.0
# The same for a share below its bound.
_BOUND_SIGNIFICANCE = 2.0
# The same for the sign of an inertia in one record, whose friction can imitate inertia.
_MIN_RECORD_SIGNIFICANCE = 10.0
# The same for the torque ratio, whose standard deviation includes friction errors.
_MIN_TORQUE_SIGNIFICANCE = 3.5
_MAX_INPUT_DELAY_SAMPLES = 1.25
"""Tolerated delay of a command in sampling periods; logs hold the value before or after a tick."""
_MAX_INPUT_DELAY = 1.25e-3
"""Tolerated delay of a command [s]; buses and drives commonly have delays of up to 1 ms."""

_MIN_PREDICTED_SHARE = 0.3
"""Share of the torques that the arm predicts on held-out stretches below which units are doubted;
measured arms with strong friction reach 0.6."""
_MIN_PRESENCE = 0.1
"""Range of a reading over that of its prediction below which a silent channel is dead."""
_SHARES = ("torque-prediction", "friction", "presence")
"""Kinds whose value must exceed the tolerance."""
_SIZES = ("mass", "speed")
"""Kinds whose value must not exceed 1."""
_MIN_FRICTION = 0.03
"""Share of friction in a motor's torque below which the effort has none; gears have 0.1 to 0.7."""
_MAX_DENSITY = 3000.0
"""Largest mass over the cube of the reach of an arm [kg/m^3]; arms with a load have 5 to 300."""
_MAX_SPEED = 40.0
"""Largest plausible speed of a joint [rad/s]; arms reach 2 to 20, in degrees more than 60."""

_TOLERANCE: dict[Kind, float] = {
    "count": 0.03,  # rounding of the counts in a data sheet
    "prbs-clock": 2e-3,  # crystal clocks are accurate to 1e-4
    "servo-clock": 2e-3,
    "level": 1.0,  # the amplifier gain can differ from 1
    "reference": 0.5,  # tracking error of a servo; units differ by at least a factor of 2
    "servo": 3.0,  # the integrator state and the limit are unknown
    "velocity": 0.05,
    "scale": 0.05,  # range that the whole-arm fit corrects
    "own-joint": 0.08,
    "origin-motion": 0.12,
    "gravity": 0.08,
    "rotation-ratio": 0.12,
    "delay": 5e-3,  # [s] range that the whole-arm fit corrects
    "input-delay": _MAX_INPUT_DELAY,
    "drift": 2e-4,  # [s/s]
    "limit": 1.0,  # a factor of two, because the stated limit can exclude an added PRBS
    "tilt": 0.3,  # of g; tables and brackets are level to 17 degrees
    "excited-joint": 0.0,
    "torque-fit": 0.0,  # better explanations were tested
    "torque-prediction": _MIN_PREDICTED_SHARE,
    "presence": _MIN_PRESENCE,
    "torque-sensor": 0.3,  # losses of a gear that grow with its load
    "friction": _MIN_FRICTION,
    "torque-ratio": 0.5,  # the rigid fit detects smaller errors with higher accuracy
}
"""Tolerated relative difference from 1, or absolute value of delays, `drift` and `tilt`."""

_MODEL_ERROR: dict[Kind, float] = {
    "reference": 0.02,
    "servo": 0.1,
    "velocity": 0.005,
    "scale": 0.008,
    "own-joint": 0.012,
    "origin-motion": 0.008,
    "gravity": 0.01,
    "rotation-ratio": 0.02,
    "delay": 4e-4,
    "tilt": 0.01,
    "torque-sensor": 0.15,  # as gears' losses differ between records
    "drift": 0.0,  # follows from the floor of the delay and the length of the record
}
"""Model error of an observation in one record: springs, friction and servo lag, without noise."""

_PARTS: tuple[Kind, ...] = ("scale", "own-joint", "gravity")
_IMU_TOLERANCE = 0.25
"""Tolerance of a scale of an IMU's accelerometers; some axes read only a small part of a motion,
which the elasticity of the gears changes. Units and axes differ by more."""

# Largest error of the own-joint scale that counts as correct; calibrations are accurate to 1 %.
_MAX_SCALE_ERROR = 0.025
_LENGTH_TOLERANCE = 0.04
"""Tolerated relative error of link_length if the own-joint scale is correct."""

_EXPECTED: dict[Kind, float | None] = {
    **dict.fromkeys(("delay", "drift", "input-delay", "tilt"), 0.0),
    "inertia": None,
}
"""Values for consistent input other than 1; None: any positive value."""

_ABSOLUTE_KINDS = ("delay", "drift", "input-delay", "tilt")
"""Kinds whose value is 0 for consistent input; that of others is 1."""

# Minimum explained share of the variance of a link sensor.
_MIN_EXPLAINED_SHARE = 0.95
# Minimum explained share for the delay and the parts of a reading to be evaluated.
_MIN_PARTLY_EXPLAINED_SHARE = 0.5
# Weight of a signal that its prediction does not explain; no other observation is available.
_UNEXPLAINED_WEIGHT = 2.0
# Minimum explained share of servo outputs and torques; friction reduces it.
_MIN_MOTOR_EXPLAINED_SHARE = 0.8
# Minimum signal-to-noise ratio of a link sensor's record.
_MIN_SIGNAL_TO_NOISE = 5.0


@dataclass(frozen=True, slots=True)
class Observation:
    """One value that tests the consistency of the input."""

    kind: Kind
    place: Place  # channel, record, or joint of an equation
    value: float
    std: float
    tolerance: float | None = None  # None: tolerance of the kind

    @property
    def joint(self) -> int | None:
        """Joint of the place, from 1; None for a record."""
        if self.place.channel is None:
            return self.place.joint
        return channel_parts(self.place.channel)[1]

    @property
    def is_of_link(self) -> bool:
        """Whether the observation is about a link sensor."""
        return (
            self.place.channel is not None and channel_parts(self.place.channel)[0] in LINK_CHANNELS
        )

    @property
    def is_of_joint_equation(self) -> bool:
        """Whether the observation is about the torque equation of a single joint."""
        is_share = self.kind == "explained-share" and self.place.channel is None
        return is_share or self.kind in ("inertia", "torque-ratio")

    @property
    def _is_of_imu(self) -> bool:
        """Whether the observation is about an accelerometer of an IMU."""
        kind = channel_parts(self.place.channel)[0] if self.place.channel else ""
        return kind in IMU_ACCELEROMETERS

    @property
    def least(self) -> float | None:
        """Smallest value of consistent input, of a share; None for other kinds."""
        if self.kind == "explained-share":
            is_partial = self._is_of_imu or not self.is_of_link
            return _MIN_MOTOR_EXPLAINED_SHARE if is_partial else _MIN_EXPLAINED_SHARE
        return _TOLERANCE[self.kind] if self.kind in _SHARES else None

    @property
    def accuracy(self) -> float:
        """Largest difference from the expected value of consistent input; 0 of a largest size."""
        if self.kind in _SIZES:
            return 0.0
        if self.least is not None:
            return _BOUND_SIGNIFICANCE * self.std
        certain = _MIN_TORQUE_SIGNIFICANCE if self.kind == "torque-ratio" else _MIN_SIGNIFICANCE
        return max(self._tolerance, certain * self.std)

    @property
    def _tolerance(self) -> float:
        if self.kind == "inertia":
            return 0.0  # only the sign is tested
        if self._is_of_imu and self.kind in _PARTS:
            return _IMU_TOLERANCE
        return self.tolerance or _TOLERANCE[self.kind]

    @property
    def contradicts(self) -> bool:
        """Whether the error exceeds the tolerance and is statistically significant."""
        if self.least is not None:
            return self.value + self.accuracy < self.least
        if self.kind in _SIZES:
            return self.value > 1.0
        if self.kind in _ABSOLUTE_KINDS:
            return abs(self.value) > self.accuracy
        if self.value <= 0.0 or self.kind == "inertia":
            return self.value < -_MIN_SIGNIFICANCE * self.std
        certain = _MIN_TORQUE_SIGNIFICANCE if self.kind == "torque-ratio" else _MIN_SIGNIFICANCE
        is_certain = abs(self.value - 1.0) > certain * self.std
        return bool(is_certain and abs(np.log(self.value)) > np.log1p(self._tolerance))

    @property
    def weight(self) -> float:
        """Weight of the observation if it contradicts."""
        return _UNEXPLAINED_WEIGHT if self.kind == "explained-share" else 1.0


def relations_of(observations: Iterable[Observation]) -> tuple[Relation, ...]:
    """The observations as relations, each place once with its worst value.

    The explained share of a motor signal tests nothing: friction and servo limits reduce it.
    """
    worst: dict[tuple[Kind, Place], Observation] = {}
    for each in observations:
        known = worst.setdefault((each.kind, each.place), each)
        if each.contradicts and not known.contradicts:
            worst[each.kind, each.place] = each
    tests = (o for o in worst.values() if o.kind != "explained-share" or o.is_of_link)
    return tuple(
        Relation(
            each.kind,
            each.place,
            each.value,
            each.std,
            _EXPECTED.get(each.kind, 1.0) if each.least is None else each.least,
            not each.contradicts,
            each.accuracy,
            "least" if each.least is not None else "most" if each.kind in _SIZES else "equal",
        )
        for each in tests
    )


def compute_observations(evidence: Evidence) -> Iterator[Observation]:
    """Compute the observations of the input check, those of little effort first."""
    yield from _observe_counts(evidence)
    yield from _observe_clocks(evidence)
    yield from _observe_test_signals(evidence)
    yield from _observe_input_delays(evidence)
    yield from _observe_ratios("reference", compute_reference_ratios(evidence))
    yield from _observe_ratios("servo", compute_servo_output_ratios(evidence))
    yield from _observe_ratios("velocity", compute_velocity_ratios(evidence))
    yield from _observe_ratios("torque-sensor", compare_torque_sensors(evidence))
    yield from _observe_sizes(evidence)
    yield from _observe_torque_fit(evidence)
    yield from _observe_sensors(evidence)
    yield from _observe_torques(evidence)


def _observe_counts(evidence: Evidence) -> Iterator[Observation]:
    for joint, count in evidence.counts.items():
        per_turn = evidence.arm.joints[joint - 1].encoder_counts
        if per_turn:
            ratio = count * per_turn / (2.0 * np.pi)
            place = Place(channel=f"theta_m{joint}")
            yield Observation("count", place, ratio, 1e-3 * ratio)


def _observe_clocks(evidence: Evidence) -> Iterator[Observation]:
    servo = evidence.arm.servo
    for record in evidence.records:
        experiment, clocks = record.experiment, record.clocks
        place = Place.in_records(experiment.name)
        if clocks.prbs is not None and experiment.prbs is not None:
            ratio = clocks.prbs / experiment.prbs.clock
            yield Observation("prbs-clock", place, ratio, 2e-4 * ratio)
        if clocks.servo is not None and servo is not None:
            ratio = clocks.servo / servo.period
            yield Observation("servo-clock", place, ratio, 2e-4 * ratio)
        name = f"u{experiment.joint}"
        if name in clocks.level and experiment.prbs is not None:
            ratio = clocks.level[name] / experiment.prbs.amplitude
            yield Observation("level", Place(channel=name), max(ratio, 1e-12), 1e-3 * ratio)


def _observe_test_signals(evidence: Evidence) -> Iterator[Observation]:
    """Compare the stated excited joint and the servo limit with the commands.

    A stated PRBS that is in no command contradicts if the command of a motion contains one.
    """
    silent, signalling = exchanged_tests(evidence)
    for name in silent if signalling else ():
        yield Observation("excited-joint", Place.in_records(name), -1.0, 0.0)
    for record in evidence.records:
        experiment, excited = record.experiment, record.clocks.excited
        joint = experiment.joint
        if joint is not None and excited and experiment.use in ("frequency", "sweep"):
            is_stated = bool({f"u{joint}", f"torque{joint}"} & excited)
            place = Place.in_records(experiment.name, joint=joint)
            yield Observation("excited-joint", place, 2.0 * is_stated - 1.0, 0.0)
        if evidence.arm.servo is None:
            continue
        for i, control in enumerate(experiment.control, start=1):
            voltage = record.channels.get(f"u{i}")
            if control == "servo" and voltage is not None:
                share = float(np.max(np.abs(voltage))) / evidence.arm.servo.limit
                place = Place(channel=f"u{i}")
                yield Observation("limit", place, max(1.0, share), 1e-3 * share)


def _observe_input_delays(evidence: Evidence) -> Iterator[Observation]:
    for joint in range(1, evidence.arm.n_joints + 1):
        profiles = [(r, r.delays[joint]) for r in evidence.records if joint in r.delays]
        delay = pool_delays([profile for _, profile in profiles])
        if delay is None:
            continue
        record, profile = profiles[0]
        name = next((n for n in (f"torque{joint}", f"u{joint}") if n in record.channels), "")
        corrected = record.shifted.get(name, 0.0) - record.shifted.get(f"theta_m{joint}", 0.0)
        tolerance = max(_MAX_INPUT_DELAY, _MAX_INPUT_DELAY_SAMPLES * profile.sample_time)
        remaining = delay.value - corrected
        place = Place(channel=name)
        yield Observation("input-delay", place, remaining, delay.std, tolerance)


def _observe_torque_fit(evidence: Evidence) -> Iterator[Observation]:
    """Unexplained variance of all torques over that with the best explanation."""
    if "desired" in {each.meaning for each in evidence.study.channels.values()}:
        return  # torques of a set-point, not of the motion
    fit = recall_quality(evidence) if evidence.explanations is not None else None
    if fit is None or evidence.explanations is None:
        return
    place = Place(part="arm")
    ratio, tolerance = 1.0, None
    if evidence.explanations:
        best = evidence.explanations[0]
        ratio = max(float(np.exp(2.0 * (fit.cost - best.cost))), 1.0)
        tolerance = (
            float(np.exp((1.0 - MIN_SHARE_OF_GAIN) * (best.gain.mean if best.gain else 0.0))) - 1.0
        )
    yield Observation("torque-fit", place, ratio, 0.0, tolerance)
    yield from _observe_friction(evidence)
    if not evidence.arm.has_planar_program:
        yield Observation("torque-prediction", place, 1.0 - float(np.median(fit.unexplained)), 0.0)


def _observe_friction(evidence: Evidence) -> Iterator[Observation]:
    """Median share of friction in the motors' torques; sensors behind the gears measure none."""
    shares = friction_shares(evidence)
    joints = [i for i in shares if not evidence.arm.joints[i - 1].torque_at_link]
    names = [f"torque{i}" for i in joints if f"torque{i}" in evidence.channels]
    meanings = {evidence.channel(name).meaning for name in names}
    if names and meanings <= {"motor", "without-gravity"}:
        value, std = np.median([*shares.values()], axis=0).tolist()
        yield Observation("friction", Place(part="arm"), value, std)


def _observe_sizes(evidence: Evidence) -> Iterator[Observation]:
    """Speed and implied mass over the largest plausible ones."""
    speed, mass = link_speed(evidence), implied_mass(evidence)
    if speed is not None:
        yield Observation("speed", Place(part="arm"), speed / _MAX_SPEED, 0.0)
    if mass is not None:
        reach = sum(float(np.linalg.norm(j.origin.xyz)) for j in evidence.arm.joints[1:])
        ratio = mass / (_MAX_DENSITY * reach**3)
        yield Observation("mass", Place(part="arm"), ratio, 0.0)


def _observe_ratios(kind: Kind, ratios: Iterable[Ratio]) -> Iterator[Observation]:
    by_channel: dict[str, list[Ratio]] = {}
    for each in ratios:
        by_channel.setdefault(each.channel, []).append(each)
    for channel, all_records in by_channel.items():
        best = max(each.explained for each in all_records)
        clear = [each for each in all_records if each.explained > 0.8 * best]
        stds = [float(np.hypot(e.std, _MODEL_ERROR[kind] * abs(e.value))) for e in clear]
        value, std = pool_estimates([e.value for e in clear], stds)
        place = Place(channel=channel)
        yield Observation("explained-share", place, best, 0.0)
        is_strict = kind in ("reference", "torque-sensor")  # a servo can lag, and a torque be noise
        if best > (_MIN_EXPLAINED_SHARE if is_strict else _MIN_PARTLY_EXPLAINED_SHARE):
            yield Observation(kind, place, value, std)


def _observe_sensors(evidence: Evidence) -> Iterator[Observation]:
    for channel, all_records in regress_readings(evidence):
        readings = [each for each in all_records if each.signal > _MIN_SIGNAL_TO_NOISE]
        silent = [
            each.size
            for each in all_records
            if each.signal <= _MIN_SIGNAL_TO_NOISE < each.expected_signal
        ]
        if silent:
            yield Observation("presence", Place(channel=channel), max(silent), 0.0)
        if readings:
            yield from _observe_sensor(Place(channel=channel), readings)


def _observe_sensor(place: Place, readings: list[Reading]) -> Iterator[Observation]:
    """Observations of one link channel, averaged over the records `readings`."""

    def mean(kind: Kind, values: list[float], stds: list[float]) -> Observation:
        relative = 1.0 if kind in _ABSOLUTE_KINDS else max(map(abs, values))
        floor = _MODEL_ERROR[kind] * relative
        value, std = pool_estimates(values, [float(np.hypot(d, floor)) for d in stds])
        return Observation(kind, place, value, std)

    best = max(each.explained for each in readings)
    yield Observation("explained-share", place, best, 0.0)
    yield mean("scale", [e.scale for e in readings], [e.scale_std for e in readings])
    if best < _MIN_PARTLY_EXPLAINED_SHARE:
        return
    yield mean("delay", [e.delay for e in readings], [e.delay_std for e in readings])
    drift_stds = [
        float(np.hypot(e.drift_std, 2.0 * _MODEL_ERROR["delay"] / e.seconds)) for e in readings
    ]
    tilts = [e.tilt for e in readings if e.tilt is not None]
    if tilts:
        yield mean("tilt", [v for v, _ in tilts], [s for _, s in tilts])
    yield mean("drift", [e.drift for e in readings], drift_stds)
    parts: tuple[Kind, ...] = ("own-joint", "origin-motion", "gravity")
    is_own_scale_correct = False
    for part in parts:
        scales = [e.parts[part] for e in readings if part in e.parts and len(e.parts) > 1]
        if not scales:
            continue
        observation = mean(part, [v for v, _ in scales], [s for _, s in scales])
        if part == "own-joint":
            is_own_scale_correct = abs(observation.value - 1.0) < _MAX_SCALE_ERROR
        if part == "origin-motion" and is_own_scale_correct:  # The scale of the sensor is correct.
            observation = replace(observation, tolerance=_LENGTH_TOLERANCE)
        yield observation
    rotation_ratios = [e.rotation_ratio for e in readings if e.rotation_ratio is not None]
    if rotation_ratios:
        yield mean(
            "rotation-ratio", [v for v, _ in rotation_ratios], [s for _, s in rotation_ratios]
        )


def _observe_torques(evidence: Evidence) -> Iterator[Observation]:
    estimates = []
    for each in regress_torques(evidence):
        name = effort_channel(evidence.channels, each.joint)
        estimates.append(each)
        yield Observation("inertia", Place(channel=name), each.inertia, each.inertia_std)
        yield Observation("explained-share", Place(joint=each.joint), each.explained, 0.0)
    slow = [r for r in evidence.records if is_slow(r.experiment)]
    for record in slow if len(slow) > 1 else ():  # short records determine the sign alone
        for each in regress_torques(evidence, record):
            if each.inertia < -_MIN_RECORD_SIGNIFICANCE * each.inertia_std:
                name = effort_channel(evidence.channels, each.joint)
                place = Place(channel=name, experiments=(record.experiment.name,))
                yield Observation("inertia", place, each.inertia, each.inertia_std)
    if not evidence.arm.has_planar_program:
        return  # the fit of one arm to all torques compares more than one pair of equations
    for joint, ratio in estimate_torque_ratios(estimates).items():
        yield Observation("torque-ratio", Place(joint=joint, key="torque_per_volt"), *ratio)
