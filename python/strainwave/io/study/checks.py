"""Checks of a study beyond single values: consistency of the tables, and implausible sizes.

`Reader.place` gives the place of a fault in the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import PureWindowsPath
from typing import Any

import numpy as np

from strainwave.domain import (
    ArmDescription,
    Imu,
    Joint,
    JointLimits,
    Study,
    channel_names,
    channel_parts,
)
from strainwave.domain.arm.description import UNKNOWN, Matrix
from strainwave.domain.arm.effects import OF_RIGID_JOINTS, effect_named
from strainwave.domain.arm.effects import names as effect_names
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.link_sensors import optional_constants, sensor_of
from strainwave.domain.arm.parameters import whole_arm_parameter_names
from strainwave.domain.steps import DETRENDABLE, RATES, Detrend, Merge
from strainwave.domain.study import study_keys
from strainwave.errors import InvalidInput, suggest_name
from strainwave.io.study.reader import Reader

_MAX_CONDITION = 1e6  # of a coupling; those of real wrists are below 10


def check_consistency(study: Study, reader: Reader, *, of_load: bool = False) -> None:
    """Raise InvalidInput if the tables contradict each other.

    Records of a load to be estimated, `of_load`, need no known payload and may state one.
    """
    _check_joints(study.arm, reader)
    _check_channels(study, reader)
    _check_experiments(study, reader)
    _check_steps(study, reader)
    if not of_load:
        _check_payloads(study, reader)
    check_options(study, reader)


def _check_joints(arm: ArmDescription, reader: Reader) -> None:
    for index, joint in enumerate(arm.joints):
        if joint.torque_per_volt == UNKNOWN and kind_of(arm).places_joints:
            raise InvalidInput(
                f"'torque_per_volt' of a {arm.kind} arm must be known",
                where=reader.place("joint", index, "torque_per_volt"),
                remedy='set it in N m/V, or describe the arm with kind = "serial" and record it '
                "with and without a payload",
            )
        if joint.gear_ratio == 0.0:
            raise InvalidInput(
                "'gear_ratio' is 0",
                where=reader.place("joint", index, "gear_ratio"),
                remedy="set link turns per motor turn",
            )
        if joint.link_encoder_counts is not None and joint.motion == "prismatic":
            raise InvalidInput(
                "'link_encoder_counts' are counts per turn, but the joint is prismatic",
                where=reader.place("joint", index, "link_encoder_counts"),
                remedy=f"remove it; the channel theta_l{index + 1} in m has its resolution",
            )
        if joint.imu is not None:
            _check_imu(arm, index, joint.imu, reader.place("joint", index, "imu"))
        limits = joint.limits or JointLimits()
        lower, upper = limits.lower, limits.upper
        if lower is not None and upper is not None and lower >= upper:
            raise InvalidInput(
                f"the lower limit of the joint, {lower:g}, is not below the upper, {upper:g}",
                where=reader.place("joint", index, "limits"),
                remedy="correct the limits",
            )
        _check_effects(index, joint, reader.place("joint", index, "effects"))
    if arm.coupling is not None:
        _check_coupling(arm.coupling, arm, reader.place("transmission", None, "coupling"))
    servo = arm.servo or arm.position_servo
    if servo is not None:
        for field in fields(servo):
            values = getattr(servo, field.name)
            if isinstance(values, tuple):
                place = reader.place("servo", None, field.name)
                _check_count(values, arm.n_joints, place, field.name)
    if arm.position_servo is not None:
        _check_position_servo(arm, reader)


def _check_position_servo(arm: ArmDescription, reader: Reader) -> None:
    """Raise InvalidInput for outputs without their constants, and for drives in the joints."""
    servo = arm.position_servo
    assert servo is not None
    constants = {"current": ("torque_constant",), "duty": ("stall_torque", "no_load_speed")}
    for output, keys in constants.items():
        for key in keys:
            is_given = getattr(servo, key) is not None
            if is_given and servo.output != output:
                raise InvalidInput(
                    f"'{key}' is given, but the output of the servo is a {servo.output}",
                    where=reader.place("servo", None, key),
                    remedy=f'remove it, or set output = "{output}"',
                )
            if not is_given and key == "torque_constant" and servo.output == output:
                raise InvalidInput(
                    "the output of the servo is a current, but 'torque_constant' is missing",
                    where=reader.place("servo", None, "output"),
                    remedy="set the joint's torque per ampere; or give the gains as torques, with "
                    'output = "torque"',
                )
    for index, joint in enumerate(arm.joints):
        for key in ("torque_per_volt", "current_loop_hz"):
            if getattr(joint, key) is not None:
                raise InvalidInput(
                    f"'{key}' is given, but the logs of a position servo have no voltage",
                    where=reader.place("joint", index, key),
                    remedy="remove it; the keys of [servo] describe the drive",
                )
    if arm.is_coupled:
        raise InvalidInput(
            "position servos of coupled joints have no model",
            where=reader.place("transmission"),
            remedy="remove [transmission], or log the torques of the motors",
        )


def _check_effects(index: int, joint: Joint, place: str) -> None:
    for name in joint.named_effects:
        if joint.elastic and name not in effect_names():
            raise InvalidInput(
                f"the effect '{name}' needs a rigid joint",
                where=place,
                remedy=f"remove '{name}', or set spring = \"rigid\"",
            )
        is_torsion = effect_named(name).needs_elastic_gear and name not in OF_RIGID_JOINTS
        if is_torsion and not joint.elastic:
            raise InvalidInput(
                f"the effect '{name}' needs an elastic gear: it acts on the gear's torsion, "
                "which a rigid joint does not have",
                where=place,
                remedy=f"remove '{name}', or set an elastic spring",
            )
        if effect_named(name).first_joint_only and index > 0:
            raise InvalidInput(
                f"joint {index + 1} has the effect '{name}', which only joint 1 can have",
                where=place,
                remedy=f"move '{name}' to the effects of joint 1",
            )


def _check_imu(arm: ArmDescription, index: int, imu: Imu, place: str) -> None:
    """Raise InvalidInput for an IMU on a link that only slides, unless its mounting is known."""
    if any(joint.motion == "revolute" for joint in arm.joints[: index + 1]):
        return
    along = f"map the axis along the joint to a{index + 1} and remove the other axes"
    if arm.has_planar_program:
        raise InvalidInput(
            f"an IMU on a prismatic joint needs a serial arm, and the kind is {arm.kind}",
            where=place,
            remedy=f'{along}, or describe the arm with kind = "serial"',
        )
    if imu.xyz is None or imu.rpy is None:
        raise InvalidInput(
            "the link of this joint only slides, so that readings do not show the IMU's mounting",
            where=place,
            remedy=f"give xyz and rpy; or {along}",
        )


def _check_coupling(coupling: Matrix, arm: ArmDescription, place: str) -> None:
    count = arm.n_joints
    if len(coupling) != count or any(len(row) != count for row in coupling):
        raise InvalidInput(
            f"'coupling' is not a matrix of {count} rows and {count} columns",
            where=place,
            remedy="write one row per joint: link angles = coupling (gear_ratio motor angles)",
        )
    if np.linalg.cond(np.array(coupling)) > _MAX_CONDITION:
        raise InvalidInput(
            "'coupling' is singular: some link motion needs no motor",
            where=place,
            remedy="correct the matrix; each joint needs its own motor",
        )
    is_elastic = [joint.elastic for joint in arm.joints]
    for row, column in np.argwhere(np.array(coupling)).tolist():
        if is_elastic[row] != is_elastic[column]:
            raise InvalidInput(
                f"'coupling' joins the joints {row + 1} and {column + 1}, of which one is rigid",
                where=place,
                remedy="set spring so that both are rigid or both elastic",
            )


def check_options(study: Study, reader: Reader) -> None:
    """Raise InvalidInput if a band or range is empty, or if the arm lacks a parameter."""
    options = study.options
    bands = {"statespace": options.statespace.band_hz, "physical": options.physical.band_hz}
    for stage, band in bands.items():
        if band is not None and band[0] >= band[1]:
            raise InvalidInput(
                f"the band from {band[0]:g} to {band[1]:g} Hz is empty",
                where=reader.place(f"options.{stage}", None, "band_hz"),
                remedy="put the lower frequency first",
            )
    fitted = whole_arm_parameter_names(study.arm)
    numbers = range(1, study.arm.n_joints + 1)
    constants = optional_constants()
    of_joints = [f"{name} {i}" for name in constants for i in numbers]
    # `ranges` are factors, which cannot bound a sensor constant whose nominal value is zero
    holdable_names = (*fitted, *constants, *of_joints)
    named = [("ranges", name, fitted) for name in options.tuning.ranges]
    named += [("hold", name, holdable_names) for name in options.tuning.hold]
    for key, name, known in named:
        if name not in known:
            raise InvalidInput(
                f"'{name}' is not a parameter of the whole-arm fit",
                where=reader.place("options.tuning", None, key),
                remedy=f"use one of {', '.join(known)}{suggest_name(name, known)}",
            )
    for name, (low, high) in options.tuning.ranges.items():
        if not low <= 1.0 <= high or low == high:
            raise InvalidInput(
                f"the range of {name}, {low:g} to {high:g} times its starting value, does not "
                "contain the starting value",
                where=reader.place("options.tuning", None, "ranges"),
                remedy="set a factor below 1 and a factor above 1, such as [0.5, 2.0]",
            )
        if name.startswith("friction_offset"):
            raise InvalidInput(
                f"'{name}' can be zero or negative, so that factors do not bound it",
                where=reader.place("options.tuning", None, "ranges"),
                remedy="put it into hold, or remove it from ranges",
            )


def _check_count(values: tuple[Any, ...], count: int, place: str, key: str) -> None:
    if len(values) != count:
        raise InvalidInput(
            f"'{key}' has {len(values)} value(s), but the arm has {count} joint(s)",
            where=place,
            remedy="set one value per joint",
        )


def _check_channels(study: Study, reader: Reader) -> None:
    if study.sample_rate is not None and "t" in study.channels:
        raise InvalidInput(
            "both t and sample_rate are given",
            where=reader.place("channels", None, "sample_rate"),
            remedy="remove sample_rate if the logs have time stamps, else t",
        )
    known = channel_names(study.arm.n_joints)
    named_channels: list[tuple[str, int | None, str]] = [
        ("channels", None, name) for name in study.channels
    ]
    for index, experiment in enumerate(study.experiments):
        named_channels += [("experiment", index, name) for name in experiment.add]
    for table, position, name in named_channels:
        if name not in known:
            kind, number = channel_parts(name)
            count, problem = study.arm.n_joints, f"'{name}' is not a channel of this arm"
            if f"{kind}1" in known and number > count:
                remedy = f"remove it, or describe joint {number} in a [[joint]] table"
                problem = f"{problem}, which has {count} joint{'s'[: count > 1]}"
            else:
                remedy = f"use one of {', '.join(known)}{suggest_name(name, known)}"
            raise InvalidInput(problem, where=reader.place(table, position, name), remedy=remedy)
    for table, position, name in named_channels:
        for effect in _moving_encoders(study.arm, name):
            raise InvalidInput(
                f"'{name}' does not measure the absolute link angle with the effect '{effect}'",
                where=reader.place(table, position, name),
                remedy=f"map an accelerometer instead of '{name}', or remove '{effect}'",
            )
    for name, channel in study.channels.items():
        if channel.scale == 0.0:
            raise InvalidInput(
                f"the scale of '{name}' is zero",
                where=reader.place("channels", None, name),
                remedy="set the factor from the column's unit to the SI unit",
            )


def without_gravity(study: Study, reader: Reader) -> Study:
    """The study without gravity if the drivers subtract it from the logged efforts.

    Gravity then acts on no torque, and the accelerometers of the links would contradict that.
    """
    efforts = {n: c for n, c in study.channels.items() if n.startswith(("torque", "tau_l"))}
    others = [n for n, c in efforts.items() if c.meaning != "without-gravity"]
    if len(others) == len(efforts):
        return study
    sensors = [n for n in study.channels if channel_parts(n)[0] in ("a", "ax", "ay", "az")]
    if others or sensors or study.arm.kind != "serial":
        raise InvalidInput(
            "efforts without gravity need a serial arm, no accelerometers, and the same meaning of"
            " all efforts",
            where=reader.place("channels", None, (others or sensors or [*efforts])[0]),
            remedy="log the efforts of the motors, or remove the accelerometers from [channels]",
        )
    return replace(study, arm=replace(study.arm, gravity=None))


def _moving_encoders(arm: ArmDescription, channel: str) -> Iterator[str]:
    """Named effects that move the link encoder of a channel."""
    kind, number = channel_parts(channel)
    if 0 < number <= arm.n_joints:
        joint = arm.joints[number - 1]
        sensor = sensor_of(joint, kind)
        if sensor is not None and sensor.reads_angle:
            yield from (e for e in joint.named_effects if effect_named(e).moves_link_encoder)


def _check_experiments(study: Study, reader: Reader) -> None:
    count, names = study.arm.n_joints, set[str]()
    for index, experiment in enumerate(study.experiments):
        if experiment.name in names:
            raise InvalidInput(
                f"two experiments have the name {experiment.name!r}",
                where=reader.place("experiment", index, "name"),
                remedy="choose different names",
            )
        names.add(experiment.name)
        place = reader.place("experiment", index, "control")
        _check_count(experiment.control, count, place, "control")
        if experiment.joint is not None and experiment.joint > count:
            raise InvalidInput(
                f"there is no joint {experiment.joint}: the arm has {count}",
                where=reader.place("experiment", index, "joint"),
                remedy="use a joint number from 1, counted from the base",
            )
        start, stop = experiment.start, experiment.stop
        if start is not None and stop is not None and stop <= start:
            raise InvalidInput(
                f"the window is empty: stop = {stop:g} s is not after start = {start:g} s",
                where=reader.place("experiment", index, "stop"),
                remedy="set a stop after the start, or remove it",
            )


def detrendable_channels(arm: ArmDescription) -> tuple[str, ...]:
    """Channels of an arm whose mean or slope can be a fault of the sensor."""
    has_gravity = arm.gravity is not None and bool(np.any(arm.gravity))
    kinds = RATES if has_gravity else DETRENDABLE
    return tuple(name for name in channel_names(arm.n_joints) if channel_parts(name)[0] in kinds)


def _check_steps(study: Study, reader: Reader) -> None:
    """Raise InvalidInput if steps are out of order, or would remove a part of the motion."""
    for index, experiment in enumerate(study.experiments):
        place = reader.place("experiment", index, "steps")
        for number, step in enumerate(experiment.steps):
            before = experiment.steps[number - 1] if number else step
            if isinstance(step, Merge) and not isinstance(before, Merge):
                raise InvalidInput(
                    f"the step 'merge' follows '{before.kind}', which acts on the whole record",
                    where=place,
                    remedy="put the merge steps first",
                )
            for name in step.channels if isinstance(step, Detrend) else ():
                _check_detrended(name, study.arm, place)


def _check_detrended(name: str, arm: ArmDescription, place: str) -> None:
    usable = detrendable_channels(arm)
    if name in usable:
        return
    problem = f"the mean of '{name}' is not a fault of a sensor, so that it cannot be removed"
    remedy = "; correct the zero of an encoder by offset in [channels]"
    if name not in channel_names(arm.n_joints):
        problem, remedy = f"'{name}' is not a channel of this arm", suggest_name(name, usable)
    elif channel_parts(name)[0] in DETRENDABLE:
        problem, remedy = f"gravity has a mean in '{name}', which detrending would remove", ""
    raise InvalidInput(problem, where=place, remedy=f"detrend one of {', '.join(usable)}{remedy}")


def _check_payloads(study: Study, reader: Reader) -> None:
    """Raise InvalidInput unless unknown drives and known payloads belong together."""
    unknown = study.arm.unknown_drives
    if study.arm.position_servo is not None:
        for index, experiment in enumerate(study.experiments):
            load = experiment.payload
            if load is not None and study.arm.has_planar_program and load.xyz[1] != 0.0:
                raise InvalidInput(
                    f"the centre of the payload is {load.xyz[1]:g} m beside the x axis of the "
                    f"link, but links of a {study.arm.kind} arm lie on their x axes",
                    where=reader.place("experiment", index, "payload"),
                    remedy='mount it on the axis, or describe the arm with kind = "serial"',
                )
        return
    for index, experiment in enumerate(study.experiments):
        if experiment.payload is not None and not unknown:
            raise InvalidInput(
                "a payload is given, but the torque_per_volt of every joint is known",
                where=reader.place("experiment", index, "payload"),
                remedy="remove the payload, which serves to estimate the torque_per_volt of serial "
                'arms; or set torque_per_volt = "unknown"',
            )
    payloads = {e.payload for e in study.experiments if e.use == "motion"}
    if unknown and study.experiments and len(payloads) < 2:
        raise InvalidInput(
            "'torque_per_volt' is \"unknown\", but no two motion records have different payloads",
            where=reader.place("joint", unknown[0] - 1, "torque_per_volt"),
            remedy="set it in N m/V, or record a motion without and one with a known payload, and "
            "describe it: payload = { mass = ..., xyz = [...] } in [[experiment]]",
        )


def check_files(study: Study, reader: Reader) -> None:
    """Raise InvalidInput if a log of an experiment does not exist."""
    for index, experiment in enumerate(study.experiments):
        files = (experiment.file, *(step.file for step in experiment.merges))
        paths = study.log_paths(experiment)
        for number, (file, path) in enumerate(zip(files, paths, strict=True)):
            try:
                exists = path.exists()
            except (OSError, ValueError):
                exists = False
            if not exists:
                siblings = [p.name for p in study.path.parent.glob("*")]
                raise InvalidInput(
                    f"the log file {file!r} does not exist",
                    where=reader.place("experiment", index, "steps" if number else "file"),
                    remedy="put it next to the study file, or correct the name"
                    + suggest_name(PureWindowsPath(file).name, siblings),
                )


def check_sizes(study: Study, reader: Reader) -> None:
    """Raise InvalidInput if a number is so large or small that its unit must be wrong."""
    _check_record_sizes(reader, kind_of(study.arm).table_of(study.arm), "arm")
    for index, joint in enumerate(study.arm.joints):
        _check_record_sizes(reader, joint, "joint", index)
    if study.arm.servo is not None:
        _check_record_sizes(reader, study.arm.servo, "servo")
    if study.arm.position_servo is not None:
        _check_record_sizes(reader, study.arm.position_servo, "servo", keys="position_servo")
    for index, experiment in enumerate(study.experiments):
        _check_record_sizes(reader, experiment, "experiment", index)
        for step in experiment.steps:
            _check_record_sizes(reader, step, "experiment", index, keys=step.kind)


def _check_record_sizes(
    reader: Reader, record: Any, table: str, index: int | None = None, *, keys: str = ""
) -> None:
    for key in study_keys()[keys or table]:
        owner, _, name = key.key.rpartition(".")
        value = getattr(getattr(record, owner, None) if owner else record, name, None)
        if key.range is None or value is None or isinstance(value, str):
            continue
        minimum, maximum = key.range
        if isinstance(value, tuple):
            value = math.hypot(*(each for each in value if not isinstance(each, str)))
        if minimum <= abs(value) <= maximum:
            continue
        remedy = f"set a value from {minimum:g} to {maximum:g}"
        if name == "gear_ratio" and abs(value) > maximum:
            remedy = f"the value is probably inverted: set {1.0 / value:g} {key.unit}"
        elif key.other_scale is not None:
            other = value * key.other_scale
            if other <= maximum and (minimum <= other or key.other_scale > 1.0):
                remedy = f"if {value:g} is in {key.other_unit}, set {other:g}"
        raise InvalidInput(
            f"'{name}' is {value:g} {key.unit}, which is outside the range of any rig",
            where=reader.place(table, index, owner or name),
            remedy=remedy,
        )
