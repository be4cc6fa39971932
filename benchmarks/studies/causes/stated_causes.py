"""Causes of typical sizes, each on one arm, without and with `effects = "auto"`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from benchmarks.families.causes import Cause, slower
from benchmarks.studies.causes.evaluation import Engine, error_percent, evaluate, is_accurate
from benchmarks.studies.causes.runs import Run, draw_run
from benchmarks.studies.causes.tables import TextTable

Sizes = Mapping[str, float]
_MAX_DRAWS = 60
_MAX_LISTED = 3  # parameters per row


@dataclass(frozen=True, slots=True)
class Stated:
    """A cause of a given size and the kind of its arm."""

    text: str
    name: str
    joint: int
    sizes: Callable[[Run], Sizes]
    gravity: Literal["horizontal", "upright"] = "horizontal"
    spring: Literal["linear", "three-slope"] = "linear"

    def run(self, series: int) -> Run:
        """The first drawn arm of that kind, with this cause; another series draws other arms."""
        for number in range(_MAX_DRAWS):
            run = draw_run(self.name, number, series)
            spring = run.rig.study.arm.joints[0].spring
            if (run.rig.classes["gravity"], spring) == (self.gravity, self.spring):
                return Run(run.rig, Cause(self.name, self.joint, self.sizes(run)), number)
        raise LookupError(f"no {self.gravity} arm with {self.spring} gears was drawn")


def _fixed(**sizes: float) -> Callable[[Run], Sizes]:
    return lambda run: sizes


def _voltage_limit(run: Run) -> float:
    servo = run.rig.study.arm.servo
    return servo.limit if servo else 10.0


def _by_record(first: float, last: float) -> Callable[[Run], Sizes]:
    """Factors that change linearly over the records."""

    def sizes(run: Run) -> Sizes:
        n = len(run.rig.study.experiments)
        return {f"factor_{k}": first + (last - first) * k / (n - 1) for k in range(n)}

    return sizes


def _share_of_friction(share: float, name: str, **others: float) -> Callable[[Run], Sizes]:
    """A torque as a share of the Coulomb friction of joint 1."""
    return lambda run: {name: share * run.rig.values["motor_coulomb_friction", 1], **others}


STATED: Sequence[Stated] = (
    Stated(
        "torque constant falls 10 % at full voltage",
        "drive-saturation",
        1,
        lambda run: {"drive_saturation": 0.1 / _voltage_limit(run)},
    ),
    Stated(
        "amplifier gain drifts by 4 % through the records",
        "drive-gain-by-record",
        1,
        _by_record(0.98, 1.02),
    ),
    Stated("torque constant of joint 2 10 % off", "drive-gain", 2, _fixed(gain=1.1)),
    Stated(
        "link 1 flexible",
        "flexible-link",
        1,
        _fixed(stiffness=6.0, damping_ratio=0.01),
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
    Stated("backlash of 0.2 mrad", "backlash", 1, _fixed(backlash=1e-4), spring="three-slope"),
    Stated(
        "cable drag, 2 N m/rad to ground",
        "ground-spring",
        2,
        _fixed(ground_stiffness=2.0, ground_preload=0.0),
        gravity="upright",
    ),
    Stated(
        "encoder zero of joint 2 off by 10 degrees",
        "encoder-zero",
        2,
        _fixed(angle=math.radians(10.0)),
        gravity="upright",
    ),
    Stated(
        "table tilted by 5 degrees",
        "tilt",
        1,
        _fixed(angle=math.radians(5.0), azimuth=0.8),
        spring="three-slope",
    ),
    Stated("friction grows with the gear's torque", "load-friction", 1, _fixed(load_friction=0.1)),
    Stated(
        "friction grows with the root of speed",
        "power-friction",
        1,
        _share_of_friction(0.3, "power_friction", power_exponent=0.5),
    ),
    Stated(
        "friction falls by 30 % while grease warms",
        "friction-by-record",
        1,
        _by_record(1.15, 0.85),
    ),
    Stated("amplifier dead zone of 0.2 V", "dead-zone", 1, _fixed(dead_zone=0.2)),
    Stated(
        "amplifier clips at 8 of 10 V",
        "drive-limit",
        1,
        lambda run: {"drive_limit": 0.8 * _voltage_limit(run), "drive_limit_loss": 1.0},
    ),
    Stated(
        "current loop of 100 Hz, not 1000 Hz",
        "drive-lag",
        1,
        lambda run: slower(100.0, run.rig.study, 1),
    ),
    Stated(
        "accelerometer 1 resonates on its mount at 90 Hz",
        "sensor-mount",
        1,
        _fixed(frequency=90.0, damping_ratio=0.03),
    ),
)


def evaluate_stated(index: int, *, engine: Engine, series: int) -> dict[str, Any]:
    """Evaluate one of `STATED`; a failure is returned as a result."""
    stated = STATED[index]
    head = {"seed": index, "text": stated.text, "cause": stated.name}
    try:
        run = stated.run(series)
        result = evaluate(run, engine=engine, series=series, with_effect=False, auto=True)
    except Exception as failure:  # counted, so that the other causes run
        return {**head, "number": 0, "failure": f"{type(failure).__name__}: {failure}"}
    return {**head, **result}


def stated_table(results: Sequence[dict[str, Any]]) -> TextTable:
    """Wrong values, named effect, effects included by "auto", and values that are wrong then."""
    rows = []
    for result in results:
        named = result["plain"]["named"]
        text = "nothing" if named is None else f"{named[0]} of joint {named[1]}"
        if result["plain"].get("suspected"):
            text = ", ".join(result["plain"]["suspected"])
        included = ", ".join(f"{name} {joint}" for name, joint in result["auto"].get("effects", []))
        plain, auto = (_wrong_values(result[fit]["parameters"]) for fit in ("plain", "auto"))
        rows.append((result["text"], plain, text, included or "nothing", auto))
    head = ("in the plant", "wrong if ignored", "named", 'included by "auto"', "wrong then")
    return TextTable("Causes of typical size", head, tuple(rows))


def _wrong_values(parameters: Sequence[list[Any]]) -> str:
    """The inaccurate values with the largest errors, and the number of values not identified."""
    wrong = [(error_percent(row) or 0.0, row) for row in parameters if is_accurate(row) is False]
    wrong.sort(key=lambda pair: -abs(pair[0]))
    texts = [f"{row[0]} {row[1] or ''}".strip() + f" {error:+.2g} %" for error, row in wrong]
    n_more = len(texts) - _MAX_LISTED
    parts = texts[:_MAX_LISTED] + ([f"{n_more} more"] if n_more > 0 else [])
    missing = sum(row[3] is None for row in parameters)
    if missing:
        parts.append(f"{missing} not identified")
    if not parameters:
        parts.append("all refused")
    return "; ".join(parts) or "none"
