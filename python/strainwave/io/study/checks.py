"""What one value cannot show: whether the tables fit each other, and sizes that no rig has."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from strainwave.domain import ArmDescription, Study, channel_names
from strainwave.domain.effects import effect_named
from strainwave.domain.kinds import KINDS, kind_of
from strainwave.domain.parameters import SENSOR_PARAMETERS, whole_arm_parameters
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import nearest
from strainwave.io.study.reader import Reader


def check_fit(study: Study, reader: Reader) -> None:
    """Check that the tables fit each other and the kind of arm.

    `reader`: Knows where in the file things stand. Raises `InvalidInput`: They do not.
    """
    _check_kind(study.arm, reader)
    _check_joints(study.arm, reader)
    _check_channels(study, reader)
    _check_experiments(study, reader)
    check_options(study, reader)


def _check_kind(arm: ArmDescription, reader: Reader) -> None:
    count = kind_of(arm).n_joints
    if arm.n_joints > max(kind.n_joints for kind in KINDS.values()):
        raise InvalidInput(
            f"there are {arm.n_joints} [[joint]] tables; an arm of one joint, or of two links "
            "in one plane, is what can be identified so far",
            where=reader.place("joint"),
            remedy="describe one joint, or two that move in one plane, and record them while the "
            "others stand still",
        )
    if arm.n_joints != count:
        raise InvalidInput(
            f"a {arm.kind} arm has {count} joint(s), but there are {arm.n_joints} [[joint]] tables",
            where=reader.place("joint"),
            remedy=f"write {count} [[joint]] table(s), from the base, or another kind of [arm]",
        )
    for fault in kind_of(arm).faults(arm):
        raise InvalidInput(
            fault.problem,
            where=reader.place(fault.table, fault.index, fault.key),
            remedy=fault.remedy,
        )


def _check_joints(arm: ArmDescription, reader: Reader) -> None:
    for index, joint in enumerate(arm.joints):
        if joint.imu is not None and joint.motion == "prismatic":
            raise InvalidInput(
                "an IMU on a prismatic joint is not supported",
                where=reader.place("joint", index, "imu"),
                remedy="map the axis along the joint to the channel a1, and leave the others out",
            )
        of_a_gear = [name for name in joint.named_effects if effect_named(name).needs_elastic_gear]
        if of_a_gear and not joint.elastic:
            raise InvalidInput(
                f"a rigid gear has no {of_a_gear[0].replace('-', ' ')}",
                where=reader.place("joint", index, "effects"),
                remedy=f"leave '{of_a_gear[0]}' out, or give the gear a spring",
            )
        of_first = [name for name in joint.named_effects if effect_named(name).first_joint_only]
        if of_first and index > 0:
            raise InvalidInput(
                f"joint {index + 1} has no {of_first[0].replace('-', ' ')}: only what bears the "
                "first joint can have it",
                where=reader.place("joint", index, "effects"),
                remedy=f"give joint 1 the effect '{of_first[0]}'",
            )
    if arm.servo is not None:
        for key in ("kp", "ki", "position_gain"):
            own = getattr(arm.servo, key)
            if own is not None:
                _check_count(own, arm.n_joints, reader.place("servo", None, key), key)


def check_options(study: Study, reader: Reader) -> None:
    """Check that bands and ranges rise, and that parameters are this arm's.

    Raises `InvalidInput`: They do not, or are not.
    """
    options = study.options
    for stage, band in (
        ("statespace", options.statespace.band_hz),
        ("physical", options.physical.band_hz),
    ):
        if band is not None and band[0] >= band[1]:
            raise InvalidInput(
                f"the band from {band[0]:g} to {band[1]:g} Hz is empty",
                where=reader.place(f"options.{stage}", None, "band_hz"),
                remedy="give the lower frequency first",
            )
    fitted = whole_arm_parameters(study.arm)
    numbers = range(1, study.arm.n_joints + 1)
    constants = [f"{name} {i}" for name in SENSOR_PARAMETERS for i in numbers]
    held = (*fitted, *SENSOR_PARAMETERS, *constants)  # a delay may be zero: no factors bound it
    for key, names, known in (
        ("ranges", tuple(options.tuning.ranges), fitted),
        ("hold", options.tuning.hold, held),
    ):
        for name in names:
            if name not in known:
                raise InvalidInput(
                    f"'{name}' is no parameter of the whole-arm fit",
                    where=reader.place("options.tuning", None, key),
                    remedy=f"use one of {', '.join(known)}{nearest(name, known)}",
                )
    for name, (least, most) in options.tuning.ranges.items():
        if not least <= 1.0 <= most or least == most:
            raise InvalidInput(
                f"the range of {name}, {least:g} to {most:g} times its start, leaves the start out",
                where=reader.place("options.tuning", None, "ranges"),
                remedy="give two factors about 1, the lower one first: [0.5, 2.0]",
            )
        if name.startswith("friction_offset"):
            raise InvalidInput(
                f"'{name}' may be zero or have either sign, so that factors bound nothing",
                where=reader.place("options.tuning", None, "ranges"),
                remedy="hold it, or leave it free",
            )


def _check_count(values: tuple[Any, ...], count: int, place: str, key: str) -> None:
    if len(values) != count:
        raise InvalidInput(
            f"'{key}' has {len(values)} value(s), but the arm has {count} joint(s)",
            where=place,
            remedy="give one value for each joint",
        )


def _check_channels(study: Study, reader: Reader) -> None:
    known = channel_names(study.arm.n_joints)
    named: list[tuple[str, int | None, str]] = [("channels", None, name) for name in study.channels]
    for index, experiment in enumerate(study.experiments):
        named += [("experiment", index, name) for name in experiment.add]
    for table, at, name in named:
        if name not in known:
            raise InvalidInput(
                f"'{name}' is no channel of this arm",
                where=reader.place(table, at, name),
                remedy=f"use one of {', '.join(known)}{nearest(name, known)}",
            )
    for table, at, name in named:
        for effect in _moving_encoders(study.arm, name):
            raise InvalidInput(
                f"'{name}' is no link angle in space where there is a {effect.replace('-', ' ')}",
                where=reader.place(table, at, name),
                remedy=f"leave '{name}' out and map an accelerometer, or leave '{effect}' out",
            )
    for name, channel in study.channels.items():
        if channel.scale == 0.0:
            raise InvalidInput(
                f"the scale of '{name}' is zero",
                where=reader.place("channels", None, name),
                remedy="give the factor from the column's unit to SI",
            )


def _moving_encoders(arm: ArmDescription, channel: str) -> Iterator[str]:
    """The effects named that move the encoder on a link whose channel it is."""
    for number, joint in enumerate(arm.joints, start=1):
        if channel in (f"theta_l{number}", f"deflection{number}"):
            yield from (e for e in joint.named_effects if effect_named(e).moves_link_encoder)


def _check_experiments(study: Study, reader: Reader) -> None:
    count, seen = study.arm.n_joints, set[str]()
    for index, experiment in enumerate(study.experiments):
        if experiment.name in seen:
            raise InvalidInput(
                f"there are two experiments named {experiment.name!r}",
                where=reader.place("experiment", index, "name"),
                remedy="give each its own name",
            )
        seen.add(experiment.name)
        _check_count(
            experiment.control, count, reader.place("experiment", index, "control"), "control"
        )
        if experiment.joint is not None and experiment.joint > count:
            raise InvalidInput(
                f"there is no joint {experiment.joint}: the arm has {count}",
                where=reader.place("experiment", index, "joint"),
                remedy="joints are numbered from 1, from the base",
            )
        start, stop = experiment.start, experiment.stop
        if start is not None and stop is not None and stop <= start:
            raise InvalidInput(
                f"the window is empty: stop = {stop:g} s is not after start = {start:g} s",
                where=reader.place("experiment", index, "stop"),
                remedy="give a stop after the start, or leave it out",
            )


def check_files(study: Study, reader: Reader) -> None:
    """Check that every experiment's log is there.

    `reader`: Knows where in the file things stand. Raises `InvalidInput`: One is not.
    """
    for index, experiment in enumerate(study.experiments):
        path = study.log_path(experiment)
        try:
            there = path.exists()
        except (OSError, ValueError):
            there = False
        if not there:
            siblings = [p.name for p in study.path.parent.glob("*")]
            raise InvalidInput(
                f"the log file {experiment.file!r} does not exist",
                where=reader.place("experiment", index, "file"),
                remedy="put it beside the study file, or mend the name"
                + nearest(experiment.file, siblings),
            )


# Sizes that no rig has. The limits are wide: they are to catch a unit or a ratio upside down, not
# to doubt an unusual machine. (key, smallest, largest, unit, factor of the likely slip, its name)
_JOINT_SIZES = (
    ("gear_ratio", 1e-4, 1.0, "link turns per motor turn", None, ""),
    ("torque_per_volt", 1e-6, 1e4, "N m/V at the motor", 1e-3, "mN m/V"),
    ("current_loop_hz", 5.0, 1e6, "Hz", 1e3, "kHz"),
    ("encoder_counts", 4.0, 1e9, "counts per motor turn", None, ""),
    ("accelerometer_distance", 1e-3, 10.0, "m", 1e-3, "mm"),
    ("accelerometer_hz", 1.0, 1e6, "Hz", 1e3, "kHz"),
    ("gyro_hz", 0.05, 1e6, "Hz", 1e3, "kHz"),
)
_IMU_SIZES = (
    ("accelerometer_hz", 1.0, 1e6, "Hz", 1e3, "kHz"),
    ("gyro_hz", 0.05, 1e6, "Hz", 1e3, "kHz"),
)
_ARM_SIZES = (
    ("link_length", 5e-3, 10.0, "m", 1e-3, "mm"),
    ("gravity", 0.0, 30.0, "m/s^2", 1e-3, "mm/s^2"),
)
_SERVO_SIZES = (("period", 1e-6, 0.2, "s", 1e-3, "ms"), ("limit", 1e-3, 1e4, "V", 1e-3, "mV"))
_PRBS_SIZES = (("clock", 1e-6, 5.0, "s", 1e-3, "ms"), ("order", 2, 24, "bits", None, ""))


def check_sizes(study: Study, reader: Reader) -> None:
    """Check for numbers that are a slip of unit, or upside down.

    `reader`: Knows where in the file things stand. Raises `InvalidInput`: One is of a size that no
    rig has.
    """
    _sizes(study.arm, _ARM_SIZES, lambda key: reader.place("arm", None, key))
    for index, joint in enumerate(study.arm.joints):
        _sizes(joint, _JOINT_SIZES, lambda key, i=index: reader.place("joint", i, key))
        if joint.imu is not None:
            _sizes(joint.imu, _IMU_SIZES, lambda _, i=index: reader.place("joint", i, "imu"))
    if study.arm.servo is not None:
        _sizes(study.arm.servo, _SERVO_SIZES, lambda key: reader.place("servo", None, key))
    for index, experiment in enumerate(study.experiments):
        if experiment.prbs is not None:
            place = reader.place("experiment", index, "prbs")
            _sizes(experiment.prbs, _PRBS_SIZES, lambda _, place=place: place)


def _sizes(record: Any, sizes: Any, place: Any) -> None:
    for key, least, most, unit, slip, slip_unit in sizes:
        value = getattr(record, key)
        if value is None or least <= value <= most:
            continue
        if key == "gear_ratio" and value > most:
            meant = f"{1.0 / value:g} was probably meant: {unit}"
        elif (slip and least <= value * slip <= most) or (
            slip and slip_unit.startswith("k") and value * slip <= most
        ):
            meant = f"{value * slip:g} was probably meant, if {value:g} is in {slip_unit}"
        else:
            meant = f"expected {least:g} to {most:g}"
        raise InvalidInput(
            f"'{key}' is {value:g} {unit}, which no rig has",
            where=place(key),
            remedy=meant,
        )
