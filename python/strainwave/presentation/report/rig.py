"""The constants of the rig that the study states: every result depends on them.

Predicted benefit of link sensors that the rig does not have.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

from strainwave.domain import ArmDescription, Identification, Joint, SensorGain
from strainwave.domain.kinds import kind_of
from strainwave.domain.link_sensors import all_types, key_texts
from strainwave.presentation.report.blocks import Block, Cell, Facts, Row, number, table

_NOT_GIVEN = "not given"
_MAX_ROUNDING = 1e-12  # of a coordinate or an angle that frames of fixed joints were merged into


def rig_constants(arm: ArmDescription) -> Iterator[Block]:
    """A table of the constants of each joint and its servo, then the constants of the arm."""
    joints = [f"joint {number}" for number in range(1, arm.n_joints + 1)]
    heads: Row = ("constant", *map(number, joints), "unit", "key in study.toml")
    yield from table("Rig constants", heads, _constant_rows(arm), heading=False)
    facts = tuple(_arm_facts(arm))
    if facts:
        yield Facts(facts)


def _constant_rows(arm: ArmDescription) -> Iterator[Row]:
    for constant in _joint_constants(arm):
        values = [constant.format(joint) for joint in arm.joints]
        if any(values):
            yield _constant_row(constant.title, constant.key, constant.unit, values)
    servo = arm.servo
    if servo is None:
        return
    gains = (
        ("servo, proportional gain", "kp", "V s/rad", servo.kp),
        ("servo, integral gain", "ki", "V/rad", servo.ki),
        ("servo, position gain", "position_gain", "1/s", servo.position_gain),
    )
    for title, key, unit, gain in gains:
        if gain is not None:
            yield _constant_row(title, f"servo.{key}", unit, [f"{value:g}" for value in gain])


class _JointConstant(NamedTuple):
    title: str
    key: str
    unit: str
    format: Callable[[Joint], str]  # empty if not given


def _joint_constants(arm: ArmDescription) -> Iterator[_JointConstant]:
    if not kind_of(arm).places_joints:
        yield _JointConstant("name", "name", "", lambda joint: joint.name or "")
        yield _JointConstant("position", "origin.xyz", "m", lambda one: _vector(one.origin.xyz))
        yield _JointConstant(
            "orientation", "origin.rpy", "rad", lambda one: _vector(one.origin.rpy)
        )
        yield _JointConstant("axis", "axis", "", lambda joint: _vector(joint.axis))
    is_prismatic = any(joint.motion == "prismatic" for joint in arm.joints)
    if is_prismatic:
        yield _JointConstant("motion", "motion", "", lambda joint: joint.motion)
    yield _JointConstant("gear spring", "spring", "", lambda joint: joint.spring)
    ratio = "link rad (or m) per motor rad" if is_prismatic else "link turns per motor turn"
    yield _JointConstant("gear ratio n", "gear_ratio", ratio, _format_ratio)
    for title, key, unit in (
        ("torque per volt e", "torque_per_volt", "N m/V"),
        ("current loop bandwidth", "current_loop_hz", "Hz"),
        ("motor encoder", "encoder_counts", "counts/turn"),
        *((title, key, unit) for key, (title, unit) in key_texts().items() if unit),
    ):
        yield _JointConstant(title, key, unit, partial(_format_constant, key))
    for title, key, unit in (("IMU position", "xyz", "m"), ("IMU orientation", "rpy", "rad")):
        yield _JointConstant(title, f"imu.{key}", unit, partial(_format_imu, key))


def _format_ratio(joint: Joint) -> str:
    """The gear ratio, and its inverse if that is close to an integer."""
    inverse = 1.0 / joint.gear_ratio
    is_round = abs(inverse - round(inverse)) < 1e-6 * abs(inverse) and abs(inverse) > 1.5
    return f"{joint.gear_ratio:.6g}" + (f" (1:{round(inverse)})" if is_round else "")


def _format_constant(key: str, joint: Joint) -> str:
    value = getattr(joint, key)
    return "" if value is None else f"{value:.6g}"


def _format_imu(key: str, joint: Joint) -> str:
    if joint.imu is None:
        return ""
    values = getattr(joint.imu, key)
    return "estimated" if values is None else _vector(values)


def _vector(values: Sequence[float]) -> str:
    return ", ".join(f"{value if abs(value) > _MAX_ROUNDING else 0.0:g}" for value in values)


def _constant_row(title: str, key: str, unit: str, values: Sequence[str]) -> Row:
    cells = (number(value or _NOT_GIVEN) for value in values)
    return (title, *cells, unit, Cell(key, "code"))


def _arm_facts(arm: ArmDescription) -> Iterator[tuple[str, str]]:
    if not kind_of(arm).places_joints:
        yield "gravity", f"{_vector(arm.gravity)} m/s²" if arm.gravity else "none"
        for number, row in enumerate(arm.coupling or (), start=1):
            yield f"transmission, weights of the motors in joint {number}", _vector(row)
    elif arm.n_joints > 1:
        length = math.hypot(*arm.joints[1].origin.xyz)
        yield "link length, axis 1 to axis 2", f"{length:g} m"
        gravity = f"{arm.gravity_size:g} m/s²" if arm.gravity else "none: horizontal motion"
        yield "gravity in the plane of motion", gravity
    if arm.servo is not None:
        yield "servo period", f"{1e3 * arm.servo.period:g} ms"
        yield "servo output limit", f"{arm.servo.limit:g} V"


_MAX_INTERVAL_RATIO = 2.0 / 3.0  # a sensor is worth a word if it shrinks an interval by a third
_MIN_HALF_WIDTH_PERCENT = 0.05  # narrower intervals need no sensor
_MAX_PARAMETERS = 2  # named for each sensor


def gain_sentences(identification: Identification) -> list[str]:
    """One clause for each kind of sensor, on the link where it helps most.

    Each names at most two parameters, those whose intervals shrink most in percent of the value.
    The list is empty if every link has a sensor or no sensor would help.
    """
    return list(_sentences(identification))


def _sentences(identification: Identification) -> Iterator[str]:
    published = {
        (d.parameter.name, d.parameter.joint)
        for d in identification.decisions
        if d.identified and d.parameter.stage == "tuned"
    }
    groups: dict[str, dict[int, list[SensorGain]]] = {}
    for gain in identification.whole_arm.sensor_gains if identification.whole_arm else ():
        helps = gain.predicted_std < _MAX_INTERVAL_RATIO * gain.std
        helps = helps and gain.percent > _MIN_HALF_WIDTH_PERCENT
        if helps and gain.key in published:
            groups.setdefault(gain.sensor, {}).setdefault(gain.link, []).append(gain)
    nouns = {kind.name.replace("_", "-"): kind.suggested_as for kind in all_types()}
    for sensor, by_link in groups.items():
        best = max(by_link.values(), key=lambda gains: max(map(_improvement, gains)))
        first, *others = sorted(best, key=_improvement, reverse=True)[:_MAX_PARAMETERS]
        text = f"{nouns[sensor]} on link {first.link} ({first.assumed}) would shrink the 95 %"
        text += f" half-width of {first.label} {_change(first)}"
        for other in others:
            text += f", and of {other.label} {_change(other)}"
        yield text


def _improvement(gain: SensorGain) -> float:
    """Reduction of the half-width [% of the value]."""
    return gain.percent - gain.predicted_percent


def _change(gain: SensorGain) -> str:
    return f"from {gain.percent:.2g} to {gain.predicted_percent:.2g} %"
