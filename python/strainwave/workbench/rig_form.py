"""The tables of a study file as a form: fields with unit, meaning and plausible range.

The built-in virtual arm with the settings of the page, and its estimate against the truth.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from tomlkit.items import Whitespace

from strainwave.domain import Study, gear_laws, kinds
from strainwave.domain.gear_laws import is_slope
from strainwave.domain.keys import Values, label_of
from strainwave.domain.link_sensors import key_texts
from strainwave.domain.study_limits import ARM_LIMITS, IMU_LIMITS, JOINT_LIMITS, SERVO_LIMITS
from strainwave.errors import InvalidInput
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study
from strainwave.virtual.experiments import derived
from strainwave.virtual.scara import MAX_DISKS, SOFT
from strainwave.workbench.study_edit import TODO, parse_draft, table_of, tables_of

FieldKind = Literal["number", "numbers", "text", "choice"]
Place = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class FieldText:
    """Title and meaning of a key."""

    key: str  # dotted for a table in the table: "imu.xyz"
    title: str
    meaning: str
    kind: FieldKind = "number"
    unit: str = ""
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Field:
    """One field of the form, with its value."""

    place: Place
    text: FieldText
    unit: str
    value: str
    is_todo: bool
    reason: str  # comment of the file: why `init` guesses the value, or where to find it
    minimum: float | None = None  # plausible
    maximum: float | None = None


@dataclass(frozen=True, slots=True)
class FieldGroup:
    """Fields of one table."""

    title: str
    fields: tuple[Field, ...]


_ARM = (
    FieldText("link_length", "Link length", "Distance of axis 1 and axis 2.", unit="m"),
    FieldText("gravity", "Gravity", "Acts along -y in the plane of motion; empty: none."),
)
_SERIAL_ARM = (
    FieldText("gravity", "Gravity", "Vector in the frame of the base.", "numbers", "m/s^2"),
    FieldText("urdf", "URDF", "File that places the joints, next to the study.", "text"),
)
_PLACED = (
    FieldText("name", "Name", "Name of the joint in exports.", "text"),
    FieldText(
        "origin.xyz", "Position", "Of this joint in the frame of the link before.", "numbers", "m"
    ),
    FieldText("origin.rpy", "Orientation", "Roll, pitch and yaw as in URDF.", "numbers", "rad"),
    FieldText("axis", "Axis", "Direction in the joint's frame.", "numbers"),
)
_DRIVE = (
    FieldText(
        "torque_per_volt",
        "Torque per volt",
        "At the motor: amplifier gain times torque constant. Not needed where torque is logged.",
    ),
    FieldText("current_loop_hz", "Current loop", "Bandwidth from voltage to torque."),
    FieldText("encoder_counts", "Motor encoder", "Counts per turn of the motor."),
)
_IMU = (
    FieldText("imu.xyz", "IMU position", "In the link's frame; empty: estimated.", "numbers", "m"),
    FieldText(
        "imu.rpy", "IMU orientation", "In the link's frame; empty: estimated.", "numbers", "rad"
    ),
    FieldText("imu.accelerometer_hz", "IMU accelerometer", "Bandwidth of its low-pass."),
    FieldText("imu.gyro_hz", "IMU gyro", "Bandwidth of its low-pass."),
)
_SERVO = (
    FieldText("kind", "Servo", "PI velocity loop.", "choice", choices=("pi-velocity",)),
    FieldText("period", "Period", "Sampling period of the servo."),
    FieldText("kp", "Proportional gain", "One per joint.", "numbers", "V s/rad"),
    FieldText("ki", "Integral gain", "One per joint.", "numbers", "V/rad"),
    FieldText("limit", "Voltage limit", "The integration stops while it is reached."),
    FieldText(
        "position_gain", "Position gain", "Of an outer loop, one per joint.", "numbers", "1/s"
    ),
)
_LIMITS = {
    **{("arm", limit.key): limit for limit in ARM_LIMITS},
    **{("joint", limit.key): limit for limit in JOINT_LIMITS},
    **{("joint", f"imu.{limit.key}"): limit for limit in IMU_LIMITS},
    **{("servo", limit.key): limit for limit in SERVO_LIMITS},
}


def field_groups(document: Mapping[str, Any]) -> list[FieldGroup]:
    """The form of a study file."""
    arm = table_of(document, "arm")
    is_serial = arm.get("kind") == "serial"
    names = tuple(kind.name for kind in kinds.all_kinds())
    kind = FieldText("kind", "Kind of arm", "Tables of the file depend on it.", "choice", "", names)
    rows = _SERIAL_ARM if is_serial else _ARM[arm.get("kind") == "single-joint" :]
    groups = [FieldGroup("Arm", tuple(_fields(arm, ("arm",), (kind, *rows))))]
    for index, joint in enumerate(tables_of(document, "joint")):
        texts = _joint_texts(is_placed=is_serial and "urdf" not in arm)
        fields = tuple(_fields(joint, ("joint", index), texts))
        groups.append(FieldGroup(f"Joint {index + 1}", fields))
    servo = table_of(document, "servo")
    groups.append(FieldGroup("Servo", tuple(_fields(servo, ("servo",), _SERVO))))
    if is_serial:
        text = FieldText(
            "coupling", "Coupling", "Matrix: [[1, 0], [0.2, 1]]; empty: none.", "numbers"
        )
        table = table_of(document, "transmission")
        groups.append(FieldGroup("Transmission", tuple(_fields(table, ("transmission",), (text,)))))
    return groups


def _joint_texts(*, is_placed: bool) -> Iterator[FieldText]:
    yield FieldText(
        "spring",
        "Gear",
        'Elastic law of the gear; "auto": the law that the data support.',
        "choice",
        choices=(gear_laws.AUTO, *gear_laws.names()),
    )
    motions = ("revolute", "prismatic")
    yield FieldText("motion", "Motion", "Of the link.", "choice", choices=motions)
    if is_placed:
        yield from _PLACED
    yield FieldText("gear_ratio", "Gear ratio", "Turns of the link per turn of the motor.")
    yield from _DRIVE
    for key, (title, unit) in key_texts().items():
        yield FieldText(key, f"{title[:1].upper()}{title[1:]}", "Sensor on the link.", unit=unit)
    yield from _IMU


def _fields(table: Mapping[str, Any], place: Place, texts: Iterable[FieldText]) -> Iterator[Field]:
    reasons = comments_of(table)
    for text in texts:
        keys = text.key.split(".")
        value: Any = table
        for key in keys:
            value = value.get(key) if isinstance(value, Mapping) else None
        limit = _LIMITS.get((str(place[0]), text.key))
        yield Field(
            place=(*place, *keys),
            text=text,
            unit=text.unit or (limit.unit if limit else ""),
            value=_shown(value),
            is_todo=TODO in _shown(value),
            reason=reasons.get(text.key, ""),
            minimum=limit.minimum if limit else None,
            maximum=limit.maximum if limit else None,
        )


def comments_of(table: Mapping[str, Any]) -> dict[str, str]:
    """Comments of a table of tomlkit by key: the lines above the key, or behind its value."""
    comments: dict[str, str] = {}
    above: list[str] = []
    for key, item in getattr(getattr(table, "value", None), "body", []):
        if isinstance(item, Whitespace):
            above = []
            continue
        comment = item.trivia.comment.lstrip("# ")
        if key is None:
            above = [*above, comment] if comment else []
            continue
        comments[key.key] = " ".join([*above, comment]).strip()
        above = []
    return comments


def _shown(value: Any) -> str:
    """A value as the user types it."""
    if value is None:
        return ""
    if isinstance(value, list):
        return ", ".join(f"[{_shown(v)}]" if isinstance(v, list) else _shown(v) for v in value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def value_of(text: str, kind: FieldKind) -> Any:
    """The value of a field's text; None if it is empty.

    Raises InvalidInput if a number is needed and the text is none.
    """
    stripped = text.strip()
    if not stripped:
        return None
    if kind == "numbers":
        return _numbers(stripped)
    if kind == "number":
        # "unknown" is a torque per volt that the records determine
        return stripped if stripped in ("unknown", TODO) else _number(stripped)
    return stripped


def _numbers(text: str) -> list[Any]:
    """A list of numbers, or of lists of numbers: 1, 2 or [1, 0], [0.2, 1], also in brackets."""
    try:
        value = parse_draft(f"list = [{text}]", Path("value")).unwrap()["list"]
    except InvalidInput as error:
        raise InvalidInput(f"{text!r} is no list of numbers", remedy="write 0, 0, -9.81") from error
    while len(value) == 1 and isinstance(value[0], list):
        value = value[0]
    rows = value if all(isinstance(row, list) for row in value) else [value]
    for entry in (entry for row in rows for entry in row):
        if entry != TODO and (isinstance(entry, bool) or not isinstance(entry, int | float)):
            raise InvalidInput(f"{text!r} is no list of numbers", remedy="write 0, 0, -9.81")
    return list(value)


def _number(text: str) -> float | int | str:
    cleaned = text.strip()
    if cleaned == TODO:
        return cleaned
    try:
        value = float(cleaned)
    except ValueError as error:
        raise InvalidInput(f"{cleaned!r} is not a number", remedy="use a point: 0.25") from error
    if not math.isfinite(value):
        raise InvalidInput(f"{cleaned!r} is not finite")
    is_integer = value.is_integer() and "." not in cleaned and "e" not in cleaned.lower()
    return int(value) if is_integer else value


Spring = Literal["linear", "three-slope"]
KNEES = ("gear_knee_t1", "gear_knee_t2")
FRICTION = ("motor_coulomb_friction", "motor_viscous_friction", "link_viscous_friction")


@dataclass(frozen=True, slots=True)
class Setting:
    """One slider of the virtual arm."""

    key: str
    title: str
    unit: str
    value: float
    low: float
    high: float
    step: float


SETTINGS = (
    Setting("disks", "Payload", "disks of 1 kg", 5, 0, MAX_DISKS, 1),
    Setting("stiffness", "Gear stiffness", "times the usual", 1.0, 0.5, 2.0, 0.05),
    Setting("knees", "Knee torques of the gears", "times the usual", 1.0, 0.5, 2.0, 0.05),
    Setting("friction", "Friction", "times the usual", 1.0, 0.0, 3.0, 0.05),
    Setting("amplitude", "Amplitude of the PRBS", "V", 10.0, 1.0, 10.0, 0.5),
    Setting("encoder_bits", "Resolution of the motor encoders", "bits per turn", 13, 10, 20, 1),
)
SENSORS = (
    ("accelerometers", "Accelerometers on the links", True),
    ("gyros", "Gyros on the links", True),
    ("link_encoders", "Encoders of the link angles (20 bits per turn)", False),
    ("noise", "Noise of the sensors", True),
)
_LINK_COUNTS = 2**20


@dataclass(frozen=True, slots=True)
class VirtualRig:
    """A study of the virtual arm, and its true parameters."""

    study: Study
    values: Values
    has_noise: bool


def virtual_rig(body: Any, folder: Path) -> VirtualRig:
    """The virtual arm with the settings of a request.

    Raises InvalidInput if a setting is missing or out of its range.
    """
    sizes = {setting.key: _size(body, setting) for setting in SETTINGS}
    sensors = {key: body.get(key) is True for key, _, _ in SENSORS}
    spring: Spring = "linear" if body.get("spring") == "linear" else "three-slope"
    values = {
        (name, joint): value * _factor(name, sizes)
        for (name, joint), value in SOFT.parameters(int(sizes["disks"]), spring).items()
    }
    study = SOFT.study(folder, spring)
    joints = tuple(
        replace(
            joint,
            encoder_counts=2 ** int(sizes["encoder_bits"]),
            accelerometer_distance=joint.accelerometer_distance
            if sensors["accelerometers"]
            else None,
            accelerometer_hz=joint.accelerometer_hz if sensors["accelerometers"] else None,
            gyro_hz=joint.gyro_hz if sensors["gyros"] else None,
            link_encoder_counts=_LINK_COUNTS if sensors["link_encoders"] else None,
        )
        for joint in study.arm.joints
    )
    experiments = tuple(
        replace(one, prbs=replace(one.prbs, amplitude=sizes["amplitude"])) if one.prbs else one
        for one in study.experiments
    )
    arm = replace(study.arm, joints=joints)
    return VirtualRig(replace(study, arm=arm, experiments=experiments), values, sensors["noise"])


def _size(body: Any, setting: Setting) -> float:
    value = body.get(setting.key, setting.value)
    if not isinstance(value, int | float) or not setting.low <= value <= setting.high:
        raise InvalidInput(
            f"{setting.title} is {value!r}",
            remedy=f"set {setting.low:g} to {setting.high:g} {setting.unit}",
        )
    return float(value)


def _factor(name: str, sizes: dict[str, float]) -> float:
    if is_slope(name):
        return sizes["stiffness"]
    if name in KNEES:
        return sizes["knees"]
    return sizes["friction"] if name in FRICTION else 1.0


def estimates_against_truth(study_path: Path, result: Path, truth: Path) -> list[dict[str, Any]]:
    """Each parameter of a result with its true value and its error."""
    values = derived(read_parameters(truth), read_study(study_path).arm)
    rows = []
    for entry in json.loads(result.read_bytes())["parameters"]:
        key = entry["name"], entry["joint"]
        if key not in values:
            continue
        true, value, std = values[key], entry["value"], entry["std"]
        error = None if value is None else value - true
        rows.append(
            {
                "label": label_of(*key),
                "unit": entry["unit"],
                "true": true,
                "value": value,
                "ci95": entry["ci95"],
                "percent": 100.0 * error / abs(true) if error is not None and true else None,
                "stds": error / std if error is not None and std else None,
            }
        )
    return rows
