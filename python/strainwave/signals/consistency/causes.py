"""Candidate causes: single faults of the input that can explain contradictions.

Structured causes come first: exchanged joints, gravity, a unit, a sign, a delay. Causes with an
estimated factor come last. Their values stay within the ranges that a study file accepts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import Correction, Place, Suspicion
from strainwave.domain.corrections import correction_text
from strainwave.domain.study_limits import accepted_range
from strainwave.signals.consistency.evidence import Evidence
from strainwave.signals.consistency.observations import Kind, Observation
from strainwave.signals.consistency.sensors import (
    LINK_CHANNELS,
    STANDARD_GRAVITY,
    high_pass_cutoff,
    turning,
)
from strainwave.signals.consistency.wording import listed, number

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
    is_free: bool = False  # the factor is an estimate, not a unit, a sign or an exchange


def causes(seen: Evidence, contradictions: Sequence[Observation]) -> Iterator[Cause]:
    """Yield all candidate causes, structured causes first."""
    yield from _time(seen, contradictions)
    yield from _input_delays(seen, contradictions)
    yield from _test_signals(seen, contradictions)
    yield from _gravity(seen)
    yield from _exchanges(seen, contradictions)
    yield from _angle_units(seen, contradictions)
    yield from _ac_coupled_sensors(seen, contradictions)
    yield from _late_sensors(seen, contradictions)
    joints = {o.joint for o in contradictions if o.joint is not None}
    if any(o.kind == "torque-ratio" for o in contradictions):
        joints |= {1, 2}
    elif joints and max(joints) > 1:
        joints.add(1)  # The readings of link 2 depend on joint 1.
    free: list[Cause] = []
    for joint in sorted(joints):
        for cause in _joint_causes(seen, contradictions, joint):
            if cause.is_free:
                free.append(cause)
            else:
                yield cause
    yield from free


def _joint_causes(
    seen: Evidence, contradictions: Sequence[Observation], joint: int
) -> Iterator[Cause]:
    """Candidate causes that affect one joint, from 1."""
    turns = [*_link_scales(contradictions, joint), *turning(seen, joint)]
    yield from _channels(seen, contradictions, joint)
    yield from _angle(seen, contradictions, joint, turns)
    yield from _gear(seen, joint, turns)
    yield from _geometry(seen, contradictions, joint)
    yield from _reversed_gear(seen, joint)


def _cause(
    seen: Evidence,
    code: str,
    places: Sequence[Place],
    message: str,
    corrections: Sequence[Correction],
    *,
    factor: float | None = None,
    delay_s: float | None = None,
    more: str = "",
    is_free: bool = False,
) -> Cause:
    """Cause whose remedy is the text of its corrections, followed by `more`."""
    text = correction_text(seen.study, corrections)
    remedy = text[:1].upper() + text[1:] + more
    suspicion = Suspicion(
        code=code,
        places=tuple(places),
        message=message,
        remedy=remedy,
        factor=factor,
        delay_s=delay_s,
        corrections=tuple(corrections),
    )
    return Cause(suspicion, is_free)


def _channels_at(names: Iterable[str]) -> list[Place]:
    return [Place(channel=name) for name in names]


def _values(
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


def _scale_corrections(seen: Evidence, name: str, factor: float) -> list[Correction]:
    """Corrections that multiply a channel by a factor."""
    before = seen.channel(name)
    corrections = [Correction("channels", name, "scale", float(f"{before.scale * factor:.7g}"))]
    if before.offset:
        offset = float(f"{before.offset * factor:.7g}")
        corrections.append(Correction("channels", name, "offset", offset))
    return corrections


def _time(seen: Evidence, contradictions: Sequence[Observation]) -> Iterator[Cause]:
    """A time base in another unit, or a wrong clock rate of the logger."""
    clocks = _values(contradictions, "prbs-clock") + _values(contradictions, "servo-clock")
    if not clocks and not any(o.kind in ("followed", "scale") for o in contradictions):
        return
    estimates = [1.0 / float(np.median(clocks))] if clocks else []
    for ratio in (*estimates, *_TIMES.values()):
        unit, factor = _match_known_factor(ratio, _TIMES) or ("", ratio)
        corrections = _scale_corrections(seen, "t", factor)
        if unit:
            message = (
                f"the time base is {number(1.0 / factor)} times what the other signals and the "
                f"clocks of the study imply: t is logged in {unit}, not in seconds"
            )
            code, more = "wrong-unit", ""
        else:
            message = (
                f"voltages change on a clock of {number(1.0 / factor, 6)} times the PRBS or servo "
                "clock of the study: the clock of the logger is wrong by that factor"
            )
            code, more = "clock-drift", ", or correct prbs.clock and the period of the servo"
        yield _cause(
            seen, code, [Place(channel="t")], message, corrections, factor=1.0 / factor, more=more
        )


def _input_delays(seen: Evidence, contradictions: Sequence[Observation]) -> Iterator[Cause]:
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
            f"{listed(group)}: the command in the log is {1e3 * abs(delay):.3g} ms {side} than "
            f"the torque that moves {listed(angles)}, by the phase of the motor's response to the "
            "test signals; damping, stiffness and inertias would absorb this delay"
        )
        corrections = [Correction("log", name, "delay_s", round(delay, 6)) for name in group]
        more = ", or have one clock stamp commands and encoders"
        yield _cause(
            seen, "misaligned", _channels_at(group), message, corrections, delay_s=delay, more=more
        )


def _test_signals(seen: Evidence, contradictions: Sequence[Observation]) -> Iterator[Cause]:
    """Records whose excited joint or PRBS amplitude differs from the study."""
    for each in contradictions:
        if each.kind == "excited-joint" and each.joint is not None:
            record = next(r.experiment for r in seen.records if r.experiment.name == each.where)
            excited = 3 - each.joint
            message = (
                f"{each.where}: the study states joint = {each.joint} as the excited joint, but "
                f"the test signal is in the command of joint {excited}"
            )
            corrections = [Correction("experiment", record.name, "joint", excited)]
            place = Place(experiments=(record.name,), key="joint")
            yield _cause(seen, "swapped-channels", [place], message, corrections)
    for name in dict.fromkeys(o.where for o in contradictions if o.kind == "level"):
        yield from _amplitude(seen, name)


def _amplitude(seen: Evidence, name: str) -> Iterator[Cause]:
    """A wrong PRBS amplitude in the study, or a wrong scale of the voltage.

    The amplitude comes first, unless the measured amplitude exceeds the supply of any drive.
    """
    joint = int(name[-1])
    ratios = {
        r.experiment.name: r.clocks.level[name] / r.experiment.prbs.amplitude
        for r in seen.records
        if name in r.clocks.level and r.experiment.joint == joint and r.experiment.prbs is not None
    }
    stated = {e.name: e.prbs.amplitude for e in seen.study.experiments if e.prbs is not None}
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
    scales = _scale_corrections(seen, name, unit[1] if unit else 1.0 / ratio)
    prbs = Place(experiments=tuple(wrong), key="prbs")
    pair = [(prbs, amplitudes, scales), (Place(channel=name), scales, amplitudes)]
    if amplitude * ratio > max(amplitude, _MAX_VOLTAGE):
        pair.reverse()
    for place, corrections, other in pair:
        message = (
            f"{listed(wrong)}: the PRBS in {name} has an amplitude of "
            f"{number(amplitude * ratio)} V, and the study states {number(amplitude)} V, a factor "
            f"of {number(ratio)}: either the scale of {name} or the amplitude is wrong"
        )
        more = f"; or, if that is right, {correction_text(seen.study, other)}"
        yield _cause(seen, "wrong-unit", [place], message, corrections, factor=ratio, more=more)


def _gravity(seen: Evidence) -> Iterator[Cause]:
    """Gravity stated for a horizontal arm, or missing for a vertical arm."""
    given = seen.study.arm.gravity
    if not given:
        message = "the link sensors show gravity, and the study has none: the arm is vertical"
        corrections = [Correction("arm", "", "gravity", 9.81)]
    else:
        message = (
            f"the link sensors and the torques show no gravity, and the study has gravity = "
            f"{number(given)}: the arm is horizontal"
        )
        corrections = [Correction("arm", "", "gravity", None)]
    yield _cause(seen, "wrong-geometry", [Place(key="gravity")], message, corrections)


def _exchanges(seen: Evidence, contradictions: Sequence[Observation]) -> Iterator[Cause]:
    """Exchanged columns of the two joints: all kinds, one side, one kind, or all kinds but one."""
    kinds = [k for k in _PAIRED if {f"{k}1", f"{k}2"} <= seen.channels]
    if seen.arm.n_joints != 2 or not kinds:
        return
    motors = [k for k in kinds if k in _MOTOR_SIDE]
    groups = [kinds, motors, [k for k in kinds if k not in motors], *([k] for k in kinds)]
    groups += [[k for k in kinds if k != left] for left in kinds]
    for group in dict.fromkeys(tuple(group) for group in groups if group):
        corrections = []
        for kind in group:
            for name, other in ((f"{kind}1", f"{kind}2"), (f"{kind}2", f"{kind}1")):
                source = seen.channel(other)
                corrections.append(Correction("channels", name, "column", source.column))
                corrections.append(Correction("channels", name, "scale", source.scale))
                corrections.append(Correction("channels", name, "offset", source.offset))
        pairs = [f"{kind}1, {kind}2" for kind in group]
        paired = [f"{kind}{joint}" for kind in group for joint in (1, 2)]
        message = f"{listed(pairs)}: the channels of the two joints are exchanged"
        if len(group) == 1:
            kind = group[0]
            message = f"{kind}1 follows joint 2 and {kind}2 joint 1: the two channels are exchanged"
        yield _cause(seen, "swapped-channels", _channels_at(paired), message, corrections)


def _angle_units(seen: Evidence, contradictions: Sequence[Observation]) -> Iterator[Cause]:
    """Motor angles of all joints in another unit, alone or with their velocities."""
    names = [f"theta_m{i}" for i in range(1, seen.arm.n_joints + 1)]
    if len(names) < 2 or not any(o.joint is not None for o in contradictions):
        return
    rates = [f"{k}{i}" for k in ("omega_m", "ref") for i in (1, 2)]
    rates = [name for name in rates if name in seen.channels]
    for unit in _angle_scales(seen, names[0]):
        scales = [_angle_scales(seen, name).get(unit, 0.0) for name in names]
        if not all(scales):
            continue
        corrections = [
            each
            for name, scale in zip(names, scales, strict=True)
            for each in _scale_corrections(seen, name, scale / seen.channel(name).scale)
        ]
        message = f"{listed(names)} are logged in {unit}, not in radians"
        factor = seen.channel(names[0]).scale / scales[0]
        places = _channels_at(names)
        yield _cause(seen, "wrong-unit", places, message, corrections, factor=factor)
        if rates and unit == "degrees":
            more = [each for name in rates for each in _scale_corrections(seen, name, _DEGREE)]
            message = f"{listed([*names, *rates])} are logged in degrees, not in radians"
            places = _channels_at([*names, *rates])
            yield _cause(seen, "wrong-unit", places, message, corrections + more, factor=factor)


def _angle_scales(seen: Evidence, name: str) -> dict[str, float]:
    """Scales to radians of the units in which a motor angle can be logged."""
    names = dict(_ANGLES)
    per_turn = seen.arm.joints[int(name[-1]) - 1].encoder_counts
    if per_turn:
        names["encoder counts"] = 2.0 * np.pi / per_turn
        names["quadrature counts"] = np.pi / 2.0 / per_turn
        names["encoder lines"] = 8.0 * np.pi / per_turn
    scale = seen.channel(name).scale
    for factor in _QUADRATURE_FACTORS:
        names[f"counts of {factor:g} times the scale (lines and quadrature)"] = factor * scale
    return names


def _ac_coupled_sensors(seen: Evidence, contradictions: Sequence[Observation]) -> Iterator[Cause]:
    """AC-coupled accelerometers, for example piezoelectric ones."""
    contradicting = {
        o.where
        for o in contradictions
        if o.where in seen.channels and o.where.startswith("a") and o.kind != "count"
    }
    cutoffs = {name: hz for name in sorted(contradicting) if (hz := high_pass_cutoff(seen, name))}
    groups = [list(cutoffs)] if len(cutoffs) > 1 else []
    for group in [*groups, *([name] for name in cutoffs)]:
        cutoff_text = ", ".join(f"{number(cutoffs[name], 2)} Hz" for name in group)
        message = (
            f"{listed(group)} follow the motion only behind a high-pass of {cutoff_text}: the "
            "sensor or its amplifier is AC-coupled, as piezoelectric accelerometers are. It "
            "reads neither gravity nor slow motion, and the model of a DC-coupled accelerometer "
            "would fit its phase by wrong damping"
        )
        corrections = [Correction("log", name, "high_pass_hz", cutoffs[name]) for name in group]
        yield _cause(seen, "ac-coupled", _channels_at(group), message, corrections)


def _late_sensors(seen: Evidence, contradictions: Sequence[Observation]) -> Iterator[Cause]:
    """Link sensors with a delay or a drift of the delay: all, one kind, or one channel."""
    link = sorted(n for n in seen.channels if n[:-1] in (*LINK_CHANNELS, "deflection"))
    kinds: tuple[Kind, ...] = ("drift", "delay")
    for kind in kinds:
        values = {o.where: o.value for o in contradictions if o.kind == kind}
        groups = [link, *([n for n in link if n[:-1] == k] for k in LINK_CHANNELS)]
        groups += [[name] for name in values]
        for group in groups:
            estimates = [values[name] for name in group if name in values]
            if estimates:
                yield _late_sensor(seen, group, kind, float(np.median(estimates)))


def _late_sensor(seen: Evidence, group: Sequence[str], kind: Kind, value: float) -> Cause:
    """A common delay [s] or drift [s/s] of a group of channels."""
    names, places = ", ".join(group), _channels_at(group)
    if kind == "delay":
        message = (
            f"{names}: {number(1e3 * abs(value), 3)} ms {'late' if value > 0.0 else 'early'} "
            "against the motor angle, more than the whole-arm fit corrects"
        )
        corrections = [Correction("log", name, "delay_s", value) for name in group]
        more = "; or give the sensor's bandwidth (accelerometer_hz, gyro_hz) if it has a filter"
        return _cause(seen, "misaligned", places, message, corrections, delay_s=value, more=more)
    message = (
        f"{names}: the delay against the motor angle changes by {number(1e3 * value, 3)} ms per "
        f"second: they are sampled by another clock, {number(100.0 * abs(value), 3)} % "
        f"{'slow' if value > 0.0 else 'fast'}"
    )
    corrections = [Correction("log", name, "clock", value) for name in group]
    more = ", or have one clock stamp all channels"
    return _cause(seen, "clock-drift", places, message, corrections, factor=1.0 - value, more=more)


def _channel_scale(seen: Evidence, name: str, factor: float, unit: str | None, basis: str) -> Cause:
    """One channel in another unit or with another sign."""
    ratio = 1.0 / factor
    code = "wrong-unit"
    if factor == -1.0:
        code, explanation = "wrong-sign", "its sign is wrong"
    elif unit is not None:
        sign = ", and with the wrong sign" if factor < 0.0 else ""
        explanation = f"logged in {unit}{sign}?"
    else:
        explanation = "its scale is wrong"
    message = f"{name} is {number(ratio)} of what {basis} implies: {explanation}"
    free = unit is None and factor != -1.0
    return _cause(
        seen,
        code,
        [Place(channel=name)],
        message,
        _scale_corrections(seen, name, factor),
        factor=ratio,
        is_free=free,
    )


def _factors(
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


def _channels(seen: Evidence, contradictions: Sequence[Observation], joint: int) -> Iterator[Cause]:
    """Wrong units, signs or scales of all channels of one joint except the motor angle."""
    for kind, basis in _BASIS.items():
        name = f"{kind}{joint}"
        if name not in seen.channels:
            continue
        if kind in LINK_CHANNELS:
            ratios = _values(contradictions, "scale", name)
            ratios += _values(contradictions, "gravity", name)
        elif kind == "ref":
            ratios = [1.0 / r for r in _values(contradictions, "reference", f"theta_m{joint}")]
        elif kind == "omega_m":
            ratios = _values(contradictions, "velocity", name)
        else:
            kinds: tuple[Kind, ...] = ("level", "servo", "limit")
            ratios = [r for k in kinds for r in _values(contradictions, k, name)]
            ratios = [r for r in ratios if abs(r) > _MIN_RATIO]
        if ratios or _is_doubted(contradictions, name, joint):
            relative = {u: s / seen.channel(name).scale for u, s in _UNITS[kind].items()}
            relative["SI units"] = 1.0 / abs(seen.channel(name).scale)
            if kind == "a":  # Other factors can be a wrong distance: see _geometry.
                ratios = [r for r in ratios if _match_known_factor(1.0 / r, relative)]
            if kind in ("u", "torque"):
                ratios += [1.0 / factor for factor in relative.values()]
            for factor, unit in _factors(ratios, relative):
                yield _channel_scale(seen, name, factor, unit, basis.format(joint))


def _is_doubted(contradictions: Sequence[Observation], name: str, joint: int) -> bool:
    """Whether a contradiction depends on a channel."""
    kinds = {"u": ("inertia", "servo"), "torque": ("inertia",)}.get(name[:-1], ())
    return any(o.where == name or (o.joint == joint and o.kind in kinds) for o in contradictions)


def _angle(
    seen: Evidence, contradictions: Sequence[Observation], joint: int, turns: Sequence[float]
) -> Iterator[Cause]:
    """One motor angle with a wrong unit, count or sign, or a wrong number of encoder counts."""
    name = f"theta_m{joint}"
    per_turn = seen.arm.joints[joint - 1].encoder_counts
    if not any(o.joint == joint for o in contradictions):
        return
    steps = _values(contradictions, "count", name)
    ratios = steps + _values(contradictions, "reference", name) + [1.0 / r for r in turns]
    # Unit factors differ from 1 by more than the tolerance.
    ratios = [r for r in ratios if abs(np.log(abs(r))) > _UNIT_TOLERANCE]
    basis = "the motion of the other signals"
    if per_turn:
        basis = "its encoder's count, with the other signals,"
    scale = seen.channel(name).scale
    names = {unit: known / scale for unit, known in _angle_scales(seen, name).items()}
    names |= _round_scales(scale, ratios)
    for factor, unit in _factors(ratios, names):
        yield _channel_scale(seen, name, factor, unit, basis)
    for ratio in steps if per_turn else ():
        counts = round((per_turn or 0.0) / ratio)
        minimum, maximum = accepted_range("encoder_counts")
        if not minimum <= counts <= maximum:
            continue
        message = (
            f"theta_m{joint} moves in steps of {number(ratio)} of the turn that encoder_counts = "
            f"{number(per_turn or 0.0, 7)} implies, while its motion agrees with the other signals"
        )
        corrections = [Correction("joint", str(joint), "encoder_counts", counts)]
        place = Place(joint=joint, key="encoder_counts")
        yield _cause(seen, "wrong-unit", [place], message, corrections, factor=ratio)


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
    scales = [s for kind in kinds for s in _values(contradictions, "scale", f"{kind}{joint}")]
    return scales + _values(contradictions, "own", f"a{joint}")


def _gear(seen: Evidence, joint: int, turns: Sequence[float]) -> Iterator[Cause]:
    """A wrong gear ratio in the study."""
    n = seen.arm.joints[joint - 1].gear_ratio
    minimum, maximum = accepted_range("gear_ratio")
    known = [0.5 * n, 2.0 * n, 1.0 / n]
    for candidate in [scale * n for scale in turns if scale > 0.0] + known:
        reduction = round(1.0 / candidate)
        is_whole = reduction >= 1 and abs(reduction * candidate - 1.0) < _REDUCTION_TOLERANCE
        ratio = float(f"{1.0 / reduction if is_whole else candidate:.5g}")
        if abs(ratio / n - 1.0) < _MAX_FACTOR_DIFFERENCE or not minimum <= ratio <= maximum:
            continue
        message = (
            f"the link sensors of joint {joint} show {number(ratio / n)} of the motion that "
            f"gear_ratio = {number(n)} implies: the link turns {number(ratio)} times per motor "
            "turn"
        )
        corrections = [Correction("joint", str(joint), "gear_ratio", ratio)]
        yield _cause(
            seen,
            "wrong-gear-ratio",
            [Place(joint=joint, key="gear_ratio")],
            message,
            corrections,
            factor=n / ratio,
            is_free=candidate not in known
            and (not is_whole or reduction > _MAX_DISTINCT_REDUCTION),
        )


def _geometry(seen: Evidence, contradictions: Sequence[Observation], joint: int) -> Iterator[Cause]:
    """A wrong accelerometer distance or link length, or an arbitrary accelerometer scale."""
    name = f"a{joint}"
    distance = seen.arm.joints[joint - 1].accelerometer_distance
    length = seen.arm.link_length
    ratios = _values(contradictions, "own", name) + _values(contradictions, "scale", name)
    minimum, maximum = accepted_range("accelerometer_distance")
    for ratio in ratios if distance else ():
        corrected = float(number(ratio * (distance or 0.0)))
        if not minimum <= corrected <= maximum:
            continue
        hint = _distance_hint(corrected, distance or 0.0, length)
        message = (
            f"{name} reads {number(ratio)} of what the motion of joint {joint} gives at "
            f"{number(distance or 0.0)} m from its axis: it is mounted at "
            f"{number(corrected)} m{hint}"
        )
        scale = correction_text(seen.study, _scale_corrections(seen, name, 1.0 / ratio))
        yield _cause(
            seen,
            "wrong-geometry",
            [Place(joint=joint, key="accelerometer_distance")],
            message,
            [Correction("joint", str(joint), "accelerometer_distance", corrected)],
            factor=1.0 / ratio,
            more=f" (from that link's own axis), or, if the sensor's scale is at fault, {scale}",
            is_free=True,
        )
    minimum, maximum = accepted_range("link_length")
    for ratio in _values(contradictions, "elbow", "a2") if length and joint == 2 else ():
        corrected = float(number(ratio * (length or 0.0)))
        if minimum <= corrected <= maximum:
            message = (
                f"a2 shows {number(ratio)} of the motion of axis 2 that link_length = "
                f"{number(length or 0.0)} m implies"
            )
            corrections = [Correction("arm", "", "link_length", corrected)]
            yield _cause(
                seen,
                "wrong-geometry",
                [Place(key="link_length")],
                message,
                corrections,
                factor=1.0 / ratio,
                is_free=True,
            )
    for ratio in _values(contradictions, "scale", name):
        yield _channel_scale(seen, name, 1.0 / ratio, None, f"theta_m{joint}")


def _distance_hint(right: float, given: float, length: float | None) -> str:
    """Message text on the point from which the stated distance was probably measured."""
    if length is None:
        return ""
    if abs(given - right - length) < 0.1 * length:
        return "; measured from axis 1 in place of axis 2?"
    if abs(given + right - length) < 0.1 * length:
        return "; measured from the link's far end?"
    return ""


def _reversed_gear(seen: Evidence, joint: int) -> Iterator[Cause]:
    """A reversing gear: motor angle and torque are consistent, the link has the opposite sign."""
    names = [f"{k}{joint}" for k in _MOTOR_SIDE if f"{k}{joint}" in seen.channels]
    corrections = [each for name in names for each in _scale_corrections(seen, name, -1.0)]
    message = (
        f"link {joint} turns against its motor: every link sensor of joint {joint} has the "
        "opposite sign of its motor's signals"
    )
    more = ", so that motor and link turn the same way"
    places = _channels_at(names)
    yield _cause(seen, "wrong-sign", places, message, corrections, factor=-1.0, more=more)
