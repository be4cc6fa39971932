"""Map columns to channels, with unit, reason and certainty."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from strainwave.errors import InvalidInput
from strainwave.study_draft.inspection import Record
from strainwave.study_draft.joint_columns import (
    DEGREE,
    MIN_RELATED_CORRELATION,
    Guess,
    JointColumns,
    Mapping,
)
from strainwave.study_draft.joint_signals import map_input, map_sensors
from strainwave.study_draft.joints import assign_columns
from strainwave.study_draft.names import parse
from strainwave.study_draft.robot import Motion, Robot

_MIN_CORRELATION = 0.98  # of a column that measures the same as another
_MIN_TORQUE_SHARE = 0.05  # of the gravity of a stretched arm; 1:57 and slower gears have less
_IMU_AXIS = re.compile(r"[ag][xyz][1-9]")  # channel name of an IMU axis


def map_channels(
    record: Record, fullest: Record, robot: Robot | None = None, others: Sequence[Record] = ()
) -> Mapping:
    """Guess the channels of a record; `fullest` is the record with the most columns.

    A joint that hardly moves in the record is classified by one of `others` in which it moves.
    Raises InvalidInput if the record has no angle of a joint of `robot`.
    """
    assigned = assign_columns(record, fullest, robot)
    parsed_names = assigned.columns
    n_joints = max((each.number or 1 for each in parsed_names.values()), default=1)
    mapping = Mapping(limit=assigned.limit, notes=assigned.notes, unused=dict(assigned.unused))
    if robot is not None:
        n_joints, mapping.urdf, mapping.held = len(robot.joints), robot.path, robot.held
    joints = [
        JointColumns(
            record,
            {name: each for name, each in parsed_names.items() if (each.number or 1) == joint},
            joint,
            mapping,
            has_spatial_links=robot is not None or n_joints > 2,
        )
        for joint in range(1, n_joints + 1)
    ]
    for each in joints:
        each.choose_record(others)
    if robot is not None:
        _describe_joints(joints, robot, record)
    for joint in joints:
        joint.map_motion()
        map_input(joint)
        map_sensors(joint)
    _map_imus(record, mapping)
    if listed := ", ".join(repr(joint.sided_by_guess) for joint in joints if joint.sided_by_guess):
        mapping.warnings += (
            f"on which side of the gear is {listed} measured? The motor side is assumed; if it is a"
            ' sensor behind the gear, write { column = ..., meaning = "sensor" }',
        )
    used = {guess.column for guess in mapping.guesses.values()}
    for name in record.columns:
        if name not in used and name not in mapping.unused:
            mapping.unused[name] = _describe_unused(record, name, mapping)
    return mapping


def _describe_joints(joints: Sequence[JointColumns], robot: Robot, record: Record) -> None:
    """Set what the URDF states about the joints, and on which side of the gears they are logged."""
    unassigned = [n for n in joints[0].mapping.unused if parse(n).quantity == "angle"]
    missing = [
        repr(urdf.name)
        for joint, urdf in zip(joints, robot.joints, strict=True)
        if joint.angle is None
    ]
    if missing:
        angles = unassigned or [n for n in record.columns if parse(n).quantity == "angle"]
        columns = ", ".join(angles or record.columns)
        raise InvalidInput(
            f"no column is the angle of the joint {', '.join(missing)}; the columns are {columns}",
            where=str(record.path),
            remedy=f"log all {len(joints)} joints that move in {robot.path.name}, and name columns "
            "by joint names or numbers, such as theta_m1; if a joint stands still in all logs, set "
            'its type to "fixed" in the URDF',
        )
    motions = [Motion(j.number, j.scaled_angle(), j.record.period) for j in joints]
    within = robot.are_within_limits(motions)
    if within is False and _are_degrees(joints, robot, motions):
        within = True
        for joint in joints:
            joint.degrees = f"in degrees, all angles stay within the limits of {robot.path.name}"
    for joint, urdf in zip(joints, robot.joints, strict=True):
        joint.facts.name, joint.facts.prismatic = urdf.name, urdf.motion == "prismatic"
        if within and not joint.facts.joint_side:
            joint.facts.joint_side = f"all angles stay within the limits of {robot.path.name}"
        limits = urdf.limits
        joint.effort_limit = limits.effort if limits and limits.effort else np.inf
        joint.exceeded = "" if within is not False else robot.path.name
    warnings = [f"{name!r} is not used: {joints[0].mapping.unused[name]}" for name in unassigned]
    if within is False and any(joint.facts.joint_side for joint in joints):
        warnings.append(
            f"angles of {record.path.name} exceed the limits of {robot.path.name}: check that both "
            "belong to the same robot, and the unit"
        )
    joints[0].mapping.warnings = tuple(warnings)


def _are_degrees(joints: Sequence[JointColumns], robot: Robot, motions: Sequence[Motion]) -> bool:
    """Whether angles beyond the limits are degrees of the joints, not radians of the motors.

    Behind a gear, the torques are those of the joint divided by the ratio as well.
    """
    degrees = [Motion(n, DEGREE * angle, period) for n, angle, period in motions]
    if not robot.are_within_limits(degrees):
        return False
    torque = sum(joint.largest_torque() for joint in joints)
    return torque > _MIN_TORQUE_SHARE * sum(robot.gravity_bounds())


def _map_imus(record: Record, mapping: Mapping) -> None:
    """Map IMU axes only by their channel names: the data do not determine the frame of an axis."""
    used = {guess.column for guess in mapping.guesses.values()}
    for name, values in record.columns.items():
        number = int(name[2]) if _IMU_AXIS.fullmatch(name) else 0
        if 0 < number <= len(mapping.joints) and name not in used and np.ptp(values) > 0.0:
            mapping.guesses[name] = Guess(
                name, name, "an axis of an IMU, according to its name", "sure"
            )
            mapping.joints[number - 1].link_sensors.add("imu")


def add_channels(
    mapping: Mapping, record: Record, fullest: Record, robot: Robot | None = None
) -> None:
    """Add the channels whose columns are only in `record`, not in `fullest`.

    Updates the channels, joint properties and unused columns of `mapping`, which belongs to
    `fullest`. `record` must have all motor angles of `fullest`.
    """
    known = {*fullest.columns, *mapping.unused, *(g.column for g in mapping.guesses.values())}
    if known.issuperset(record.columns):
        return
    extra = map_channels(record, fullest, robot)
    for channel, guess in extra.guesses.items():
        if channel not in mapping.guesses and guess.column not in known:
            mapping.guesses[channel] = guess
            mapping.missing.pop(channel, None)
    for joint_facts, extra_facts in zip(mapping.joints, extra.joints, strict=False):
        joint_facts.link_sensors |= extra_facts.link_sensors
        joint_facts.gear_ratio = joint_facts.gear_ratio or extra_facts.gear_ratio
    used = {guess.column for guess in mapping.guesses.values()}
    for column, reason in extra.unused.items():
        if column not in known | used:
            mapping.unused[column] = reason
    for column in record.columns:
        if column not in known | used | set(mapping.unused):
            mapping.unused[column] = f"another column of {fullest.path.name} has this channel"


def _describe_unused(record: Record, name: str, mapping: Mapping) -> str:
    """Describe a column that has no channel."""
    if np.ptp(record.columns[name]) == 0.0:
        return "it never changes"
    for guess in mapping.guesses.values():
        other = guess.column
        if other not in record.columns:
            continue
        r, ratio = record.proportion(other, name)
        if r > _MIN_CORRELATION:
            return f"it correlates with {other!r} (r = {r:.3f}, factor {ratio:.4g})"
        is_angle = guess.channel.startswith("theta_m")
        if is_angle and record.relation(name, other)[0] > MIN_RELATED_CORRELATION:
            return f"its integral correlates with {other!r}: a velocity or its reference?"
    return "not recognised"
