"""Suspicions for contradictions that no single cause explains, with experiments to isolate it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from strainwave.domain import (
    Place,
    Study,
    Suspicion,
    channel_parts,
)
from strainwave.domain.study import channel_names
from strainwave.signals.consistency.message_text import format_number
from strainwave.signals.consistency.observations import Kind, Observation
from strainwave.signals.consistency.sensors import LINK_CHANNELS
from strainwave.signals.consistency.torque_constants import build_torque_constant_suspicion

_CODES: dict[Kind, str] = {
    "count": "wrong-unit",
    "prbs-clock": "clock-drift",
    "servo-clock": "clock-drift",
    "level": "wrong-unit",
    "limit": "wrong-unit",
    "reference": "wrong-unit",
    "servo": "wrong-unit",
    "velocity": "wrong-unit",
    "scale": "wrong-unit",
    "explained-share": "wrong-unit",
    "own-joint": "wrong-geometry",
    "origin-motion": "wrong-geometry",
    "gravity": "wrong-unit",
    "tilt": "wrong-geometry",
    "rotation-ratio": "wrong-gear-ratio",
    "delay": "misaligned",
    "input-delay": "misaligned",
    "drift": "clock-drift",
    "inertia": "wrong-sign",
    "excited-joint": "swapped-channels",
}
_TEXTS: dict[Kind, str] = {
    "count": "the step of {w} is {v} times the count that encoder_counts implies",
    "prbs-clock": "the voltages of {w} change with a period of {v} times the clock of its prbs",
    "servo-clock": "the voltages of {w} change with a period of {v} times the servo period",
    "level": "the PRBS in {w} has {v} times the amplitude that the study states",
    "limit": "{w} reaches {v} times the limit of the servo",
    "reference": "the velocity of {w} is {v} times its servo reference",
    "servo": "{w} is {v} times the output of the servo that the study states",
    "velocity": "{w} is {v} times the derivative of the motor angle",
    "scale": "{w} is {v} times the value that the motor angles and the geometry imply",
    "explained-share": "the other signals explain only {p} % of {w}",
    "own-joint": "{w} shows {v} times the motion of its own joint",
    "origin-motion": "{w} shows {v} times the motion of its joint's axis",
    "gravity": "{w} shows {v} times the gravity of the study",
    "tilt": "{w} shows a gravity of {v} g, but the study states none",
    "rotation-ratio": "{w} shows {v} times the rotation relative to joint 1 that the gear ratios "
    "imply",
    "delay": "{w} has a delay of {v} s relative to the motor angle",
    "input-delay": "{w} is {v} s later than the torque that moves the motor",
    "drift": "the delay of {w} grows by {v} s per second",
    "inertia": "joint {j} accelerates against its torque: {w} or theta_m{j} has the wrong sign",
    "excited-joint": "the test signal of {w} is not in the command of joint {j}",
}
_EXPERIMENTS = {
    "swapped-channels": "move one joint at a time, and note which columns change",
    "wrong-sign": "turn the link by hand in its positive direction: theta_m and its rate must be "
    "positive, and so must the voltage that turns the link in this direction",
    "wrong-unit": "turn the link by 90 degrees: theta_m must change by 1.5708 / gear_ratio",
    "wrong-gear-ratio": "turn the motor by ten whole turns and measure the angle of the link",
    "wrong-geometry": "measure link_length and accelerometer_distance from axis to axis, and "
    "read the accelerometer at standstill in two postures: a difference is due to gravity",
    "clock-drift": "tap the link twice, one minute apart, and compare the time stamps of the "
    "taps in all channels",
    "misaligned": "command a step of voltage and compare its time stamp with the first change of "
    "theta_m",
    "ac-coupled": "turn the sensor upside down at standstill: the reading of a DC-coupled "
    "accelerometer changes by 2 g permanently",
    "wrong-torque-constant": "hold a known weight at standstill and read the voltage",
}
# Minimum explained share of a link sensor's variance; short records of fault-free arms reach 0.8.
_MIN_EXPLAINED_SHARE = 0.5
# Causes listed after the likely causes.
_GENERAL_CODES = ("swapped-channels", "wrong-unit", "wrong-sign")
# Kinds of observations whose value is a factor without unit.
_DIMENSIONLESS_FACTOR = frozenset(_CODES) - {"delay", "drift", "input-delay", "explained-share"}


def is_reported(each: Observation) -> bool:
    """Whether a contradiction is reported without a cause.

    A low explained share of a motor signal is not reported, because friction and servo limits
    can cause it. Link sensors follow the motion in every fault-free record.
    """
    if each.kind != "explained-share":
        return True
    return channel_parts(each.where)[0] in LINK_CHANNELS and each.value < _MIN_EXPLAINED_SHARE


def report_remaining_contradictions(
    contradictions: Sequence[Observation], likely: Sequence[Suspicion], study: Study
) -> Iterator[Suspicion]:
    """Suspicions for the remaining contradictions, one per channel.

    `likely` holds the causes that explain most of the contradictions, most likely first.
    """
    codes = list(dict.fromkeys([*(each.code for each in likely), *_GENERAL_CODES]))
    steps = [
        f"({k}) {code.replace('-', ' ')}: {_EXPERIMENTS[code]}" for k, code in enumerate(codes, 1)
    ]
    remedy = "No single cause explains all contradictions. Do these experiments, most likely cause "
    remedy += f"first, to isolate the cause: {'; '.join(steps)}"
    channels = set(channel_names(study.arm.n_joints))
    reported: set[str] = set()
    for each in sorted(contradictions, key=lambda o: o.kind == "explained-share"):
        name = each.where.split()[0]  # "u1 torque" refers to channel u1
        if name in reported:
            continue
        reported.add(name)
        place = Place(channel=name) if name in channels else Place.in_records(each.where)
        if each.kind == "torque-ratio":
            yield build_torque_constant_suspicion(each.value, each.std, study)
            continue
        has_unit = each.kind not in _DIMENSIONLESS_FACTOR
        code = "wrong-sign" if each.value < 0.0 and not has_unit else _CODES[each.kind]
        text = _TEXTS[each.kind].format(
            w=each.where,
            v=format_number(each.value),
            p=format_number(100.0 * each.value, 2),
            j=each.joint,
        )
        factor = None if has_unit else each.value
        yield Suspicion(code=code, places=(place,), message=text, remedy=remedy, factor=factor)
