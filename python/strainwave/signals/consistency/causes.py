"""Candidate causes: single faults of the input that can explain contradictions.

Structured causes come first: exchanged joints, gravity, a unit, a sign, a delay. Causes with an
estimated factor come last. Their values stay within the ranges that a study file accepts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from strainwave.domain import Correction, Place, Suspicion, channel_parts
from strainwave.domain.corrections import correction_text
from strainwave.domain.kinds import arm_keys
from strainwave.domain.study_limits import accepted_range
from strainwave.signals.consistency.evidence import Evidence
from strainwave.signals.consistency.message_text import format_number, join_names
from strainwave.signals.consistency.observations import Kind, Observation
from strainwave.signals.consistency.sensors import (
    LINK_CHANNELS,
    STANDARD_GRAVITY,
    estimate_high_pass_cutoff,
    estimate_rotation_factors,
)

_DEGREE = float(np.pi / 180.0)  # [rad]
# Maximum log ratio of an estimated factor to the factor of a unit; units differ by at least 5 %.
_UNIT_TOLERANCE = 0.04
# Maximum relative difference between an estimated reduction and a whole number.
_REDUCTION_TOLERANCE = 0.01
# Largest reduction for which the estimate distinguishes neighbouring whole numbers.
_MAX_DISTINCT_REDUCTION = 30
# Maximum relative difference between two factors that count as equal.
_MAX_FACTOR_DIFFERENCE = 0.02
# Maximum difference between the delays of channels with a common cause [s].
_MAX_DELAY_DIFFERENCE = 5e-4
# Ratios of encoder counts to encoder lines, and their inverses.
_QUADRATURE_FACTORS = (4.0, 2.0, 0.5, 0.25)
# Smallest factor that a unit can explain; a smaller ratio indicates a missing signal.
_MIN_RATIO = 1e-6
# Voltage above the supply of any servo drive [V]; a larger value is in millivolts.
_MAX_VOLTAGE = 1e3

_ANGLES = {"degrees": _DEGREE, "turns": 2.0 * np.pi, "mrad": 1e-3}
_RATES = {"deg/s": _DEGREE, "rpm": np.pi / 30.0, "turns/s": 2.0 * np.pi}
_UNITS: Mapping[str, Mapping[str, float]] = {
    "a": {"g": STANDARD_GRAVITY, "mm/s^2": 1e-3, "cm/s^2": 1e-2, "mg": 1e-3 * STANDARD_GRAVITY},
    "gyro": {"deg/s": _DEGREE, "mrad/s": 1e-3, "rpm": np.pi / 30.0},
    "theta_l": _ANGLES,
    "theta_m": _ANGLES,
    "omega_m": _RATES,
    "ref": _RATES,
    "u": {"mV": 1e-3},
    "torque": {"mN m": 1e-3},
}
"""Non-SI units of each kind of channel and their scale to SI."""

# Units of time and their scale to seconds.
_TIMES = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9, "minutes": 60.0}
_MOTOR_SIDE = ("u", "torque", "theta_m", "omega_m", "ref")
_ACCELERATIONS = ("a", "ax", "ay", "az")
_PAIRED = (*_MOTOR_SIDE, *LINK_CHANNELS, "deflection")
_BASIS = {  # kind of channel -> signals that determine its scale; {0} is the joint
    "a": "theta_m{0}",
    "gyro": "theta_m{0}",
    "theta_l": "theta_m{0}",
    "omega_m": "theta_m{0}",
    "ref": "theta_m{0}",
    "u": "the servo or the motion",
    "torque": "the motion",
}


@dataclass(frozen=True, slots=True)
class Cause:
    """A candidate fault of the input with the corrections that remove it."""

    suspicion: Suspicion
    has_estimated_factor: bool = (
        False  # the factor is an estimate, not a unit, a sign or an exchange
    )


def propose_causes(evidence: Evidence, contradictions: Sequence[Observation]) -> Iterator[Cause]:
    """Yield all candidate causes, structured causes first."""
    yield from _propose_time_bases(evidence, contradictions)
    yield from _propose_input_delays(evidence, contradictions)
    yield from _propose_test_signals(evidence, contradictions)
    yield from _propose_gravity(evidence)
    yield from _propose_exchanges(evidence, contradictions)
    yield from _propose_angle_units(evidence, contradictions)
    yield from _propose_ac_coupling(evidence, contradictions)
    yield from _propose_sensor_delays(evidence, contradictions)
    joints = {o.joint for o in contradictions if o.joint is not None}
    if any(o.kind == "torque-ratio" for o in contradictions):
        joints = set(range(1, evidence.arm.n_joints + 1))
    elif joints:
        joints |= set(range(1, max(joints)))  # readings depend on the joints before a link
    estimated_causes: list[Cause] = []
    for joint in sorted(joints):
        for cause in _propose_joint_causes(evidence, contradictions, joint):
            if cause.has_estimated_factor:
                estimated_causes.append(cause)
            else:
                yield cause
    yield from estimated_causes


def _propose_joint_causes(
    evidence: Evidence, contradictions: Sequence[Observation], joint: int
) -> Iterator[Cause]:
    """Candidate causes that affect one joint, from 1."""
    rotation_factors = [
        *_link_scales(contradictions, joint),
        *estimate_rotation_factors(evidence, joint),
    ]
    yield from _propose_channel_scales(evidence, contradictions, joint)
    yield from _propose_motor_angle_scales(evidence, contradictions, joint, rotation_factors)
    yield from _propose_gear_ratios(evidence, joint, rotation_factors)
    yield from _propose_geometry(evidence, contradictions, joint)
    yield from _propose_reversed_gear(evidence, joint)


def _build_cause(
    evidence: Evidence,
    code: str,
    places: Sequence[Place],
    message: str,
    corrections: Sequence[Correction],
    *,
    factor: float | None = None,
    delay_s: float | None = None,
    remedy_suffix: str = "",
    has_estimated_factor: bool = False,
) -> Cause:
    """Cause whose remedy is the text of its corrections, followed by `remedy_suffix`."""
    text = correction_text(evidence.study, corrections)
    remedy = text[:1].upper() + text[1:] + remedy_suffix
    suspicion = Suspicion(
        code=code,
        places=tuple(places),
        message=message,
        remedy=remedy,
        factor=factor,
        delay_s=delay_s,
        corrections=tuple(corrections),
    )
    return Cause(suspicion, has_estimated_factor)


def _channels_at(names: Iterable[str]) -> list[Place]:
    return [Place(channel=name) for name in names]


def _contradicting_values(
    contradictions: Sequence[Observation], kind: Kind, where: str | None = None
) -> list[float]:
    """Nonzero values of the contradictions of one kind, optionally at one place."""
    return [
        o.value
        for o in contradictions
        if o.kind == kind and (where is None or o.where == where) and o.value
    ]


def _match_known_factor(factor: float, names: Mapping[str, float]) -> tuple[str, float] | None:
    """Name and signed value of the known factor that matches an estimate of either sign."""
    for name, known in names.items():
        if abs(np.log(abs(factor) / known)) < _UNIT_TOLERANCE:
            return name, float(np.copysign(known, factor))
    return None


def _scale_corrections(evidence: Evidence, name: str, factor: float) -> list[Correction]:
    """Corrections that multiply a channel by a factor."""
    before = evidence.channel(name)
    corrections = [Correction("channels", name, "scale", float(f"{before.scale * factor:.7g}"))]
    if before.offset:
        offset = float(f"{before.offset * factor:.7g}")
        corrections.append(Correction("channels", name, "offset", offset))
    return corrections


def _propose_time_bases(
    evidence: Evidence, contradictions: Sequence[Observation]
) -> Iterator[Cause]:
    """A time base in another unit, or a wrong clock rate of the logger."""
    clocks = _contradicting_values(contradictions, "prbs-clock") + _contradicting_values(
        contradictions, "servo-clock"
    )
    if not clocks and not any(o.kind in ("explained-share", "scale") for o in contradictions):
        return
    estimates = [1.0 / float(np.median(clocks))] if clocks else []
    for ratio in (*estimates, *_TIMES.values()):
        unit, factor = _match_known_factor(ratio, _TIMES) or ("", ratio)
        corrections = _scale_corrections(evidence, "t", factor)
        if unit:
            message = (
                f"the time base is {format_number(1.0 / factor)} times the value that the other "
                f"signals and the clocks of the study imply: t is logged in {unit}, not in seconds"
            )
            code, remedy_suffix = "wrong-unit", ""
        else:
            message = (
                f"the voltages change with a period of {format_number(1.0 / factor, 6)} times the "
                "PRBS or servo period of the study: the clock of the logger is wrong by that factor"
            )
            code, remedy_suffix = (
                "clock-drift",
                ", or correct prbs.clock and the period of the servo",
            )
        yield _build_cause(
            evidence,
            code,
            [Place(channel="t")],
            message,
            corrections,
            factor=1.0 / factor,
            remedy_suffix=remedy_suffix,
        )


def _propose_input_delays(
    evidence: Evidence, contradictions: Sequence[Observation]
) -> Iterator[Cause]:
    """Commands with a delay relative to the encoders: all commands with one delay, or one."""
    values = {o.where: o.value for o in contradictions if o.kind == "input-delay"}
    groups = [[name] for name in values]
    if len(values) > 1 and np.ptp(list(values.values())) < _MAX_DELAY_DIFFERENCE:
        groups.insert(0, list(values))
    for group in groups:
        delay = float(np.mean([values[name] for name in group]))
        angles = [f"theta_m{name[-1]}" for name in group]
        side = "later" if delay > 0.0 else "earlier"
        message = (
            f"{join_names(group)}: the command in the log is {1e3 * abs(delay):.3g} ms {side} than "
            f"the torque that moves {join_names(angles)}, according to the phase of the motor's "
            "response to the test signals; the delay would bias damping, stiffness and inertias"
        )
        corrections = [Correction("log", name, "delay_s", round(delay, 6)) for name in group]
        remedy_suffix = ", or record commands and encoders with one clock"
        yield _build_cause(
            evidence,
            "misaligned",
            _channels_at(group),
            message,
            corrections,
            delay_s=delay,
            remedy_suffix=remedy_suffix,
        )


def _propose_test_signals(
    evidence: Evidence, contradictions: Sequence[Observation]
) -> Iterator[Cause]:
    """Records whose excited joint or PRBS amplitude differs from the study."""
    for each in contradictions:
        if each.kind == "excited-joint" and each.joint is not None:
            record = next(r.experiment for r in evidence.records if r.experiment.name == each.where)
            for excited in range(1, evidence.arm.n_joints + 1):
                if excited == each.joint:
                    continue
                message = (
                    f"{each.where}: the study states joint = {each.joint} as the excited joint, "
                    f"but the test signal is in the command of joint {excited}"
                )
                corrections = [Correction("experiment", record.name, "joint", excited)]
                place = Place(experiments=(record.name,), key="joint")
                yield _build_cause(evidence, "swapped-channels", [place], message, corrections)
    for name in dict.fromkeys(o.where for o in contradictions if o.kind == "level"):
        yield from _propose_amplitudes(evidence, name)


def _propose_amplitudes(evidence: Evidence, name: str) -> Iterator[Cause]:
    """A wrong PRBS amplitude in the study, or a wrong scale of the voltage.

    The amplitude comes first, unless the measured amplitude exceeds the supply of any drive.
    """
    joint = int(name[-1])
    ratios = {
        r.experiment.name: r.clocks.level[name] / r.experiment.prbs.amplitude
        for r in evidence.records
        if name in r.clocks.level and r.experiment.joint == joint and r.experiment.prbs is not None
    }
    stated = {e.name: e.prbs.amplitude for e in evidence.study.experiments if e.prbs is not None}
    wrong = [record for record, ratio in ratios.items() if not 0.5 < ratio < 2.0]
    if not wrong or min(ratios[record] for record in wrong) < _MIN_RATIO:
        return  # The command belongs to another joint.
    ratio = float(np.median([ratios[record] for record in wrong]))
    amplitudes = [
        Correction("experiment", each, "prbs.amplitude", float(f"{stated[each] * ratio:.4g}"))
        for each in wrong
    ]
    amplitude = max(stated[record] for record in wrong)
    unit = _match_known_factor(1.0 / ratio, _UNITS["u"])
    scales = _scale_corrections(evidence, name, unit[1] if unit else 1.0 / ratio)
    prbs = Place(experiments=tuple(wrong), key="prbs")
    alternatives = [(prbs, amplitudes, scales), (Place(channel=name), scales, amplitudes)]
    if amplitude * ratio > max(amplitude, _MAX_VOLTAGE):
        alternatives.reverse()
    for place, corrections, other in alternatives:
        message = (
            f"{join_names(wrong)}: the PRBS in {name} has an amplitude of "
            f"{format_number(amplitude * ratio)} V, but the study states "
            f"{format_number(amplitude)} V, a factor of {format_number(ratio)}: either the scale "
            f"of {name} or the stated amplitude is wrong"
        )
        remedy_suffix = f"; or, if that value is correct, {correction_text(evidence.study, other)}"
        yield _build_cause(
            evidence,
            "wrong-unit",
            [place],
            message,
            corrections,
            factor=ratio,
            remedy_suffix=remedy_suffix,
        )


def _propose_gravity(evidence: Evidence) -> Iterator[Cause]:
    """Gravity stated for a horizontal planar arm, or missing for a vertical one."""
    if not evidence.arm.has_planar_program:
        return  # the size alone does not state the gravity of a chain
    gravity = evidence.study.arm.gravity_size
    if not gravity:
        message = "the link sensors measure gravity, but the study states none: the arm is vertical"
        corrections = [Correction("arm", "", "gravity", 9.81)]
    else:
        message = (
            f"the link sensors and the torques show no gravity, but the study states gravity = "
            f"{format_number(gravity)}: the arm is horizontal"
        )
        corrections = [Correction("arm", "", "gravity", None)]
    yield _build_cause(evidence, "wrong-geometry", [Place(key="gravity")], message, corrections)


def _propose_exchanges(
    evidence: Evidence, contradictions: Sequence[Observation]
) -> Iterator[Cause]:
    """Exchanged columns of two joints, of which one has contradictions if any joint has."""
    suspected = {o.joint for o in contradictions if o.joint is not None}
    for pair in combinations(range(1, evidence.arm.n_joints + 1), 2):
        if not suspected or suspected.intersection(pair):
            yield from _propose_exchange(evidence, *pair)


def _propose_exchange(evidence: Evidence, first: int, second: int) -> Iterator[Cause]:
    """Exchanged columns of a pair: all kinds, one side, one kind, or all kinds but one."""
    kinds = [k for k in _PAIRED if {f"{k}{first}", f"{k}{second}"} <= evidence.channels]
    motors = [k for k in kinds if k in _MOTOR_SIDE]
    groups = [kinds, motors, [k for k in kinds if k not in motors], *([k] for k in kinds)]
    groups += [[k for k in kinds if k != left] for left in kinds]
    for group in dict.fromkeys(tuple(group) for group in groups if group):
        corrections = []
        for kind in group:
            for name, other in permutations((f"{kind}{first}", f"{kind}{second}")):
                source = evidence.channel(other)
                corrections.append(Correction("channels", name, "column", source.column))
                corrections.append(Correction("channels", name, "scale", source.scale))
                corrections.append(Correction("channels", name, "offset", source.offset))
        pairs = [f"{kind}{first}, {kind}{second}" for kind in group]
        paired = [f"{kind}{joint}" for kind in group for joint in (first, second)]
        message = f"{join_names(pairs)}: the channels of joints {first} and {second} are exchanged"
        if len(group) == 1:
            kind = group[0]
            message = (
                f"{kind}{first} follows joint {second}, and {kind}{second} follows joint {first}: "
                "the two channels are exchanged"
            )
        yield _build_cause(evidence, "swapped-channels", _channels_at(paired), message, corrections)


def _propose_angle_units(
    evidence: Evidence, contradictions: Sequence[Observation]
) -> Iterator[Cause]:
    """Motor angles of all joints in another unit, alone or with their velocities."""
    names = [f"theta_m{i}" for i in range(1, evidence.arm.n_joints + 1)]
    if len(names) < 2 or not any(o.joint is not None for o in contradictions):
        return
    rates = [f"{k}{i}" for k in ("omega_m", "ref") for i in range(1, len(names) + 1)]
    rates = [name for name in rates if name in evidence.channels]
    for unit in _angle_scales(evidence, names[0]):
        scales = [_angle_scales(evidence, name).get(unit, 0.0) for name in names]
        if not all(scales):
            continue
        corrections = [
            each
            for name, scale in zip(names, scales, strict=True)
            for each in _scale_corrections(evidence, name, scale / evidence.channel(name).scale)
        ]
        message = f"{join_names(names)} are logged in {unit}, not in radians"
        factor = evidence.channel(names[0]).scale / scales[0]
        places = _channels_at(names)
        yield _build_cause(evidence, "wrong-unit", places, message, corrections, factor=factor)
        if rates and unit == "degrees":
            rate_corrections = [
                each for name in rates for each in _scale_corrections(evidence, name, _DEGREE)
            ]
            message = f"{join_names([*names, *rates])} are logged in degrees, not in radians"
            places = _channels_at([*names, *rates])
            yield _build_cause(
                evidence,
                "wrong-unit",
                places,
                message,
                corrections + rate_corrections,
                factor=factor,
            )


def _angle_scales(evidence: Evidence, name: str) -> dict[str, float]:
    """Scales to radians of the units in which a motor angle can be logged."""
    names = dict(_ANGLES)
    per_turn = evidence.arm.joints[int(name[-1]) - 1].encoder_counts
    if per_turn:
        names["encoder counts"] = 2.0 * np.pi / per_turn
        names["quadrature counts"] = np.pi / 2.0 / per_turn
        names["encoder lines"] = 8.0 * np.pi / per_turn
    scale = evidence.channel(name).scale
    for factor in _QUADRATURE_FACTORS:
        names[f"counts of {factor:g} times the scale (lines and quadrature)"] = factor * scale
    return names


def _propose_ac_coupling(
    evidence: Evidence, contradictions: Sequence[Observation]
) -> Iterator[Cause]:
    """AC-coupled accelerometers, for example piezoelectric ones."""
    contradicting = {
        o.where
        for o in contradictions
        if o.where in evidence.channels
        and channel_parts(o.where)[0] in _ACCELERATIONS
        and o.kind != "count"
    }
    cutoffs = {
        name: hz
        for name in sorted(contradicting)
        if (hz := estimate_high_pass_cutoff(evidence, name))
    }
    groups = [list(cutoffs)] if len(cutoffs) > 1 else []
    for group in [*groups, *([name] for name in cutoffs)]:
        cutoff_text = ", ".join(f"{format_number(cutoffs[name], 2)} Hz" for name in group)
        message = (
            f"{join_names(group)}: the readings agree with the motion only after a high-pass of "
            f"{cutoff_text}: the sensor or its amplifier is AC-coupled, for example a "
            "piezoelectric accelerometer. It does not measure gravity or slow motion, and the "
            "model of a DC-coupled accelerometer would bias the damping"
        )
        corrections = [Correction("log", name, "high_pass_hz", cutoffs[name]) for name in group]
        yield _build_cause(evidence, "ac-coupled", _channels_at(group), message, corrections)


def _propose_sensor_delays(
    evidence: Evidence, contradictions: Sequence[Observation]
) -> Iterator[Cause]:
    """Link sensors with a delay or a drift of the delay: all, one kind, or one channel."""
    link = sorted(n for n in evidence.channels if n[:-1] in (*LINK_CHANNELS, "deflection"))
    kinds: tuple[Kind, ...] = ("drift", "delay")
    for kind in kinds:
        values = {o.where: o.value for o in contradictions if o.kind == kind}
        groups = [link, *([n for n in link if n[:-1] == k] for k in LINK_CHANNELS)]
        groups += [[name] for name in values]
        for group in groups:
            estimates = [values[name] for name in group if name in values]
            if estimates:
                yield _sensor_delay_cause(evidence, group, kind, float(np.median(estimates)))


def _sensor_delay_cause(
    evidence: Evidence, group: Sequence[str], kind: Kind, value: float
) -> Cause:
    """A common delay [s] or drift [s/s] of a group of channels."""
    names, places = ", ".join(group), _channels_at(group)
    if kind == "delay":
        message = (
            f"{names}: {format_number(1e3 * abs(value), 3)} ms "
            f"{'late' if value > 0.0 else 'early'} relative to the motor angle, more than the "
            "whole-arm fit corrects"
        )
        corrections = [Correction("log", name, "delay_s", value) for name in group]
        remedy_suffix = (
            "; or state the sensor's bandwidth (accelerometer_hz, gyro_hz) if it has a filter"
        )
        return _build_cause(
            evidence,
            "misaligned",
            places,
            message,
            corrections,
            delay_s=value,
            remedy_suffix=remedy_suffix,
        )
    message = (
        f"{names}: the delay relative to the motor angle changes by "
        f"{format_number(1e3 * value, 3)} ms per second: the clock of these channels is "
        f"{format_number(100.0 * abs(value), 3)} % {'slow' if value > 0.0 else 'fast'}"
    )
    corrections = [Correction("log", name, "clock", value) for name in group]
    remedy_suffix = ", or record all channels with one clock"
    return _build_cause(
        evidence,
        "clock-drift",
        places,
        message,
        corrections,
        factor=1.0 - value,
        remedy_suffix=remedy_suffix,
    )


def _channel_scale_cause(
    evidence: Evidence, name: str, factor: float, unit: str | None, basis: str
) -> Cause:
    """One channel in another unit or with another sign."""
    ratio = 1.0 / factor
    code = "wrong-unit"
    if factor == -1.0:
        code, explanation = "wrong-sign", "its sign is wrong"
    elif unit is not None:
        sign = ", with the wrong sign" if factor < 0.0 else ""
        explanation = f"logged in {unit}{sign}?"
    else:
        explanation = "its scale is wrong"
    message = (
        f"{name} is {format_number(ratio)} times the value that {basis} implies: {explanation}"
    )
    return _build_cause(
        evidence,
        code,
        [Place(channel=name)],
        message,
        _scale_corrections(evidence, name, factor),
        factor=ratio,
        has_estimated_factor=unit is None and factor != -1.0,
    )


def _candidate_factors(
    ratios: Iterable[float], names: Mapping[str, float]
) -> Iterator[tuple[float, str | None]]:
    """Candidate factors of a channel with their units: -1 first, then one per estimated ratio.

    An estimate near the factor of a known unit is replaced by that factor.
    """
    yield -1.0, None
    tried: list[float] = []
    for ratio in ratios:
        known = _match_known_factor(1.0 / ratio, names)
        factor, unit = (known[1], known[0]) if known else (1.0 / ratio, None)
        is_repeated = any(abs(factor / other - 1.0) < _MAX_FACTOR_DIFFERENCE for other in tried)
        if abs(abs(factor) - 1.0) > 1e-9 and not is_repeated:
            tried.append(factor)
            yield factor, unit


def _propose_channel_scales(
    evidence: Evidence, contradictions: Sequence[Observation], joint: int
) -> Iterator[Cause]:
    """Wrong units, signs or scales of all channels of one joint except the motor angle."""
    for kind, basis in _BASIS.items():
        name = f"{kind}{joint}"
        if name not in evidence.channels:
            continue
        if kind in LINK_CHANNELS:
            ratios = _contradicting_values(contradictions, "scale", name)
            ratios += _contradicting_values(contradictions, "gravity", name)
        elif kind == "ref":
            ratios = [
                1.0 / r
                for r in _contradicting_values(contradictions, "reference", f"theta_m{joint}")
            ]
        elif kind == "omega_m":
            ratios = _contradicting_values(contradictions, "velocity", name)
        else:
            kinds: tuple[Kind, ...] = ("level", "servo", "limit")
            ratios = [r for k in kinds for r in _contradicting_values(contradictions, k, name)]
            ratios = [r for r in ratios if abs(r) > _MIN_RATIO]
        if ratios or _is_contradicted(contradictions, name, joint):
            relative = {u: s / evidence.channel(name).scale for u, s in _UNITS[kind].items()}
            relative["SI units"] = 1.0 / abs(evidence.channel(name).scale)
            if kind == "a":  # Other factors can be a wrong distance: see _geometry.
                ratios = [r for r in ratios if _match_known_factor(1.0 / r, relative)]
            if kind in ("u", "torque"):
                ratios += [1.0 / factor for factor in relative.values()]
            for factor, unit in _candidate_factors(ratios, relative):
                yield _channel_scale_cause(evidence, name, factor, unit, basis.format(joint))


def _is_contradicted(contradictions: Sequence[Observation], name: str, joint: int) -> bool:
    """Whether a contradiction depends on a channel."""
    kinds = {"u": ("inertia", "servo"), "torque": ("inertia",)}.get(channel_parts(name)[0], ())
    return any(o.where == name or (o.joint == joint and o.kind in kinds) for o in contradictions)


def _propose_motor_angle_scales(
    evidence: Evidence,
    contradictions: Sequence[Observation],
    joint: int,
    rotation_factors: Sequence[float],
) -> Iterator[Cause]:
    """One motor angle with a wrong unit, count or sign, or a wrong number of encoder counts."""
    name = f"theta_m{joint}"
    per_turn = evidence.arm.joints[joint - 1].encoder_counts
    if not any(o.joint == joint for o in contradictions):
        return
    steps = _contradicting_values(contradictions, "count", name)
    ratios = (
        steps
        + _contradicting_values(contradictions, "reference", name)
        + [1.0 / r for r in rotation_factors]
    )
    # Unit factors differ from 1 by more than the tolerance.
    ratios = [r for r in ratios if abs(np.log(abs(r))) > _UNIT_TOLERANCE]
    basis = "the motion of the other signals"
    if per_turn:
        basis = "its encoder resolution, together with the other signals,"
    scale = evidence.channel(name).scale
    names = {unit: known / scale for unit, known in _angle_scales(evidence, name).items()}
    names |= _round_scales(scale, ratios)
    for factor, unit in _candidate_factors(ratios, names):
        yield _channel_scale_cause(evidence, name, factor, unit, basis)
    for ratio in steps if per_turn else ():
        counts = round((per_turn or 0.0) / ratio)
        minimum, maximum = accepted_range("encoder_counts")
        if not minimum <= counts <= maximum:
            continue
        message = (
            f"the steps of theta_m{joint} are {format_number(ratio)} times the size that "
            f"encoder_counts = {format_number(per_turn or 0.0, 7)} implies, but the motion of "
            f"theta_m{joint} agrees with the other signals"
        )
        corrections = [Correction("joint", str(joint), "encoder_counts", counts)]
        place = Place(joint=joint, key="encoder_counts")
        yield _build_cause(evidence, "wrong-unit", [place], message, corrections, factor=ratio)


def _round_scales(scale: float, ratios: Sequence[float]) -> dict[str, float]:
    """Factors that change a scale to 2 pi / 2^k, the scale of an encoder with 2^k counts."""
    names = {}
    for ratio in ratios:
        counts = 2.0 * np.pi / abs(scale / ratio)
        power = 2 ** round(np.log2(counts)) if counts >= 8.0 else 0
        if power:
            names[f"counts of 2 pi / {power}"] = 2.0 * np.pi / power / abs(scale)
    return names


def _link_scales(contradictions: Sequence[Observation], joint: int) -> list[float]:
    """Measured over predicted readings of the link sensors of a joint, angular rates first."""
    kinds = ("gyro", "theta_l", "a")
    scales = [
        s
        for kind in kinds
        for s in _contradicting_values(contradictions, "scale", f"{kind}{joint}")
    ]
    return scales + _contradicting_values(contradictions, "own-joint", f"a{joint}")


def _propose_gear_ratios(
    evidence: Evidence, joint: int, rotation_factors: Sequence[float]
) -> Iterator[Cause]:
    """A wrong gear ratio in the study."""
    n = evidence.arm.joints[joint - 1].gear_ratio
    minimum, maximum = accepted_range("gear_ratio")
    known = [0.5 * n, 2.0 * n, 1.0 / n]
    for candidate in [scale * n for scale in rotation_factors if scale > 0.0] + known:
        reduction = round(1.0 / candidate)
        is_whole = reduction >= 1 and abs(reduction * candidate - 1.0) < _REDUCTION_TOLERANCE
        ratio = float(f"{1.0 / reduction if is_whole else candidate:.5g}")
        if abs(ratio / n - 1.0) < _MAX_FACTOR_DIFFERENCE or not minimum <= ratio <= maximum:
            continue
        message = (
            f"the link sensors of joint {joint} measure {format_number(ratio / n)} times the "
            f"motion that gear_ratio = {format_number(n)} implies: the link turns "
            f"{format_number(ratio)} times per motor turn"
        )
        corrections = [Correction("joint", str(joint), "gear_ratio", ratio)]
        yield _build_cause(
            evidence,
            "wrong-gear-ratio",
            [Place(joint=joint, key="gear_ratio")],
            message,
            corrections,
            factor=n / ratio,
            has_estimated_factor=candidate not in known
            and (not is_whole or reduction > _MAX_DISTINCT_REDUCTION),
        )


def _propose_geometry(
    evidence: Evidence, contradictions: Sequence[Observation], joint: int
) -> Iterator[Cause]:
    """A wrong accelerometer distance or link length, or an arbitrary accelerometer scale."""
    name = f"a{joint}"
    distance = evidence.arm.joints[joint - 1].accelerometer_distance
    origins = [math.hypot(*each.origin.xyz) for each in evidence.arm.joints]
    length = max(origins[joint - 1 : joint + 1]) or None  # to a neighbouring axis
    ratios = _contradicting_values(contradictions, "own-joint", name) + _contradicting_values(
        contradictions, "scale", name
    )
    minimum, maximum = accepted_range("accelerometer_distance")
    for ratio in ratios if distance else ():
        corrected = float(format_number(ratio * (distance or 0.0)))
        if not minimum <= corrected <= maximum:
            continue
        hint = _distance_hint(corrected, distance or 0.0, length)
        message = (
            f"{name} reads {format_number(ratio)} times the acceleration that the motion of "
            f"joint {joint} implies at {format_number(distance or 0.0)} m from its axis: the "
            f"accelerometer is mounted at {format_number(corrected)} m{hint}"
        )
        scale = correction_text(evidence.study, _scale_corrections(evidence, name, 1.0 / ratio))
        yield _build_cause(
            evidence,
            "wrong-geometry",
            [Place(joint=joint, key="accelerometer_distance")],
            message,
            [Correction("joint", str(joint), "accelerometer_distance", corrected)],
            factor=1.0 / ratio,
            remedy_suffix=(
                f" (from the axis of joint {joint}), or, if the scale of the sensor is wrong, "
                f"{scale}"
            ),
            has_estimated_factor=True,
        )
    minimum, maximum = accepted_range("link_length")
    has_length = joint > 1 and "link_length" in arm_keys(evidence.study.arm)
    for ratio in _contradicting_values(contradictions, "origin-motion", name) if has_length else ():
        corrected = float(format_number(ratio * (length or 0.0)))
        if minimum <= corrected <= maximum:
            message = (
                f"{name} reads {format_number(ratio)} times the motion of axis {joint} that "
                f"link_length = {format_number(length or 0.0)} m implies"
            )
            corrections = [Correction("arm", "", "link_length", corrected)]
            yield _build_cause(
                evidence,
                "wrong-geometry",
                [Place(key="link_length")],
                message,
                corrections,
                factor=1.0 / ratio,
                has_estimated_factor=True,
            )
    for ratio in _contradicting_values(contradictions, "scale", name):
        yield _channel_scale_cause(evidence, name, 1.0 / ratio, None, f"theta_m{joint}")


def _distance_hint(corrected: float, stated: float, length: float | None) -> str:
    """Message text on the point from which the stated distance was probably measured."""
    if length is None:
        return ""
    if abs(stated - corrected - length) < 0.1 * length:
        return "; was the stated distance measured from axis 1?"
    if abs(stated + corrected - length) < 0.1 * length:
        return "; was the stated distance measured from the end of the link?"
    return ""


def _propose_reversed_gear(evidence: Evidence, joint: int) -> Iterator[Cause]:
    """A reversing gear: motor angle and torque are consistent, the link has the opposite sign."""
    names = [f"{k}{joint}" for k in _MOTOR_SIDE if f"{k}{joint}" in evidence.channels]
    corrections = [each for name in names for each in _scale_corrections(evidence, name, -1.0)]
    message = (
        f"link {joint} turns opposite to its motor: every link sensor of joint {joint} has the "
        "opposite sign of the motor signals"
    )
    remedy_suffix = "; motor and link then turn in the same direction"
    places = _channels_at(names)
    yield _build_cause(
        evidence,
        "wrong-sign",
        places,
        message,
        corrections,
        factor=-1.0,
        remedy_suffix=remedy_suffix,
    )
