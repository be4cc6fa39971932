"""Contradictions that no single cause explains, said as they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from strainwave.domain import Study, Suspicion
from strainwave.signals.consistency.observations import Kind, Observation
from strainwave.signals.consistency.torque_constants import wrong_torque_constant
from strainwave.signals.consistency.wording import number


def unexplained(left: Sequence[Observation], study: Study) -> Iterator[Suspicion]:
    """Suspicions for what contradicts on its own.

    Parameters
    ----------
    left : sequence of Observation
    study : Study

    Returns
    -------
    iterator of Suspicion
    """
    said: set[str] = set()
    for each in left:
        if each.kind == "followed" or each.where in said:
            continue
        said.add(each.where)
        if each.kind == "torque-ratio":
            yield wrong_torque_constant(each.value, each.std, study)
        else:
            yield _said(each)


def _said(each: Observation) -> Suspicion:
    codes: dict[Kind, str] = {
        "count": "wrong-unit",
        "prbs-clock": "clock-drift",
        "servo-clock": "clock-drift",
        "level": "wrong-unit",
        "reference": "wrong-unit",
        "servo": "wrong-unit",
        "velocity": "wrong-unit",
        "scale": "wrong-unit",
        "own": "wrong-geometry",
        "elbow": "wrong-geometry",
        "gravity": "wrong-unit",
        "turn": "wrong-gear-ratio",
        "delay": "misaligned",
        "drift": "clock-drift",
        "inertia": "wrong-sign",
    }
    about: dict[Kind, str] = {
        "count": "the step of {w} is {v} of the count that encoder_counts implies",
        "prbs-clock": "the voltages of {w} change on a clock {v} times that of its prbs",
        "servo-clock": "the voltages of {w} change on a clock {v} times the servo's period",
        "level": "the PRBS in {w} has {v} times the amplitude that the study gives",
        "reference": "the velocity of {w} is {v} of the reference that it follows",
        "servo": "{w} is {v} of what the study's servo makes of reference and motor angle",
        "velocity": "{w} is {v} of the motor angle's derivative",
        "scale": "{w} is {v} of what the motor angles and the geometry imply",
        "own": "{w} shows {v} of its own joint's motion",
        "elbow": "{w} shows {v} of the motion of its link's axis",
        "gravity": "{w} shows {v} of gravity",
        "turn": "{w} shows {v} times the turning of joint 2 against joint 1 that the gear ratios "
        "imply",
        "delay": "{w} lags by {v} s behind the motor angle",
        "drift": "the delay of {w} grows by {v} s a second",
        "inertia": "the motion of joint {j} is against its torque: {w} or theta_m{j} has the "
        "wrong sign",
    }
    timed = each.kind in ("delay", "drift")
    code = "wrong-sign" if each.value < 0.0 and not timed else codes[each.kind]
    text = about[each.kind].format(w=each.where, v=number(each.value), j=each.joint)
    remedy = "Check its unit, sign and wiring, and the keys of the study that it is compared with"
    return Suspicion(code=code, where=each.where, message=text, remedy=remedy, factor=each.value)
