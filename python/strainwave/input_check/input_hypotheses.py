"""Hypotheses about channels, commands and constants that relations between signals suggest.

Structured hypotheses come first: exchanged joints, gravity, a unit, a sign, a delay. Those with an
estimated factor come last. Their values stay within the ranges that a study file accepts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import chain, combinations

import numpy as np

from strainwave.domain import Clause, Correction, Place, channel_parts
from strainwave.domain.arm.kinds import arm_keys
from strainwave.domain.messages import Value
from strainwave.domain.study import study_keys
from strainwave.input_check.evidence import Evidence, exchanged_tests
from strainwave.input_check.hypothesis import (
    STEPS,
    Hypothesis,
    UnexplainedEvidence,
    Unit,
    angle_unit,
    exchanges,
    of_logs,
    other_meaning,
    other_scale,
    scaled,
    whole_reduction,
)
from strainwave.input_check.observations import EXPECTED
from strainwave.input_check.sensors import (
    IMU_ACCELEROMETERS,
    LINK_CHANNELS,
    STANDARD_GRAVITY,
    estimate_high_pass_cutoff,
)
from strainwave.input_check.torque_hypotheses import other_gravity, propose_explanations
from strainwave.input_check.torque_rows import effort_channel

# Maximum relative difference between two factors that count as equal.
_MAX_FACTOR_DIFFERENCE = 0.02
# Maximum log ratio of an estimated factor to that of a unit; units differ by at least 5 %.
_UNIT_TOLERANCE = 0.04
# Smallest factor that a unit can explain; a smaller ratio indicates a missing signal.
_MIN_RATIO = 1e-6
# Maximum difference between the delays of channels with a common cause [s].
_MAX_DELAY_DIFFERENCE = 5e-4
# Voltage above the supply of any servo drive [V]; a larger value is in millivolts.
_MAX_VOLTAGE = 1e3
# Ratios of encoder counts to encoder lines, and their inverses.
_QUADRATURE_FACTORS = (4.0, 2.0, 0.5, 0.25)
# Largest reduction for which the estimate distinguishes neighbouring whole numbers.
_MAX_DISTINCT_REDUCTION = 30
# Reductions of strain-wave gears, and the log ratio within which an estimate is one of them.
_REDUCTIONS, _USUAL_TOLERANCE = (30, 50, 51, 80, 81, 100, 101, 120, 121, 160, 161), 0.03
# Maximum difference of distances that count as equal, over the distance between the axes.
_DISTANCE_TOLERANCE = 0.1

_MOTOR_SIDE = ("u", "torque", "theta_m", "omega_m", "ref")
_LINK_SIDE = (*LINK_CHANNELS, "deflection")
_DEGREE = float(np.pi / 180.0)  # [rad]
_TIMES: Mapping[Unit, float] = {
    "milliseconds": 1e-3,
    "microseconds": 1e-6,
    "nanoseconds": 1e-9,
    "minutes": 60.0,
}
_VOLTAGES: Mapping[Unit, float] = {"mV": 1e-3}
_ANGLES: Mapping[Unit, float] = {"degrees": _DEGREE, "turns": 2.0 * np.pi, "mrad": 1e-3}
_RATES: Mapping[Unit, float] = {
    "deg/s": _DEGREE,
    "rpm": np.pi / 30.0,
    "turns/s": 2.0 * np.pi,
    "mrad/s": 1e-3,
}
_ACCELERATIONS: Mapping[Unit, float] = {
    "g": STANDARD_GRAVITY,
    "mm/s^2": 1e-3,
    "cm/s^2": 1e-2,
    "mg": 1e-3 * STANDARD_GRAVITY,
}
_CHANNELS: Mapping[str, tuple[str, Mapping[Unit, float]]] = {
    **dict.fromkeys(("a", *IMU_ACCELEROMETERS), ("motor-angle", _ACCELERATIONS)),
    **dict.fromkeys(("gyro", "gx", "gy", "gz", "omega_m", "ref"), ("motor-angle", _RATES)),
    "theta_l": ("motor-angle", _ANGLES),
    "u": ("servo", _VOLTAGES),
    "torque": ("motion", {"mN m": 1e-3}),
}
"""Signals that determine the scale of each kind of channel, and its other units in SI units."""


def propose_hypotheses(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """Yield all hypotheses, structured ones first."""
    of_torques = propose_explanations(case) if case.contradicts("torque-fit") else ()
    if {each.kind for each in case.contradictions} == {"torque-fit"}:
        yield from of_torques  # they competed on held-out stretches
        return
    # the factors of link sensors are more accurate than those of torques, but those of chains take
    # time
    first, last = ((), of_torques) if case.evidence.arm.has_planar_program else (of_torques, ())
    yield from first
    # readings depend on the joints before a link
    joints = range(1, max(case.joints, default=0) + 1)
    estimated: list[Hypothesis] = []
    of_joints = (propose(case, joint) for joint in joints for propose in _OF_JOINT)
    for each in chain(*(propose(case) for propose in _OF_ARM), *of_joints):
        if each.has_estimated_factor:
            estimated.append(each)
        else:
            yield each
    yield from last
    yield from estimated


# exchanges, units, signs and meanings


def _exchanged_files(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """Exchanged files of records with a test signal and records of motion."""
    silent, signalling = map(tuple, exchanged_tests(case.evidence))
    if silent and signalling:
        names = (*silent, *signalling)
        clause = Clause("swapped-channels/files", records=silent, others=signalling)
        remedy, at = Clause("remedy/files", records=names), (Place(experiments=names, key="file"),)
        yield Hypothesis("swapped-channels", clause, (), remedy, at=at, excluded=names)


def _effort_scales(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """The efforts of all joints in other units, or with another sign; or without friction."""
    joints = range(1, case.evidence.arm.n_joints + 1)
    names = tuple(name for i in joints if (name := effort_channel(case.evidence.channels, i)))
    negative = {o.joint for o in case.contradictions if o.kind == "inertia"}
    factors: list[tuple[float, Unit | None]] = [(-1.0, None)] if len(negative) > 1 else []
    factors += [(1e-3, "mN m"), (1e-2, "N cm")] if case.contradicts("mass") else []
    for factor, unit in factors:
        code = "wrong-sign" if unit is None else "wrong-unit"
        clause = Clause(f"{code}/efforts", channels=names, unit=unit)
        yield Hypothesis(code, clause, scaled(case.evidence, names, factor), factor=1.0 / factor)
    sensors = case.by_channel("torque-sensor")
    if len(sensors) > 1:
        wrong = {f"torque{channel_parts(name)[1]}": x for name, x in sensors.items()}
        clause = Clause("wrong-torque-constant/sensors", channels=tuple(wrong))
        changes = [c for name, x in wrong.items() for c in scaled(case.evidence, [name], x)]
        yield Hypothesis("wrong-torque-constant", clause, tuple(changes)).as_estimate()
    efforts = tuple(name for name in names if channel_parts(name)[0] == "torque")
    for share in (o.measured for o in case.contradictions if o.kind == "friction"):
        clause = Clause("effort-without-friction", channels=efforts, share=share)
        yield other_meaning(efforts, "without-friction", clause)


def _dead_channels(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """Sensors that show noise alone."""
    for name, size in case.by_channel("presence").items():
        clause = Clause("dead-channel", channel=name, share=size)
        yield Hypothesis("dead-channel", clause, of_logs([name], "unusable", 0.0))


def _exchanges(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """Exchanged columns of two joints, of which one has contradictions if any joint has.

    All kinds, one side, one kind, or all kinds but one are exchanged.
    """
    for joints in combinations(range(1, case.evidence.arm.n_joints + 1), 2):
        if case.joints and case.joints.isdisjoint(joints):
            continue
        motors, links = (
            [kind for kind in side if {f"{kind}{i}" for i in joints} <= case.evidence.channels]
            for side in (_MOTOR_SIDE, _LINK_SIDE)
        )
        kinds = motors + links
        groups = [kinds, motors, links, *([kind] for kind in kinds)]
        groups += [[kind for kind in kinds if kind != left] for left in kinds]
        yield from exchanges(case.evidence, groups, joints)


def _angle_units(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """Motor angles of all joints in another unit, alone or with their velocities."""
    evidence, joints = case.evidence, range(1, case.evidence.arm.n_joints + 1)
    if len(joints) < 2 or not case.joints:
        return
    angles = [f"theta_m{joint}" for joint in joints]
    rates = [n for joint in joints for n in (f"omega_m{joint}", f"ref{joint}")]
    rates = [name for name in rates if name in evidence.channels]
    units = [_angle_scales(evidence, name) for name in angles]
    for unit in (unit for unit in units[0] if all(unit in each for each in units)):
        factors = [s[unit] / evidence.channel(n).scale for s, n in zip(units, angles, strict=True)]
        pairs = zip(angles, factors, strict=True)
        changes = tuple(c for name, factor in pairs for c in scaled(evidence, [name], factor))
        yield angle_unit(angles, unit, changes, factors[0])
        if rates and unit == "degrees":
            changes += scaled(evidence, rates, _DEGREE)
            yield angle_unit([*angles, *rates], unit, changes, factors[0])


def _angle_scales(evidence: Evidence, name: str) -> dict[Unit, float]:
    """Scales to radians of the units in which a motor angle can be logged."""
    units, scale = dict(_ANGLES), evidence.channel(name).scale
    if per_turn := evidence.arm.joints[channel_parts(name)[1] - 1].encoder_counts:
        units["encoder counts"] = 2.0 * np.pi / per_turn
        units["quadrature counts"] = np.pi / 2.0 / per_turn
        units["encoder lines"] = 8.0 * np.pi / per_turn
    return units | {Clause("counts/scaled", factor=f): f * scale for f in _QUADRATURE_FACTORS}


def _channel_scales(case: UnexplainedEvidence, joint: int) -> Iterator[Hypothesis]:
    """Wrong units, signs or scales of the channels of one joint; the sign first."""
    evidence = case.evidence
    for kind, (basis, si_units) in _CHANNELS.items():
        name = f"{kind}{joint}"
        if name not in evidence.channels:
            continue
        ratios = _scale_ratios(case, kind, joint)
        is_effort = kind in ("u", "torque")
        if not ratios and not any(
            o.place.channel == name or (o.joint == joint and is_effort and o.kind == "inertia")
            for o in case.contradictions
        ):
            continue
        scale = evidence.channel(name).scale
        units: dict[Unit, float] = {unit: si / scale for unit, si in si_units.items()}
        units["SI units"] = 1.0 / abs(scale)
        if kind == "a":  # other factors can be a wrong distance
            ratios = [ratio for ratio in ratios if _match_known_factor(1.0 / ratio, units)[0]]
        ratios += [1.0 / factor for factor in units.values()] if is_effort else []
        yield from _scales(evidence, name, ratios, units, basis)
    if joint in case.joints:
        name = f"theta_m{joint}"
        ratios = case.values(name, "count", "reference")
        ratios += [1.0 / factor for factor in case.rotation_factors(joint)]
        ratios += [1.0 / factor for factor in case.values(f"omega_m{joint}", "velocity")]
        # Unit factors differ from 1 by more than the tolerance.
        ratios = [ratio for ratio in ratios if abs(np.log(abs(ratio))) > _UNIT_TOLERANCE]
        scale = evidence.channel(name).scale
        units = {unit: si / scale for unit, si in _angle_scales(evidence, name).items()}
        has_counts = evidence.arm.joints[joint - 1].encoder_counts
        basis = "resolution" if has_counts else "signals"
        yield from _scales(evidence, name, ratios, units, basis)


def _scale_ratios(case: UnexplainedEvidence, kind: str, joint: int) -> list[float]:
    """Estimated ratios of a channel to its SI value."""
    name = f"{kind}{joint}"
    if kind in LINK_CHANNELS:
        return case.values(name, "scale", "gravity")
    if kind == "ref":
        return [1.0 / ratio for ratio in case.values(f"theta_m{joint}", "reference")]
    if kind == "omega_m":
        return case.values(name, "velocity")
    ratios = [r for r in case.values(name, "level", "limit") if abs(r) > _MIN_RATIO]
    sensor = case.values(f"tau_l{joint}", "torque-sensor") if kind == "torque" else []
    return ratios + [1.0 / ratio for ratio in sensor]


def _scales(
    evidence: Evidence, name: str, ratios: list[float], units: Mapping[Unit, float], basis: str
) -> Iterator[Hypothesis]:
    """Factors of a channel: -1 first, then one per estimated ratio or the unit near it."""
    yield other_scale(evidence, name, -1.0, None, basis)
    tried: list[float] = []
    for ratio in ratios:
        unit, factor = _match_known_factor(1.0 / ratio, units)
        is_repeated = any(abs(factor / other - 1.0) < _MAX_FACTOR_DIFFERENCE for other in tried)
        if abs(abs(factor) - 1.0) > 1e-9 and not is_repeated:
            tried.append(factor)
            yield other_scale(evidence, name, factor, unit, basis)


def _match_known_factor(factor: float, units: Mapping[Unit, float]) -> tuple[Unit | None, float]:
    """Name and signed value of the known factor that matches an estimate; signs are ignored."""
    for unit, known in units.items():
        if abs(np.log(abs(factor / known))) < _UNIT_TOLERANCE:
            return unit, float(np.copysign(known, factor))
    return None, factor


def _ac_coupling(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """AC-coupled accelerometers, for example piezoelectric ones."""
    names = {o.place.channel for o in case.contradictions if o.place.channel and o.kind != "count"}
    cutoffs = {
        name: hz
        for name in sorted(names & case.evidence.channels)
        if channel_parts(name)[0] in ("a", *IMU_ACCELEROMETERS)
        if (hz := estimate_high_pass_cutoff(case.evidence, name))
    }
    groups = [list(cutoffs)] if len(cutoffs) > 1 else []
    for group in [*groups, *([name] for name in cutoffs)]:
        hertz = tuple(Clause("frequency", value=cutoffs[name]) for name in group)
        clause = Clause("ac-coupled", channels=tuple(group), cutoffs=hertz)
        changes = tuple(Correction("log", name, "high_pass_hz", cutoffs[name]) for name in group)
        yield Hypothesis("ac-coupled", clause, changes)


# delays and clocks


def _sensor_delays(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """Link sensors with a delay or a drift of the delay: all, one kind, or one channel."""
    names = sorted(n for n in case.evidence.channels if channel_parts(n)[0] in _LINK_SIDE)
    by_kind = [[n for n in names if channel_parts(n)[0] == kind] for kind in LINK_CHANNELS]
    for kind in ("drift", "delay"):
        values = case.by_channel(kind)
        for group in (names, *by_kind, *([name] for name in values)):
            estimates = [values[name] for name in group if name in values]
            if not estimates:
                continue
            x, channels = float(np.median(estimates)), tuple(group)
            if kind == "delay":
                side, remedy = "late" if x > 0.0 else "early", Clause("remedy/sensor-delay")
                clause = Clause("misaligned/sensor", channels=channels, delay=abs(x), side=side)
                changes = of_logs(channels, "delay_s", x)
                yield Hypothesis("misaligned", clause, changes, remedy, delay_s=x)
                continue
            side, size = "slow" if x > 0.0 else "fast", abs(x)
            clause = Clause("clock-drift/sensor", channels=channels, drift=x, error=size, side=side)
            changes, remedy = of_logs(channels, "clock", x), Clause("remedy/sensor-clock")
            yield Hypothesis("clock-drift", clause, changes, remedy, factor=1.0 - x)


def _input_delays(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """Commands with a delay relative to the encoders, or encoders relative to the commands.

    All commands with one delay, then one command or one motor angle: link sensors and torques tell
    which of the two is late. Delays of an angle that are tolerated relative to link sensors are no
    rivals.
    """
    values = case.by_channel("input-delay")
    delays = list(values.values())
    if len(values) > 1 and np.ptp(delays) < _MAX_DELAY_DIFFERENCE:
        yield _late_motors("command", tuple(values), tuple(values), float(np.mean(delays)))
    angles = []
    for name, delay in values.items():
        of_motor = f"theta_m{channel_parts(name)[1]}"
        command = _late_motors("command", (name,), (name,), delay)
        angle = _late_motors("angle", (name,), (of_motor,), -delay)
        is_rival = abs(delay) > EXPECTED["delay"].tolerance
        yield replace(command, rivals=(angle.as_rival(),) * is_rival)
        angles.append(replace(angle, rivals=(command.as_rival(),)))
    yield from angles


def _late_motors(
    kind: str, commands: tuple[str, ...], names: tuple[str, ...], delay: float
) -> Hypothesis:
    """Late commands, or angles that respond to them."""
    clause = Clause(
        f"misaligned/{kind}",
        channels=names,
        delay=abs(delay),
        side="later" if delay > 0.0 else "earlier",
        commands=commands,
        angles=tuple(f"theta_m{channel_parts(name)[1]}" for name in commands),
    )
    shifts, remedy = of_logs(names, "delay_s", round(delay, 6)), Clause("remedy/command")
    return Hypothesis("misaligned", clause, shifts, remedy, delay_s=delay)


def _time_bases(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """A time base in another unit, or a wrong clock rate of the logger."""
    clocks = case.values(None, "servo-clock")  # a PRBS may have another clock
    if not clocks and not case.contradicts("prbs-clock", "explained-share", "scale"):
        return
    for estimate in (*([1.0 / float(np.median(clocks))] if clocks else ()), *_TIMES.values()):
        unit, factor = _match_known_factor(estimate, _TIMES)
        code, variant = ("clock-drift", "") if unit is None else ("wrong-unit", "/time")
        clause = Clause(code + variant, ratio=1.0 / factor, unit=unit)
        remedy = STEPS if unit is not None else Clause("remedy/log-clock")
        changes = scaled(case.evidence, "t", factor)
        yield Hypothesis(code, clause, changes, remedy, factor=1.0 / factor)


def _record_clocks(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """A wrong PRBS clock of the study, or another clock of the logger, in some of the records.

    Without a second clock in these records the two cannot be told apart, but no logger is wrong by
    a whole factor.
    """
    clocks = [o for o in case.contradictions if o.kind in ("prbs-clock", "servo-clock")]
    wrong = {o.place.experiments[0]: o for o in clocks}
    clocked = [r for r in case.evidence.records if r.prbs_clock or r.servo_clock]
    if not wrong:
        return
    names, ratio = tuple(wrong), float(np.median([o.measured for o in wrong.values()]))
    stated = {r.experiment.name: r.experiment.prbs for r in clocked}
    changes = tuple(
        Correction("experiment", name, "prbs.clock", float(f"{o.measured * prbs.clock:.5g}"))
        for name, o in wrong.items()
        if (prbs := stated[name]) is not None and o.kind == "prbs-clock"
    )
    at = (Place(experiments=names, key="prbs"),)
    clause = Clause("wrong-prbs-clock", records=names, ratio=ratio)
    of_prbs = Hypothesis("wrong-prbs-clock", clause, changes, at=at, factor=ratio)
    at = (Place(experiments=names, channel="t"),)
    clause = Clause("clock-drift/records", records=names, ratio=ratio)
    remedy = Clause("remedy/record-clock", records=names, ratio=1.0 / ratio)
    of_logger = Hypothesis("clock-drift", clause, (), remedy, at=at, factor=ratio, excluded=names)
    slower = min(ratio, 1.0 / ratio)
    is_whole = round(1.0 / slower) > 1 and whole_reduction(slower)[1]
    is_equal = len(wrong) == len(clocked) and not is_whole
    if changes and len(changes) == len(wrong):
        yield replace(of_prbs, is_undecided=is_equal, rivals=(of_logger.as_rival(),) * is_equal)
    if len(wrong) < len(clocked):
        yield of_logger


# constants of the study


def _excited_joints(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """Records whose excited joint differs from the study."""
    for each in case.contradictions:
        if each.kind != "excited-joint" or each.joint is None:
            continue
        (record,) = each.place.experiments
        values: dict[str, Value] = {"experiment": record, "stated": each.joint}
        for excited in range(1, case.evidence.arm.n_joints + 1):
            if excited != each.joint:
                clause = Clause("swapped-channels/excited-joint", excited=excited, **values)
                change = Correction("experiment", record, "joint", excited)
                yield Hypothesis("swapped-channels", clause, (change,))


def _voltage_scales(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """A wrong PRBS amplitude in the study, or a wrong scale of the voltage.

    The amplitude comes first, unless the measured amplitude exceeds the supply of any drive.
    """
    for name in case.by_channel("level"):
        levels = {
            r.experiment.name: (r.levels[name], r.experiment.prbs.amplitude)
            for r in case.evidence.records
            if name in r.levels and r.experiment.prbs is not None
            if r.experiment.joint == channel_parts(name)[1]
        }
        ratios = {record: level / amplitude for record, (level, amplitude) in levels.items()}
        wrong = {record: ratio for record, ratio in ratios.items() if not 0.5 < ratio < 2.0}
        if not wrong or min(wrong.values()) < _MIN_RATIO:
            continue  # The command belongs to another joint.
        ratio, records = float(np.median(list(wrong.values()))), tuple(wrong)
        stated = max(levels[record][1] for record in wrong)
        scales = scaled(case.evidence, [name], _match_known_factor(1.0 / ratio, _VOLTAGES)[1])
        changes = tuple(
            Correction("experiment", r, "prbs.amplitude", float(f"{levels[r][1] * ratio:.4g}"))
            for r in wrong
        )
        values = {"measured": stated * ratio, "stated": stated, "ratio": ratio}
        clause = Clause("wrong-unit/amplitude", records=records, channel=name, **values)
        prbs, remedy = Place(experiments=records, key="prbs"), Clause("remedy/amplitude")
        alternatives = [(prbs, changes, scales), (Place(channel=name), scales, changes)]
        if stated * ratio > max(stated, _MAX_VOLTAGE):
            alternatives.reverse()
        for place, first, other in alternatives:
            yield Hypothesis("wrong-unit", clause, first, remedy, other, (place,), factor=ratio)


def _gravity(case: UnexplainedEvidence) -> Iterator[Hypothesis]:
    """Gravity stated for a horizontal planar arm, or missing for a vertical one.

    The size alone does not state the gravity of a chain.
    """
    if case.evidence.arm.has_planar_program:
        yield other_gravity(case.evidence)


def _is_accepted(key: str, value: float) -> bool:
    """Whether a study file accepts a value, in either direction."""
    keys = (*study_keys()["joint"], *study_keys()["arm"])
    minimum, maximum = next(each.range for each in keys if each.key == key and each.range)
    return minimum <= abs(value) <= maximum


def _encoder_counts(case: UnexplainedEvidence, joint: int) -> Iterator[Hypothesis]:
    """A wrong number of encoder counts in the study."""
    name, per_turn = f"theta_m{joint}", case.evidence.arm.joints[joint - 1].encoder_counts
    for ratio in case.values(name, "count") if per_turn else ():
        counts = round((per_turn or 0.0) / ratio)
        clause = Clause("wrong-unit/counts", channel=name, ratio=ratio, counts=per_turn)
        change = Correction("joint", str(joint), "encoder_counts", counts)
        if _is_accepted("encoder_counts", counts):
            yield Hypothesis("wrong-unit", clause, (change,), factor=ratio)


def _gear_ratios(case: UnexplainedEvidence, joint: int) -> Iterator[Hypothesis]:
    """A wrong gear ratio in the study."""
    n = case.evidence.arm.joints[joint - 1].gear_ratio
    estimates = [scale * n for scale in case.rotation_factors(joint) if scale > 0.0]
    known = [0.5 * n, 2.0 * n, 1.0 / n, -n]
    for estimate in estimates:  # springs bias it; strain-wave gears have few reductions
        near = min(_REDUCTIONS, key=lambda reduction: abs(math.log(reduction * abs(estimate))))
        if abs(math.log(near * abs(estimate))) < _USUAL_TOLERANCE:
            known.append(math.copysign(1.0 / near, estimate))
    for candidate in estimates + known:
        ratio, is_whole = whole_reduction(candidate)
        if abs(ratio / n - 1.0) < _MAX_FACTOR_DIFFERENCE or not _is_accepted("gear_ratio", ratio):
            continue
        is_distinct = is_whole and 1.0 / ratio <= _MAX_DISTINCT_REDUCTION
        yield Hypothesis(
            "wrong-gear-ratio",
            Clause("wrong-gear-ratio", joint=joint, factor=ratio / n, stated=n, ratio=ratio),
            (Correction("joint", str(joint), "gear_ratio", ratio),),
            factor=n / ratio,
            has_estimated_factor=candidate not in known and not is_distinct,
        )


def _geometry(case: UnexplainedEvidence, joint: int) -> Iterator[Hypothesis]:
    """A wrong accelerometer distance or link length, or an arbitrary accelerometer scale."""
    name, joints = f"a{joint}", case.evidence.arm.joints
    # to a neighbouring axis
    length = max(math.hypot(*each.origin.xyz) for each in joints[joint - 1 : joint + 1])
    values: dict[str, Value] = {"channel": name, "joint": joint}
    stated, key = joints[joint - 1].accelerometer_distance or 0.0, "accelerometer_distance"
    for ratio in case.values(name, "own-joint", "scale") if stated else ():
        corrected = float(f"{ratio * stated:.4g}")
        hint = None  # the point from which the stated distance was probably measured
        if abs(stated - corrected - length) < _DISTANCE_TOLERANCE * length:
            hint = Clause("hint/axis", axis=max(1, joint - 1))
        elif abs(stated + corrected - length) < _DISTANCE_TOLERANCE * length:
            hint = Clause("hint/end")
        values |= {"ratio": ratio, "stated": stated, "corrected": corrected, "hint": hint}
        if _is_accepted(key, corrected):
            yield Hypothesis(
                "wrong-geometry",
                Clause("wrong-geometry/distance", **values),
                (Correction("joint", str(joint), key, corrected),),
                Clause("remedy/distance", joint=joint),
                scaled(case.evidence, [name], 1.0 / ratio),
                factor=1.0 / ratio,
                has_estimated_factor=True,
            )
    has_length = joint > 1 and "link_length" in arm_keys(case.evidence.study.arm)
    for ratio in case.values(name, "origin-motion") if has_length else ():
        corrected = float(f"{ratio * length:.4g}")
        if _is_accepted("link_length", corrected):
            values |= {"ratio": ratio, "stated": length}
            yield Hypothesis(
                "wrong-geometry",
                Clause("wrong-geometry/length", **values),
                (Correction("arm", "", "link_length", corrected),),
                factor=1.0 / ratio,
                has_estimated_factor=True,
            )
    for ratio in case.values(name, "scale"):
        yield other_scale(case.evidence, name, 1.0 / ratio, None, "motor-angle")


_OF_ARM = (
    _exchanged_files,
    _effort_scales,
    _dead_channels,
    _time_bases,
    _record_clocks,
    _input_delays,
    _excited_joints,
    _voltage_scales,
    _gravity,
    _exchanges,
    _angle_units,
    _ac_coupling,
    _sensor_delays,
)
_OF_JOINT = (_channel_scales, _encoder_counts, _gear_ratios, _geometry)
