"""Suspicions for contradictions that no single cause explains, with experiments to isolate it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from strainwave.domain import (
    Place,
    Study,
    Suspicion,
)
from strainwave.domain.study import channel_names
from strainwave.signals.consistency.observations import Kind, Observation
from strainwave.signals.consistency.sensors import LINK_CHANNELS
from strainwave.signals.consistency.torque_constants import wrong_torque_constant
from strainwave.signals.consistency.wording import number

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
    "followed": "wrong-unit",
    "own": "wrong-geometry",
    "elbow": "wrong-geometry",
    "gravity": "wrong-unit",
    "tilt": "wrong-geometry",
    "turn": "wrong-gear-ratio",
    "delay": "misaligned",
    "input-delay": "misaligned",
    "drift": "clock-drift",
    "inertia": "wrong-sign",
    "excited-joint": "swapped-channels",
}
_TEXTS: dict[Kind, str] = {
    "count": "the step of {w} is {v} of the count that encoder_counts implies",
    "prbs-clock": "the voltages of {w} change on a clock of {v} times that of its prbs",
    "servo-clock": "the voltages of {w} change on a clock of {v} times the servo's period",
    "level": "the PRBS in {w} has {v} times the amplitude that the study states",
    "limit": "{w} reaches {v} times the limit of the servo",
    "reference": "the velocity of {w} is {v} of the reference that it follows",
    "servo": "{w} is {v} of the output that the servo of the study gives",
    "velocity": "{w} is {v} of the motor angle's derivative",
    "scale": "{w} is {v} of what the motor angles and the geometry imply",
    "followed": "the other signals explain only {p} % of {w}",
    "own": "{w} shows {v} of its own joint's motion",
    "elbow": "{w} shows {v} of the motion of its link's axis",
    "gravity": "{w} shows {v} of gravity",
    "tilt": "{w} shows {v} of gravity, and the study has none",
    "turn": "{w} shows {v} times the turning of joint 2 against joint 1 that the gear ratios imply",
    "delay": "{w} lags by {v} s behind the motor angle",
    "input-delay": "{w} is {v} s later than the torque that moves the motor",
    "drift": "the delay of {w} grows by {v} s per second",
    "inertia": "joint {j} accelerates against its torque: {w} or theta_m{j} has the wrong sign",
    "excited-joint": "the test signal of {w} is not in the command of joint {j}",
}
_EXPERIMENTS = {
    "swapped-channels": "move joint 1 alone, then joint 2 alone, and see which columns change",
    "wrong-sign": "turn the link by hand in its positive direction: theta_m, its rate and the "
    "voltage that does the same must be positive",
    "wrong-unit": "turn the link by 90 degrees: theta_m must change by 1.5708 / gear_ratio",
    "wrong-gear-ratio": "turn the motor by ten whole turns and measure the angle of the link",
    "wrong-geometry": "measure link_length and accelerometer_distance from axis to axis, and "
    "read the accelerometer of the resting link in two postures: a difference is gravity",
    "clock-drift": "record one minute of rest between two knocks and compare their stamps",
    "misaligned": "command a step of voltage and compare its stamp with the first change of "
    "theta_m",
    "ac-coupled": "turn the resting sensor over: a DC-coupled accelerometer changes by 2 g and "
    "stays there",
    "wrong-torque-constant": "hold a known weight at standstill and read the voltage",
}
# Minimum explained share of a link sensor's variance; short records of fault-free arms reach 0.8.
_MIN_EXPLAINED_SHARE = 0.5
# Causes listed after the likely causes.
_GENERAL_CODES = ("swapped-channels", "wrong-unit", "wrong-sign")
# Kinds of observations whose value is a factor without unit.
_DIMENSIONLESS_FACTOR = frozenset(_CODES) - {"delay", "drift", "input-delay", "followed"}


def is_reported(each: Observation) -> bool:
    """Whether a contradiction is reported without a cause.

    A low explained share of a motor signal is not reported, because friction and servo limits
    can cause it. Link sensors follow the motion in every fault-free record.
    """
    if each.kind != "followed":
        return True
    return each.where[:-1] in LINK_CHANNELS and each.value < _MIN_EXPLAINED_SHARE


def unexplained(
    left: Sequence[Observation], likely: Sequence[Suspicion], study: Study
) -> Iterator[Suspicion]:
    """Suspicions for the remaining contradictions, one per channel.

    `likely` holds the causes that explain most of the contradictions, most likely first.
    """
    codes = list(dict.fromkeys([*(each.code for each in likely), *_GENERAL_CODES]))
    steps = [
        f"({k}) {code.replace('-', ' ')}: {_EXPERIMENTS[code]}" for k, code in enumerate(codes, 1)
    ]
    remedy = "No single cause explains all contradictions. Likely causes in order, each with the "
    remedy += f"experiment that separates it: {'; '.join(steps)}"
    channels = set(channel_names(study.arm.n_joints))
    reported: set[str] = set()
    for each in sorted(left, key=lambda o: o.kind == "followed"):
        name = each.where.split()[0]  # "u1 torque" refers to channel u1
        if name in reported:
            continue
        reported.add(name)
        place = Place(channel=name) if name in channels else Place.in_records(each.where)
        if each.kind == "torque-ratio":
            yield wrong_torque_constant(each.value, each.std, study)
            continue
        is_timed = each.kind not in _DIMENSIONLESS_FACTOR
        code = "wrong-sign" if each.value < 0.0 and not is_timed else _CODES[each.kind]
        text = _TEXTS[each.kind].format(
            w=each.where, v=number(each.value), p=number(100.0 * each.value, 2), j=each.joint
        )
        factor = None if is_timed else each.value
        yield Suspicion(code=code, places=(place,), message=text, remedy=remedy, factor=factor)
