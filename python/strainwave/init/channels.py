"""Map columns to channels, with unit, reason and certainty: inputs, sensors, unused columns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.init.inspection import InspectedLog
from strainwave.init.joint_columns import (
    DEGREE,
    MIN_RELATED_CORRELATION,
    Guess,
    JointColumns,
    Mapping,
)
from strainwave.init.joints import assign_columns
from strainwave.init.names import AXIS, UNITS, names_accelerometer, parse
from strainwave.init.robot import Robot
from strainwave.init.signal_features import (
    flat_top,
    is_register,
    levels,
    relation,
    sign_bit,
)

_SCALE_REMEDY = (
    "the logs have commanded and measured angles and no torque: inertia, friction and gravity are"
    " ratios to the gain of each servo. For absolute values, set kp [N m/rad] of [servo], or log"
    " the same motion again with a known weight and add payload to its [[experiment]]"
)
_MIN_CORRELATION = 0.98  # of a column that measures the same as another
_MIN_TORQUE_SHARE = 0.05  # of the gravity of a stretched arm; 1:57 and slower gears have less
_IMU_AXIS = re.compile(r"[ag][xyz][1-9]")  # channel name of an IMU axis
_SENSORS = {  # channel and SI unit of each kind
    "acceleration": ("a", "m/s^2"),
    "gyro": ("gyro", "rad/s"),
    "deflection": ("deflection", "rad"),
}
_MAX_REVERSED_CORRELATION = -0.5  # correlation below which the sensor's sign is reversed
_MAX_DERIVATIVE_ERROR = 0.05  # relative, of the ratio of an acceleration to its velocity in SI
_MAX_LIMIT_RATIO = 5.0  # of a torque to the effort limit of a URDF, which is a continuous torque
# [kg m^2] standard deviations of torque over acceleration of arms; others have another unit
_INERTIAS = (1e-7, 1e4)
# quantity, and whether it is commanded: measured torques and currents precede commands
_INPUT_ORDER = (("torque", False), ("current", False), ("torque", True), ("voltage", False))


def map_channels(
    record: InspectedLog,
    fullest: InspectedLog,
    robot: Robot | None = None,
    others: Sequence[InspectedLog] = (),
) -> Mapping:
    """Guess the channels of a record; `fullest` is the record with the most columns.

    A joint that hardly moves in the record is classified by one of `others` in which it moves.
    Raises InvalidInput if the record has no angle of a joint of `robot`.
    """
    parsed_names, mapping = assign_columns(record, fullest, robot)
    n_joints = max((each.number or 1 for each in parsed_names.values()), default=1)
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
        _map_input(joint)
        _map_sensors(joint)
    _map_imus(record, mapping)
    if mapping.position_servos:
        mapping.warnings += (_SCALE_REMEDY,)
    if listed := ", ".join(repr(joint.sided_by_guess) for joint in joints if joint.sided_by_guess):
        mapping.warnings += (
            f"on which side of the gear is {listed} measured? The motor side is assumed; if it is a"
            ' sensor behind the gear, write { column = ..., meaning = "sensor" }',
        )
    used = mapping.columns
    for name in record.columns:
        if name not in used and name not in mapping.unused:
            mapping.unused[name] = _describe_unused(record, name, mapping)
    return mapping


def _describe_joints(joints: Sequence[JointColumns], robot: Robot, record: InspectedLog) -> None:
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
    motions = {j.number: (j.scaled_angle(), j.record.period) for j in joints}
    within = robot.are_within_limits(motions)
    if within is False and _are_degrees(joints, robot, motions):
        within = True
        for joint in joints:
            joint.degrees = f"in degrees, all angles stay within the limits of {robot.path.name}"
    for joint, urdf in zip(joints, robot.joints, strict=True):
        joint.facts.name, joint.facts.prismatic = urdf.name, urdf.motion == "prismatic"
        if within and not joint.facts.joint_side:
            joint.facts.joint_side = f"all angles stay within the limits of {robot.path.name}"
        joint.effort_limit = (urdf.limits and urdf.limits.effort) or np.inf
        joint.exceeded = "" if within is not False else robot.path.name
    warnings = [f"{name!r} is not used: {joints[0].mapping.unused[name]}" for name in unassigned]
    if within is False and any(joint.facts.joint_side for joint in joints):
        warnings.append(
            f"angles of {record.path.name} exceed the limits of {robot.path.name}: check that both "
            "belong to the same robot, and the unit"
        )
    joints[0].mapping.warnings = tuple(warnings)


def _are_degrees(
    joints: Sequence[JointColumns], robot: Robot, motions: dict[int, tuple[FloatArray, float]]
) -> bool:
    """Whether angles beyond the limits are degrees of the joints, not radians of the motors.

    Behind a gear, the torques are those of the joint divided by the ratio as well.
    """
    degrees = {n: (DEGREE * angle, period) for n, (angle, period) in motions.items()}
    if not robot.are_within_limits(degrees):
        return False
    torque = sum(joint.largest_torque() for joint in joints)
    return torque > _MIN_TORQUE_SHARE * sum(robot.gravity_bounds())


def _map_input(joint: JointColumns) -> None:
    """Map the input of the drive, and the torque that a sensor measures behind the gear."""
    names, unused = joint.parsed_names, joint.mapping.unused
    topic = (joint.angle or "").partition(".")[0] if (joint.angle or "").startswith("/") else " "

    def order(column: str) -> tuple[int, bool, bool, bool]:
        """Channel names, then by quantity; the angle's topic, the motor, no unknown words first."""
        each = names[column]
        key = each.quantity or "", each.role == "desired" and each.quantity != "voltage"
        rank = _INPUT_ORDER.index(key) if key in _INPUT_ORDER else len(_INPUT_ORDER)
        if column in (f"torque{joint.number}", f"u{joint.number}"):
            rank = -1
        if each.quantity != "torque":
            return rank, False, False, False
        is_elsewhere = not column.startswith(f"{topic}.")
        return rank, is_elsewhere, each.side != "motor", bool(each.rest)

    columns = sorted(
        (n for q in ("torque", "current", "voltage") for n in joint.columns_of(q)), key=order
    )
    sensors = [n for n in columns if names[n].quantity == "torque" and names[n].side == "link"]
    if sensors and len(sensors) < len(columns):
        reason = f"{joint.evidence(sensors[0])}, of the link"
        joint.add("tau_l", sensors[0], reason, assumed="N m")
        joint.facts.link_sensors.add("tau_l")
        columns.remove(sensors[0])
    for column in columns[1:]:
        unused[column] = (
            f"a {names[column].quantity} according to its name; {columns[0]!r} is used. If both"
            " act: see `add` in docs/study.md"
        )
    if columns:
        _add_input(joint, columns[0])
    elif joint.facts.position_servo:
        return
    elif joint.facts.joint_side:
        description = "the torque [N m at the joint]; for a voltage, map u instead"
        joint.mapping.missing[f"torque{joint.number}"] = description
    else:
        description = "the drive voltage [V]; for a torque, map torque instead"
        joint.mapping.missing[f"u{joint.number}"] = description


def _add_input(joint: JointColumns, column: str) -> None:
    each, values = joint.parsed_names[column], joint.values(column)
    is_current, is_command = each.quantity == "current", each.role == "desired"
    channel = "u" if each.quantity == "voltage" or (is_current and is_command) else "torque"
    scale, todo = each.scale_or(1.0), each.todo
    if each.unit is None:
        if is_current:
            scale, todo = None, "torque constant [N m/A] at the motor; times 1e-3 for mA"
        elif each.word in ("pwm", "duty", "duty_cycle"):
            scale, todo = None, "volts at full duty"
        elif column != f"{channel}{joint.number}" and (
            doubt := next(_doubts_of_input(joint, column), "")
        ):
            scale, todo = None, f"{doubt}; {'volts' if channel == 'u' else 'N m'} per unit"
    bit = sign_bit(values)
    if bit is not None:
        scale, todo = None, f"bit {bit} of the register is the sign: decode it; then {todo}"
    if is_current and channel == "u":
        scale = UNITS["current"].get(each.unit or "a")
        todo = "torque_per_volt is the torque constant [N m/A]" if scale else todo
    shape, meaning, assumed = "", "", ""
    input_levels, limit = levels(values), flat_top(values)
    if input_levels is not None and len(input_levels) > 1:
        shape = f"it has {len(input_levels)} levels"
    elif input_levels is None and limit is not None:
        shape = f"it repeatedly stays at {limit:.4g}: the limit of the drive?"
    if is_command:
        meaning = "commanded, not measured"
        joint.facts.command = "A" if is_current else "V"
    elif each.quantity == "torque" and each.side is None:
        meaning = 'if a sensor behind the gear measures it, add meaning = "sensor"'
    elif each.side == "link":
        meaning = "a sensor behind the gear measures it"
    if each.unit is None and scale is not None and not is_current:
        side = "joint" if joint.facts.joint_side else "motor"
        assumed = f"assumed unit {'V' if channel == 'u' else f'N m at the {side}'}"
    joint.facts.voltage = channel == "u"
    reasons = (joint.evidence(column), shape, assumed, meaning)
    joint.add(channel, column, *reasons, unit=(scale, todo))


def _doubts_of_input(joint: JointColumns, column: str) -> Iterator[str]:
    """Yield why a torque or a voltage without a unit cannot be in SI units."""
    values, record = joint.values(column), joint.record
    largest = np.abs(values).max()
    if is_register(values):
        yield "whole numbers, as of a register"
    if not joint.parsed_names[column].word:
        yield "an input by its data alone"
    if largest > _MAX_LIMIT_RATIO * joint.effort_limit:
        yield f"up to {largest:.4g}, and the URDF allows {joint.effort_limit:.4g} N m"
    if joint.parsed_names[column].quantity != "torque" or joint.angle is None:
        return
    angle = joint.scaled_angle()
    if not angle.any():
        yield "the unit of the angle is open, so that its size proves nothing"
    velocity = np.gradient(angle, record.time)
    width = max(1, round(0.02 / record.period))
    spread = float(np.std((velocity[width:] - velocity[:-width]) / (width * record.period)))
    inertia = float(np.std(values)) / spread if spread > 0.0 else 0.0
    if inertia and not _INERTIAS[0] < inertia < _INERTIAS[1]:
        yield f"an inertia of {inertia:.1g} kg m^2 would follow"


def _map_sensors(joint: JointColumns) -> None:
    """Map the temperature, and of each kind of sensor the axis most like the motor's motion."""
    for column in joint.columns_of("temperature")[:1]:
        reason = f"{joint.evidence(column)}, never fitted"
        joint.add("temperature", column, reason, unit=(1.0, ""), assumed="degC", sure="likely")
    for quantity, (channel, unit) in _SENSORS.items():
        n_columns, correlations = len(joint.columns_of(quantity)), dict[str, float]()
        for name in joint.columns_of(quantity):
            if np.ptp(joint.values(name)) > 0.0 and not _is_joint_acceleration(joint, name):
                correlations[name] = _motion_correlation(joint, name, quantity)
        axes = {name: match[0].lower() for name in correlations if (match := AXIS.search(name))}
        if (
            joint.has_spatial_links
            and quantity != "deflection"
            and correlations
            and len(set(axes.values())) == len(correlations)
        ):
            for name, axis in axes.items():
                reason = f"{joint.evidence(name)}; axis {axis} of an IMU"
                joint.add(f"{quantity[0]}{axis}", name, reason, assumed=unit)
            joint.facts.link_sensors.add("imu")
            continue
        for name in sorted(correlations, key=lambda name: -abs(correlations[name])):
            if channel in joint.facts.link_sensors:
                joint.mapping.unused[name] = "another axis of the same sensor"
                continue
            each, r, choice, sign = joint.parsed_names[name], correlations[name], "", ""
            scale = each.scale_or(1.0)
            if n_columns > 1:
                choice = f"of {n_columns} columns the one that correlates with the motor"
                choice += f" (r = {r:.2f})"
            if r < _MAX_REVERSED_CORRELATION and scale is not None:
                scale, sign = -scale, "it points the other way, so the sign is turned"
            reasons = (joint.evidence(name), choice, sign)
            joint.add(channel, name, *reasons, unit=(scale, each.todo), assumed=unit)
            joint.facts.link_sensors.add(channel)


def _is_joint_acceleration(joint: JointColumns, column: str) -> bool:
    """Whether a column without a word of a sensor is the joint's acceleration in SI units."""
    each, motor = joint.parsed_names[column], joint.angle
    guess = joint.mapping.guesses.get(f"theta_m{joint.number}")
    is_sensor = (
        each.side == "link" or AXIS.search(column) is not None or names_accelerometer(each.word)
    )
    if each.quantity != "acceleration" or is_sensor or motor is None or guess is None:
        return False
    if guess.scale is None or joint.facts.prismatic or not joint.is_derivative(column, motor):
        return False
    velocity = np.gradient(guess.scale * joint.values(motor), joint.record.time)
    scaled = (each.scale_or(1.0) or 1.0) * joint.values(column)
    if abs(relation(scaled, velocity, joint.record.time)[1] - 1.0) > _MAX_DERIVATIVE_ERROR:
        return False
    joint.mapping.unused[column] = f"it is the derivative of the velocity of {motor!r}"
    return True


def _motion_correlation(joint: JointColumns, column: str, quantity: str) -> float:
    """Correlation with the motor's acceleration or velocity; 0 if that is unknown."""
    if joint.angle is None or quantity == "deflection":
        return 0.0
    angle, values, time = joint.values(joint.angle), joint.values(column), joint.record.time
    motion = np.gradient(angle, time) if quantity == "acceleration" else angle
    return relation(values - values.mean(), motion, time)[0]


def _map_imus(record: InspectedLog, mapping: Mapping) -> None:
    """Map IMU axes only by their channel names: the data do not determine the frame of an axis."""
    used = mapping.columns
    for name, values in record.columns.items():
        number = int(name[2]) if _IMU_AXIS.fullmatch(name) else 0
        if 0 < number <= len(mapping.joints) and name not in used and np.ptp(values) > 0.0:
            mapping.guesses[name] = Guess(
                name, name, "an axis of an IMU, according to its name", "sure"
            )
            mapping.joints[number - 1].link_sensors.add("imu")


def add_channels(
    mapping: Mapping, record: InspectedLog, fullest: InspectedLog, robot: Robot | None = None
) -> None:
    """Add the channels whose columns are only in `record`, not in `fullest`.

    Updates the channels, joint properties and unused columns of `mapping`, which belongs to
    `fullest`. `record` must have all motor angles of `fullest`.
    """
    known = {*fullest.columns, *mapping.unused, *mapping.columns}
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
    used = mapping.columns
    for column, reason in extra.unused.items():
        if column not in known | used:
            mapping.unused[column] = reason
    for column in record.columns:
        if column not in known | used | set(mapping.unused):
            mapping.unused[column] = f"another column of {fullest.path.name} has this channel"


def _describe_unused(record: InspectedLog, name: str, mapping: Mapping) -> str:
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
