"""The rig: constants that the study states, benefit of further link sensors, picture of the arm."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from strainwave.domain import ArmDescription, FloatArray, Identification, Joint, SensorGain
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.link_sensors import all_types, key_texts
from strainwave.domain.arm.link_sensors.link_space import attitude, axes_about
from strainwave.report import figures
from strainwave.report.document import blocks
from strainwave.report.document.blocks import Block, Cell, Facts, Row
from strainwave.report.figures import Axis, Colour, Figure, Line, Mark, Markers, Panel

_NOT_GIVEN = "not given"
_MAX_ROUNDING = 1e-12  # of a coordinate or an angle that frames of fixed joints were merged into


def rig_constants(arm: ArmDescription) -> Iterator[Block]:
    """A table of the constants of each joint and its servo, then the constants of the arm."""
    joints = [f"joint {number}" for number in range(1, arm.n_joints + 1)]
    heads: Row = ("constant", *map(blocks.number, joints), "unit", "key in study.toml")
    rows: list[Row] = [
        (title, *(blocks.number(value or _NOT_GIVEN) for value in values), unit, Cell(key, "code"))
        for title, key, unit, values in _constants(arm)
        if any(values)
    ]
    yield from blocks.table("Rig constants", heads, rows, heading=False)
    if facts := tuple(_arm_facts(arm)):
        yield Facts(facts)


def _constants(arm: ArmDescription) -> Iterator[tuple[str, str, str, list[str]]]:
    """Title, key, unit, and the text of the value of each joint, empty if not given."""
    joints = arm.joints
    if not kind_of(arm).places_joints:
        yield "name", "name", "", [joint.name or "" for joint in joints]
        yield "position", "origin.xyz", "m", [_vector(joint.origin.xyz) for joint in joints]
        yield "orientation", "origin.rpy", "rad", [_vector(joint.origin.rpy) for joint in joints]
        yield "axis", "axis", "", [_vector(joint.axis) for joint in joints]
    is_prismatic = any(joint.motion == "prismatic" for joint in joints)
    if is_prismatic:
        yield "motion", "motion", "", [joint.motion for joint in joints]
    yield "gear spring", "spring", "", [joint.spring for joint in joints]
    ratio = "link rad (or m) per motor rad" if is_prismatic else "link turns per motor turn"
    yield "gear ratio n", "gear_ratio", ratio, [_format_ratio(joint.gear_ratio) for joint in joints]
    for title, key, unit in (
        ("torque per volt e", "torque_per_volt", "N m/V"),
        ("current loop bandwidth", "current_loop_hz", "Hz"),
        ("motor encoder", "encoder_counts", "counts/turn"),
        *((title, key, unit) for key, (title, unit) in key_texts().items() if unit),
    ):
        numbers = [getattr(joint, key) for joint in joints]
        yield title, key, unit, ["" if value is None else f"{value:.6g}" for value in numbers]
    for title, key, unit in (("IMU position", "xyz", "m"), ("IMU orientation", "rpy", "rad")):
        vectors = [getattr(joint.imu, key, ()) for joint in joints]
        texts = ["estimated" if vector is None else _vector(vector) for vector in vectors]
        yield title, f"imu.{key}", unit, texts
    if arm.servo is None:
        return
    for title, key, unit in (
        ("servo, proportional gain", "kp", "V s/rad"),
        ("servo, integral gain", "ki", "V/rad"),
        ("servo, position gain", "position_gain", "1/s"),
    ):
        gains = getattr(arm.servo, key)
        if gains is not None:
            yield title, f"servo.{key}", unit, [f"{gain:g}" for gain in gains]


def _format_ratio(ratio: float) -> str:
    """The gear ratio, and its inverse if that is close to an integer."""
    inverse = 1.0 / ratio
    is_round = abs(inverse - round(inverse)) < 1e-6 * abs(inverse) and abs(inverse) > 1.5
    return f"{ratio:.6g}" + (f" (1:{round(inverse)})" if is_round else "")


def _vector(values: Sequence[float]) -> str:
    return ", ".join(f"{value if abs(value) > _MAX_ROUNDING else 0.0:g}" for value in values)


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
    published = {
        d.parameter.key
        for d in identification.decisions
        if d.identified and d.parameter.stage == "tuned"
    }
    groups: dict[str, dict[int, list[SensorGain]]] = {}
    for gain in identification.whole_arm.sensor_gains if identification.whole_arm else ():
        helps = gain.predicted_std < _MAX_INTERVAL_RATIO * gain.std
        helps = helps and gain.percent > _MIN_HALF_WIDTH_PERCENT
        if helps and gain.key in published:
            groups.setdefault(gain.sensor, {}).setdefault(gain.link, []).append(gain)
    sentences = []
    nouns = {kind.name.replace("_", "-"): kind.suggested_as for kind in all_types()}
    for sensor, by_link in groups.items():
        best = max(by_link.values(), key=lambda gains: max(map(_improvement, gains)))
        first, *others = sorted(best, key=_improvement, reverse=True)[:_MAX_PARAMETERS]
        text = f"{nouns[sensor]} on link {first.link} ({first.assumed}) would shrink the 95 %"
        changes = (
            f"of {gain.label} from {gain.percent:.2g} to {gain.predicted_percent:.2g} %"
            for gain in (first, *others)
        )
        sentences.append(f"{text} half-width {', and '.join(changes)}")
    return sentences


def _improvement(gain: SensorGain) -> float:
    """Reduction of the half-width [% of the value]."""
    return gain.percent - gain.predicted_percent


_AZIMUTH, _ELEVATION = math.radians(-60.0), math.radians(25.0)  # of the eye, about the base
_FROM_ABOVE = np.eye(3)[:2]  # the plane of motion of a planar arm
_OBLIQUE = np.array(  # to the right and up in the view
    [
        [-math.sin(_AZIMUTH), math.cos(_AZIMUTH), 0.0],
        [
            -math.sin(_ELEVATION) * math.cos(_AZIMUTH),
            -math.sin(_ELEVATION) * math.sin(_AZIMUTH),
            math.cos(_ELEVATION),
        ],
    ]
)
_AXIS_SHARE = 0.09  # half-length of a drawn axis over the size of the arm
_ARROW_SHARE = 0.2  # length of the base's axes and of gravity over the size of the arm
_END_SHARE = 0.6  # length of a planar arm's last link, if no sensor is on it, over the size
_SAME_PLACE = 1e-3  # distance of joints with one label over the size of the arm
_HEIGHT = 2.0  # of the figure, in panels
_JOINT_SIZE, _SENSOR_SIZE = 9.0, 7.0  # [px]


def arm_picture(arm: ArmDescription) -> Figure:
    """The arm at zero angles: joints, axes, and sensors at known places on the links.

    Planar arms are seen along their axes; others in parallel projection, from the front right and
    above. The first mark is the links, then there is one for the axis of each joint, in order.
    """
    is_planar = kind_of(arm).places_joints
    view = _FROM_ABOVE if is_planar else _OBLIQUE

    def line(points: Sequence[FloatArray], name: str, colour: str, **style: Any) -> Line:
        x, y = view @ np.transpose(points)
        return Line(x, y, name, colour, **{"width": 3.0} | style)

    turn, place = np.eye(3), np.zeros(3)
    origins, axes = list[FloatArray](), list[FloatArray]()
    sensors: list[tuple[str, FloatArray]] = []
    for number, joint in enumerate(arm.joints, start=1):  # in the frame of the base
        place = place + turn @ joint.origin.xyz
        turn = turn @ attitude(joint.origin.rpy)
        origins.append(place)
        axes.append(turn @ joint.axis / np.linalg.norm(joint.axis))
        for label, position in _sensor_positions(joint):
            sensors.append((f"{label}{number}", place + turn @ position))
    base = np.zeros(3)
    reach = [float(np.linalg.norm(each)) for each in (*origins, *(at for _, at in sensors))]
    size = max(reach) or 1.0
    marks: list[Mark] = [line([base, *origins], "links", Colour.RESIDUAL, width=5.0)]
    for joint, origin, axis in zip(arm.joints, origins, axes, strict=True):
        name, colour, dash = "axes of revolute joints", Colour.MEASURED, figures.SOLID
        if joint.motion == "prismatic":
            name, colour, dash = "direction of prismatic joints", Colour.TUNED, figures.SHORT_DASH
        half, is_seen = size * _AXIS_SHARE * axis, bool(np.any(view @ axis))
        marks.append(line([origin - half, origin + half], name, colour, dash=dash, legend=is_seen))
    if is_planar:  # its links lie along +x
        on_last = [float(position[0]) for _, position in _sensor_positions(arm.joints[-1])]
        length = max([0.0, *on_last]) or _END_SHARE * size
        end = [place, place + np.array([length, 0.0, 0.0])]
        name = "last link, whose length is not given"
        marks.append(line(end, name, Colour.RESIDUAL, dash=figures.SHORT_DASH))
    arrows = {("frame of the base", Colour.LINEAR): dict(zip("xyz", np.eye(3), strict=True))}
    if arm.gravity and arm.gravity_size:
        arrows["gravity", Colour.MODEL] = {"g": np.array(arm.gravity) / arm.gravity_size}
    for (name, colour), directions in arrows.items():
        labels = tuple(label for label, each in directions.items() if np.any(view @ each))
        tips = [size * _ARROW_SHARE * directions[label] for label in labels]
        marks += [line([base, tip], name, colour, width=1.5) for tip in tips]
        x, y = view @ np.transpose(tips)
        marks.append(Markers(x, y, name, colour, 3.0, labels=labels))
    if sensors:
        x, y = view @ np.transpose([at for _, at in sensors])
        names = tuple(name for name, _ in sensors)
        style: Any = {"labels": names, "is_above": False}
        marks.append(Markers(x, y, "sensors", Colour.AMBER, _SENSOR_SIZE, **style))
    places, names = _joint_places(origins, arm.joint_names, _SAME_PLACE * size)
    x, y = view @ np.transpose(places)
    marks.append(Markers(x, y, "joints", Colour.MEASURED, _JOINT_SIZE, labels=names))
    right, up = ("x", "y") if is_planar else ("to the right in the view", "up in the view")
    panel = Panel(Axis(f"{up} [m]"), tuple(marks), _HEIGHT)
    return Figure(Axis(f"{right} [m]"), (panel,), has_equal_scales=True)


def _joint_places(
    origins: Sequence[FloatArray], names: Sequence[str], distance: float
) -> tuple[list[FloatArray], tuple[str, ...]]:
    """Places of joints, each with the names of all joints within a distance."""
    joints: list[tuple[FloatArray, list[str]]] = []
    for origin, name in zip(origins, names, strict=True):
        near = [others for at, others in joints if np.linalg.norm(at - origin) < distance]
        if near:
            near[0].append(name)
        else:
            joints.append((origin, [name]))
    return [at for at, _ in joints], tuple(", ".join(others) for _, others in joints)


def _sensor_positions(joint: Joint) -> Iterator[tuple[str, FloatArray]]:
    """Sensors at given places in the frame of the joint's link, with kinds as in channels."""
    if joint.accelerometer_distance and joint.motion == "revolute":
        yield "a", joint.accelerometer_distance * axes_about(joint.axis)[0]
    if joint.imu is not None and joint.imu.xyz is not None:
        yield "imu", np.array(joint.imu.xyz)


def describe_arm(arm: ArmDescription) -> str:
    """Caption of the picture."""
    joints, them = (f"{arm.n_joints} joints", "them") if arm.n_joints > 1 else ("joint", "it")
    placer = "and its URDF place" if arm.urdf else "places"
    return (
        f"The {joints} at zero angles, as the study {placer} {them}. The length of the last link is"
        " not given."
    )
