"""Causes of sizes that rigs are known for, each on one arm, before and after `effects = "auto"`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from benchmarks.studies.causes.drawn import Run, drawn
from benchmarks.studies.causes.judged import Engine, error_percent, is_sound, judged
from benchmarks.studies.causes.tables import Counted
from strainwave.virtual.families.causes import Cause, slower

Sizes = Mapping[str, float]
_MOST_DRAWN = 60
_WORST = 3  # parameters that a row names


@dataclass(frozen=True, slots=True)
class Stated:
    """A cause of a given size, and the arm that it befalls."""

    text: str
    name: str
    joint: int
    sizes: Callable[[Run], Sizes]
    gravity: Literal["horizontal", "upright"] = "horizontal"
    spring: Literal["linear", "three-slope"] = "linear"

    def run(self, series: int) -> Run:
        """The first drawn arm of that kind, with this cause.

        Parameters
        ----------
        series : int
            Another one draws other arms.

        Returns
        -------
        Run
        """
        for number in range(_MOST_DRAWN):
            found = drawn(self.name, number, series)
            spring = found.rig.study.arm.joints[0].spring
            if (found.rig.classes["gravity"], spring) == (self.gravity, self.spring):
                return Run(found.rig, Cause(self.name, self.joint, self.sizes(found)), number)
        raise LookupError(f"no {self.gravity} arm with {self.spring} gears was drawn")


def _always(**sizes: float) -> Callable[[Run], Sizes]:
    return lambda run: sizes


def _limit(run: Run) -> float:
    servo = run.rig.study.arm.servo
    return servo.limit if servo else 10.0


def _by_record(first: float, last: float) -> Callable[[Run], Sizes]:
    """Factors that go evenly from one to another through the records."""

    def sizes(run: Run) -> Sizes:
        n = len(run.rig.study.experiments)
        return {f"factor_{k}": first + (last - first) * k / (n - 1) for k in range(n)}

    return sizes


def _coulomb(share: float, name: str, **others: float) -> Callable[[Run], Sizes]:
    """A torque that is a share of the first joint's Coulomb friction."""
    return lambda run: {name: share * run.rig.values["motor_coulomb_friction", 1], **others}


STATED: Sequence[Stated] = (
    Stated(
        "torque constant falls 10 % at full voltage",
        "drive-saturation",
        1,
        lambda run: {"drive_saturation": 0.1 / _limit(run)},
    ),
    Stated(
        "amplifier gain drifts by 4 % through the records",
        "drive-gain-by-record",
        1,
        _by_record(0.98, 1.02),
    ),
    Stated("torque constant of joint 2 10 % off", "drive-gain", 2, _always(gain=1.1)),
    Stated(
        "link 1 flexible",
        "flexible-link",
        1,
        _always(stiffness=6.0, damping_ratio=0.01),
    ),
    Stated(
        "base on soft feet, 12 Hz",
        "soft-base",
        1,
        lambda run: {
            "base_compliance": 1.0 / run.rig.values["gear_stiffness", 1],
            "base_frequency": 12.0,
            "base_damping": 0.02,
            "sliding_frequency": 100.0,
            "mass": 5.0,
        },
    ),
    Stated("backlash of 0.2 mrad", "backlash", 1, _always(backlash=1e-4), spring="three-slope"),
    Stated(
        "cable drag, 2 N m/rad to ground",
        "ground-spring",
        2,
        _always(ground_stiffness=2.0, ground_preload=0.0),
        gravity="upright",
    ),
    Stated(
        "encoder zero of joint 2 off by 10 degrees",
        "encoder-zero",
        2,
        _always(angle=math.radians(10.0)),
        gravity="upright",
    ),
    Stated(
        "table tilted by 5 degrees",
        "tilt",
        1,
        _always(angle=math.radians(5.0), azimuth=0.8),
        spring="three-slope",
    ),
    Stated("friction grows with the gear's torque", "load-friction", 1, _always(load_friction=0.1)),
    Stated(
        "friction grows with the root of speed",
        "power-friction",
        1,
        _coulomb(0.3, "power_friction", power_exponent=0.5),
    ),
    Stated(
        "friction falls by 30 % while grease warms",
        "friction-by-record",
        1,
        _by_record(1.15, 0.85),
    ),
    Stated("amplifier dead zone of 0.2 V", "dead-zone", 1, _always(dead_zone=0.2)),
    Stated(
        "amplifier clips at 8 of 10 V",
        "drive-limit",
        1,
        lambda run: {"drive_limit": 0.8 * _limit(run), "drive_limit_loss": 1.0},
    ),
    Stated(
        "current loop of 100 Hz, not 1000 Hz",
        "drive-lag",
        1,
        lambda run: slower(100.0, run.rig.study, 1),
    ),
    Stated(
        "accelerometer 1 rings on its mount at 90 Hz",
        "sensor-mount",
        1,
        _always(frequency=90.0, damping_ratio=0.03),
    ),
)


def tried(place: int, *, engine: Engine, series: int) -> dict[str, Any]:
    """What is found of one of the stated causes; failures are found as well.

    Parameters
    ----------
    place : int
        In `STATED`.
    engine : str
    series : int

    Returns
    -------
    dict
    """
    stated = STATED[place]
    head = {"seed": place, "text": stated.text, "cause": stated.name}
    try:
        found = judged(stated.run(series), engine=engine, series=series, named=False, auto=True)
    except Exception as failure:  # a study reports, it does not stop
        return {**head, "number": 0, "failure": f"{type(failure).__name__}: {failure}"}
    return {**head, **found}


def before_and_after(found: Sequence[dict[str, Any]]) -> Counted:
    """What comes out wrong, what is named, and what is wrong after the fit took it up.

    Parameters
    ----------
    found : sequence of dict
        From `tried`.

    Returns
    -------
    Counted
    """
    rows = []
    for one in found:
        named = one["plain"]["named"]
        text = "nothing" if named is None else f"{named[0]} of joint {named[1]}"
        if one["plain"].get("suspected"):
            text = ", ".join(one["plain"]["suspected"])
        taken = ", ".join(f"{name} {joint}" for name, joint in one["auto"].get("effects", []))
        ignored, after = (_wrong(one[fit]["parameters"]) for fit in ("plain", "auto"))
        rows.append((one["text"], ignored, text, taken or "nothing", after))
    head = ("in the plant", "wrong if ignored", "named", "taken up", "wrong then")
    return Counted("Stated causes", head, tuple(rows))


def _wrong(parameters: Sequence[list[Any]]) -> str:
    """The parameters that are furthest off among those that are not sound, and how many lack."""
    wrong = [(error_percent(row) or 0.0, row) for row in parameters if is_sound(row) is False]
    wrong.sort(key=lambda each: -abs(each[0]))
    said = [f"{row[0]} {row[1] or ''}".strip() + f" {error:+.2g} %" for error, row in wrong]
    more = len(said) - _WORST
    parts = said[:_WORST] + ([f"{more} more"] if more > 0 else [])
    missing = sum(row[3] is None for row in parameters)
    if missing:
        parts.append(f"{missing} not given")
    if not parameters:
        parts.append("all refused")
    return "; ".join(parts) or "none"
