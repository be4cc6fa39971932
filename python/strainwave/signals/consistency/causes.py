"""Single causes that would explain contradictions, each with the evidence as it would then be."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import Suspicion
from strainwave.signals.consistency.evidence import Evidence
from strainwave.signals.consistency.observations import Observation
from strainwave.signals.consistency.sensors import LINK_CHANNELS, STANDARD_GRAVITY, turning
from strainwave.signals.consistency.wording import column_line, number, scaled_line, swap_line

_DEGREE = float(np.pi / 180.0)
_NAMED = 0.04  # of a known factor, within which a found one is that
_WHOLE_TURNS = 0.01  # of a gear's reduction, within which it is a whole number

_UNITS: dict[str, dict[str, float]] = {
    "a": {"g": STANDARD_GRAVITY, "mm/s^2": 1e-3, "cm/s^2": 1e-2, "mg": 1e-3 * STANDARD_GRAVITY},
    "gyro": {"deg/s": _DEGREE, "mrad/s": 1e-3, "rpm": np.pi / 30.0},
    "theta_l": {"degrees": _DEGREE, "turns": 2.0 * np.pi, "mrad": 1e-3},
    "theta_m": {"degrees": _DEGREE, "turns": 2.0 * np.pi, "mrad": 1e-3},
    "omega_m": {"deg/s": _DEGREE, "rpm": np.pi / 30.0, "turns/s": 2.0 * np.pi},
    "ref": {"deg/s": _DEGREE, "rpm": np.pi / 30.0, "turns/s": 2.0 * np.pi},
    "u": {"mV": 1e-3},
    "torque": {"mN m": 1e-3},
}
"""Of each kind of channel: what else it may have been logged in, and the scale to SI."""

_TIMES = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9, "minutes": 60.0}


@dataclass(frozen=True, slots=True)
class Cause:
    """Something that may be wrong, and what the evidence is without it."""

    suspicion: Suspicion
    mend: Callable[[], Evidence]


def causes(seen: Evidence, contradictions: Sequence[Observation]) -> Iterator[Cause]:
    """Every single cause worth trying, the likelier first.

    Parameters
    ----------
    seen : Evidence
    contradictions : sequence of Observation
        Those of the evidence's observations that contradict.

    Returns
    -------
    iterator of Cause
    """
    yield from _time(seen, contradictions)
    yield from _swaps(seen)
    yield from _late(seen, contradictions)
    touched = {o.joint for o in contradictions if o.joint is not None}
    if any(o.kind == "torque-ratio" for o in contradictions):
        touched |= {1, 2}
    elif touched and max(touched) > 1:
        touched.add(1)  # what link 2 reads depends on joint 1
    for joint in sorted(touched):
        yield from _channels(seen, contradictions, joint)
        turns = [*_link_scales(contradictions, joint), *turning(seen, joint)]
        yield from _angle(seen, contradictions, joint, turns)
        yield from _gear(seen, joint, turns)
        yield from _geometry(seen, contradictions, joint)
        yield from _gain(seen, contradictions, joint)
        yield from _turned(seen, joint)


def _values(found: Sequence[Observation], kind: str, where: str | None = None) -> list[float]:
    return [
        o.value for o in found if o.kind == kind and (where is None or o.where == where) and o.value
    ]


def _named(factor: float, names: dict[str, float]) -> tuple[str, float] | None:
    """The known factor that a found one is, of either sign."""
    for name, known in names.items():
        if abs(np.log(abs(factor) / known)) < _NAMED:
            return name, float(np.copysign(known, factor))
    return None


def _time(seen: Evidence, found: Sequence[Observation]) -> Iterator[Cause]:
    clocks = _values(found, "prbs-clock") + _values(found, "servo-clock")
    tried = [1.0 / float(np.median(clocks))] if clocks else []
    tried += list(_TIMES.values())
    for ratio in tried:
        name, factor = _named(ratio, _TIMES) or ("", ratio)
        if name:
            suspicion = Suspicion(
                code="wrong-unit",
                where="t",
                message=(
                    f"the time base is {number(1.0 / factor)} times what the other signals and "
                    f"the study's clocks imply: t is logged in {name}, not in seconds"
                ),
                remedy=scaled_line(seen.study, "t", factor),
                factor=1.0 / factor,
            )
        else:
            suspicion = Suspicion(
                code="clock-drift",
                where="t",
                message=(
                    f"the logger's clock runs at {number(1.0 / factor, 6)} of the drive's: voltages"
                    " change on a clock of that many times the study's PRBS or servo clock"
                ),
                remedy=scaled_line(seen.study, "t", factor)
                + ", or mend prbs.clock and the servo's period if those are at fault",
                factor=1.0 / factor,
            )
        yield Cause(suspicion, lambda f=factor: seen.retimed(f))  # type: ignore[misc]


def _late(seen: Evidence, found: Sequence[Observation]) -> Iterator[Cause]:
    """Link sensors that lag, or whose lag grows: all together, those of a kind, or one."""
    there = {name for record in seen.records for name in record.channels}
    link = sorted(name for name in there if name[:-1] in (*LINK_CHANNELS, "deflection"))
    for kind in ("drift", "delay"):
        values = {o.where: o.value for o in found if o.kind == kind}
        if not values:
            continue
        groups = [link, *([n for n in link if n[:-1] == k] for k in LINK_CHANNELS)]
        groups += [[name] for name in values]
        for group in groups:
            own = [values[name] for name in group if name in values]
            if own:
                value = float(np.median(own))
                yield _timed(seen, group, kind, value)


def _timed(seen: Evidence, group: Sequence[str], kind: str, value: float) -> Cause:
    names = ", ".join(group)
    if kind == "delay":
        late = Suspicion(
            code="misaligned",
            where=names,
            message=(
                f"{names}: {number(1e3 * abs(value), 3)} ms {'late' if value > 0.0 else 'early'} "
                "against the motor angle, more than the whole-arm fit corrects"
            ),
            remedy=(
                "Give the sensor's bandwidth (accelerometer_hz, gyro_hz) if it has a filter; "
                "otherwise shift the channel, or have one clock stamp all channels"
            ),
            delay_s=value,
        )
        return Cause(late, lambda: seen.shifted(group, value, 0.0))
    drifting = Suspicion(
        code="clock-drift",
        where=names,
        message=(
            f"{names}: the delay against the motor angle changes by {number(1e3 * value, 3)} ms a "
            f"second: they are sampled by another clock, {number(100.0 * abs(value), 3)} % "
            f"{'slow' if value > 0.0 else 'fast'}"
        ),
        remedy=(
            "Have one clock stamp all channels, or resample these at "
            f"{number(1.0 + value, 7)} times their spacing before the log is written"
        ),
        factor=1.0 - value,
    )
    return Cause(drifting, lambda: seen.shifted(group, 0.0, value))


def _swaps(seen: Evidence) -> Iterator[Cause]:
    if seen.arm.n_joints != 2:
        return
    there = {name for record in seen.records for name in record.channels}
    for kind in ("a", "u", "theta_m", "torque", "gyro", "theta_l", "ref", "omega_m"):
        if f"{kind}1" in there and f"{kind}2" in there:
            suspicion = Suspicion(
                code="swapped-channels",
                where=f"{kind}1, {kind}2",
                message=(
                    f"{kind}1 follows joint 2 and {kind}2 joint 1: the two channels are exchanged"
                ),
                remedy=swap_line(seen.study, kind),
            )
            yield Cause(suspicion, lambda k=kind: seen.swapped(k))  # type: ignore[misc]


def _scaled(seen: Evidence, name: str, factor: float, unit: str | None, over: str) -> Cause:
    """One channel in another unit or with another sign."""
    ratio = 1.0 / factor
    if factor == -1.0:
        code, said = "wrong-sign", "its sign is wrong"
    elif unit is not None:
        sign = ", and with the wrong sign" if factor < 0.0 else ""
        code, said = "wrong-unit", f"logged in {unit}{sign}?"
    else:
        code, said = "wrong-unit", "its scale is wrong"
    suspicion = Suspicion(
        code=code,
        where=name,
        message=f"{name} is {number(ratio)} of what {over} implies: {said}",
        remedy=scaled_line(seen.study, name, factor),
        factor=ratio,
    )
    return Cause(suspicion, lambda: seen.scaled(name, factor))


def _tried(ratios: Sequence[float], names: dict[str, float]) -> Iterator[tuple[float, str | None]]:
    """Factors worth trying for a channel found at some ratios: a sign, a known unit, as found."""
    yield -1.0, None
    seen: list[float] = []
    for ratio in ratios:
        known = _named(1.0 / ratio, names)
        factor, unit = (known[1], known[0]) if known else (1.0 / ratio, None)
        if abs(abs(factor) - 1.0) > 1e-9 and not any(abs(factor / f - 1.0) < 0.02 for f in seen):
            seen.append(factor)
            yield factor, unit


def _channels(seen: Evidence, found: Sequence[Observation], joint: int) -> Iterator[Cause]:
    """Voltages, link sensors, references and velocities of one joint."""
    there = {name for record in seen.records for name in record.channels}
    over = {
        "a": f"theta_m{joint}",
        "gyro": f"theta_m{joint}",
        "theta_l": f"theta_m{joint}",
        "omega_m": f"theta_m{joint}",
        "ref": f"theta_m{joint}",
        "u": "the servo or the motion",
        "torque": "the motion",
    }
    for kind, cause in over.items():
        name = f"{kind}{joint}"
        if name not in there:
            continue
        if kind in ("a", "gyro", "theta_l"):
            ratios = _values(found, "scale", name) + _values(found, "gravity", name)
            ratios = [r for r in ratios if kind != "a" or _is_unit(r, kind)]
        elif kind == "ref":
            ratios = [1.0 / r for r in _values(found, "reference", f"theta_m{joint}")]
        elif kind == "omega_m":
            ratios = _values(found, "velocity", name)
        else:
            ratios = _values(found, "level", name) + _values(found, "servo", name)
            ratios = [r for r in ratios if abs(r) > 1e-6]
        if ratios or _doubted(found, name, joint):
            for factor, unit in _tried(ratios, _UNITS[kind]):
                yield _scaled(seen, name, factor, unit, cause)


def _is_unit(ratio: float, kind: str) -> bool:
    return _named(1.0 / ratio, _UNITS[kind]) is not None


def _doubted(found: Sequence[Observation], name: str, joint: int) -> bool:
    """Whether anything that depends on a channel contradicts."""
    kinds = {"u": ("inertia", "servo"), "torque": ("inertia",)}.get(name[:-1], ())
    return any(o.where == name or (o.joint == joint and o.kind in kinds) for o in found)


def _angle(
    seen: Evidence, found: Sequence[Observation], joint: int, turns: Sequence[float]
) -> Iterator[Cause]:
    """The motor angle in another unit, or with the wrong sign."""
    name = f"theta_m{joint}"
    names = dict(_UNITS["theta_m"])
    per_turn = seen.arm.joints[joint - 1].encoder_counts
    if per_turn:
        names["encoder counts"] = 2.0 * np.pi / per_turn
        names["quadrature counts"] = np.pi / 2.0 / per_turn
    ratios = _values(found, "count", name) + _values(found, "reference", name)
    if not any(o.joint == joint for o in found):
        return
    ratios += [1.0 / r for r in turns]
    ratios = [r for r in ratios if abs(np.log(abs(r))) > _NAMED]  # no unit is so near to another
    over = "its encoder's counts and the other signals" if per_turn else "the other signals"
    for factor, unit in _tried(ratios, names):
        yield _scaled(seen, name, factor, unit, over)
    if per_turn:
        for ratio in _values(found, "count", name):
            counts = per_turn / ratio
            suspicion = Suspicion(
                code="wrong-unit",
                where=f"joint {joint} encoder_counts",
                message=(
                    f"theta_m{joint} moves in steps of {number(ratio)} of the turn that "
                    f"encoder_counts = {number(per_turn, 7)} implies, while its motion agrees with "
                    "the other signals"
                ),
                remedy=f"set encoder_counts = {round(counts)} in [[joint]] {joint}",
                factor=ratio,
            )
            yield Cause(
                suspicion,
                lambda c=counts: seen.with_joint(joint, encoder_counts=c),  # type: ignore[misc]
            )


def _link_scales(found: Sequence[Observation], joint: int) -> list[float]:
    """What a joint's link sensors read over what they should, the most direct first."""
    kinds = ("gyro", "theta_l", "a")
    scales = [s for kind in kinds for s in _values(found, "scale", f"{kind}{joint}")]
    return scales + _values(found, "own", f"a{joint}")


def _gear(seen: Evidence, joint: int, turns: Sequence[float]) -> Iterator[Cause]:
    """A gear ratio that is not the gear's."""
    n = seen.arm.joints[joint - 1].gear_ratio
    tried = [scale * n for scale in turns if scale > 0.0] + [0.5 * n, 2.0 * n, 1.0 / n]
    for found_ratio in tried:
        reduction = round(1.0 / found_ratio)
        whole = reduction > 1 and abs(reduction * found_ratio - 1.0) < _WHOLE_TURNS
        ratio = 1.0 / reduction if whole else found_ratio
        if abs(ratio / n - 1.0) < 0.02:
            continue
        suspicion = Suspicion(
            code="wrong-gear-ratio",
            where=f"joint {joint} gear_ratio",
            message=(
                f"the link sensors of joint {joint} show {number(ratio / n)} of the motion that "
                f"gear_ratio = {number(n)} implies: the link turns {number(ratio)} times per motor "
                "turn"
            ),
            remedy=f"set gear_ratio = {number(ratio, 5)} in [[joint]] {joint}",
            factor=n / ratio,
        )
        yield Cause(
            suspicion,
            lambda r=ratio: seen.with_joint(joint, gear_ratio=r),  # type: ignore[misc]
        )


def _geometry(seen: Evidence, found: Sequence[Observation], joint: int) -> Iterator[Cause]:
    """An accelerometer elsewhere than the study says, or axes further apart."""
    name = f"a{joint}"
    distance = seen.arm.joints[joint - 1].accelerometer_distance
    length = seen.arm.link_length
    tried = _values(found, "own", name) + _values(found, "scale", name)
    for ratio in tried if distance else ():
        if ratio <= 0.0:
            continue
        right = ratio * (distance or 0.0)
        hint = _hint(right, distance or 0.0, length)
        suspicion = Suspicion(
            code="wrong-geometry",
            where=f"joint {joint} accelerometer_distance",
            message=(
                f"{name} reads {number(ratio)} of what the motion of joint {joint} gives at "
                f"{number(distance or 0.0)} m from its axis: it sits at {number(right)} m{hint}"
            ),
            remedy=(
                f"set accelerometer_distance = {number(right)} in [[joint]] {joint} (from that "
                f"link's own axis), or {column_line(seen.study, name, 1.0 / ratio)} if the "
                "sensor's scale is at fault"
            ),
            factor=1.0 / ratio,
        )
        yield Cause(
            suspicion,
            lambda d=right: seen.with_joint(joint, accelerometer_distance=d),  # type: ignore[misc]
        )
    for ratio in _values(found, "elbow", "a2") if length and joint == 2 else ():
        if ratio > 0.0:
            right = ratio * (length or 0.0)
            suspicion = Suspicion(
                code="wrong-geometry",
                where="link_length",
                message=(
                    f"a2 shows {number(ratio)} of the motion of axis 2 that link_length = "
                    f"{number(length or 0.0)} m implies"
                ),
                remedy=f"set link_length = {number(right)} in [arm]",
                factor=1.0 / ratio,
            )
            yield Cause(suspicion, lambda r=right: seen.with_length(r))  # type: ignore[misc]


def _gain(seen: Evidence, found: Sequence[Observation], joint: int) -> Iterator[Cause]:
    """An accelerometer whose whole reading, gravity and all, has another scale."""
    name = f"a{joint}"
    for ratio in _values(found, "scale", name):
        yield _scaled(seen, name, 1.0 / ratio, None, f"theta_m{joint}")


def _hint(right: float, given: float, length: float | None) -> str:
    if length is None:
        return ""
    if abs(given - right - length) < 0.1 * length:
        return "; measured from axis 1 in place of axis 2?"
    if abs(given + right - length) < 0.1 * length:
        return "; measured from the link's far end?"
    return ""


def _turned(seen: Evidence, joint: int) -> Iterator[Cause]:
    """A gear that reverses: motor angle and torque agree with each other, not with the link."""
    names = [f"{kind}{joint}" for kind in ("theta_m", "u", "torque", "ref", "omega_m")]
    there = {name for record in seen.records for name in record.channels}
    names = [name for name in names if name in there]

    def mend() -> Evidence:
        turned = seen
        for name in names:
            turned = turned.scaled(name, -1.0)
        return turned

    lines = "; ".join(column_line(seen.study, name, -1.0) for name in names)
    suspicion = Suspicion(
        code="wrong-sign",
        where=", ".join(names),
        message=(
            f"link {joint} turns against its motor: every link sensor of joint {joint} has the "
            "other sign than its motor's signals"
        ),
        remedy=f"set {lines}, so that motor and link turn the same way",
        factor=-1.0,
    )
    yield Cause(suspicion, mend)
