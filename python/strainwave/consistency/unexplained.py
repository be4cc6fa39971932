"""Contradictions that no single cause explains, said as they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.consistency.evidence import Evidence
from strainwave.consistency.observations import Kind, Observation
from strainwave.consistency.wording import number
from strainwave.records import Suspicion

_RANGE = (1e-9, 1e6)  # [kg m^2] of a motor with its link, on the motor's side


def unexplained(seen: Evidence, left: Sequence[Observation]) -> Iterator[Suspicion]:
    """Suspicions for what contradicts on its own.

    Parameters
    ----------
    seen : Evidence
    left : sequence of Observation

    Returns
    -------
    iterator of Suspicion
    """
    yield from _timed(seen, left, "delay")
    yield from _timed(seen, left, "drift")
    said: set[str] = set()
    for each in left:
        if each.kind in ("followed", "delay", "drift") or each.where in said:
            continue
        said.add(each.where)
        yield _said(each)


def _timed(seen: Evidence, left: Sequence[Observation], kind: Kind) -> Iterator[Suspicion]:
    """Link sensors that lag, or whose lag grows, all of them in one finding."""
    late = [o for o in left if o.kind == kind]
    if not late:
        return
    names = ", ".join(o.where for o in late)
    value = float(np.median([o.value for o in late]))
    if kind == "delay":
        side = "late" if value > 0.0 else "early"
        yield Suspicion(
            code="misaligned",
            where=names,
            message=(
                f"{names}: {number(1e3 * abs(value), 3)} ms {side} against the motor angle, more "
                "than the whole-arm fit corrects"
            ),
            remedy=(
                "Give the sensor's bandwidth (accelerometer_hz, gyro_hz) if it has a filter; "
                "otherwise shift the channel, or have one clock stamp all channels"
            ),
            delay_s=value,
        )
        return
    side = "slow" if value > 0.0 else "fast"
    yield Suspicion(
        code="clock-drift",
        where=names,
        message=(
            f"{names}: the delay against the motor angle changes by {number(1e3 * value, 3)} ms a "
            f"second: another clock stamps them, {number(100.0 * abs(value), 3)} % {side}"
        ),
        remedy=(
            "Have one clock stamp all channels, or resample those at "
            f"{number(1.0 - value, 7)} times their rate before the log is written"
        ),
        factor=1.0 - value,
    )


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
        "inertia": "wrong-sign",
        "torque-ratio": "wrong-torque-constant",
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
        "inertia": "the motion of joint {j} is against its torque: {w} or theta_m{j} has the "
        "wrong sign",
        "torque-ratio": "the torques of joint 1 are {v} of what the symmetry of the inertia "
        "matrix allows beside those of joint 2: one torque constant is wrong",
    }
    code = "wrong-sign" if each.value < 0.0 else codes[each.kind]
    text = about[each.kind].format(w=each.where, v=number(each.value), j=each.joint)
    remedy = "Check its unit, sign and wiring, and the keys of the study that it is compared with"
    if each.kind == "torque-ratio":
        remedy = (
            f"Divide torque_per_volt of [[joint]] 1 by {number(each.value)}, or multiply that of "
            "[[joint]] 2 by it, whichever is known less well"
        )
    return Suspicion(code=code, where=each.where, message=text, remedy=remedy, factor=each.value)
