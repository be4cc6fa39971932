"""The built-in arm with other payloads, gears, friction and sensors, within limits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from strainwave.domain import Parameter, Spring, Study
from strainwave.domain.arm.gear_laws import is_slope
from strainwave.domain.keys import Values, label_of
from strainwave.errors import InvalidInput
from strainwave.virtual.scara import MAX_DISKS, SOFT

KNEES = ("gear_knee_t1", "gear_knee_t2")
FRICTION = ("motor_coulomb_friction", "motor_viscous_friction", "link_viscous_friction")


@dataclass(frozen=True, slots=True)
class Setting:
    """A number that may be set."""

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
    """A study of the built-in arm, and its true parameters."""

    study: Study
    values: Values
    has_noise: bool


def virtual_rig(chosen: Mapping[str, object], folder: Path) -> VirtualRig:
    """The arm with settings by key, those of `SETTINGS`, `SENSORS` and "spring".

    Raises InvalidInput if a setting is out of its range.
    """
    sizes = {setting.key: _size(chosen, setting) for setting in SETTINGS}
    sensors = {key: chosen.get(key) is True for key, _, _ in SENSORS}
    spring: Spring = "linear" if chosen.get("spring") == "linear" else "three-slope"
    values = SOFT.parameters(int(sizes["disks"]), spring)
    for name, joint in values:
        if is_slope(name):
            values[name, joint] *= sizes["stiffness"]
        elif name in KNEES:
            values[name, joint] *= sizes["knees"]
        elif name in FRICTION:
            values[name, joint] *= sizes["friction"]
    study = SOFT.study(folder, spring)
    absent: dict[str, Any] = {} if sensors["gyros"] else {"gyro_hz": None}
    if not sensors["accelerometers"]:
        absent |= {"accelerometer_distance": None, "accelerometer_hz": None}
    joints = tuple(
        replace(
            joint,
            encoder_counts=2 ** int(sizes["encoder_bits"]),
            link_encoder_counts=_LINK_COUNTS if sensors["link_encoders"] else None,
            **absent,
        )
        for joint in study.arm.joints
    )
    experiments = tuple(
        replace(one, prbs=replace(one.prbs, amplitude=sizes["amplitude"])) if one.prbs else one
        for one in study.experiments
    )
    arm = replace(study.arm, joints=joints)
    return VirtualRig(replace(study, arm=arm, experiments=experiments), values, sensors["noise"])


def _size(chosen: Mapping[str, object], setting: Setting) -> float:
    value = chosen.get(setting.key, setting.value)
    if not isinstance(value, int | float) or not setting.low <= value <= setting.high:
        raise InvalidInput(
            f"{setting.title} is {value!r}",
            remedy=f"set {setting.low:g} to {setting.high:g} {setting.unit}",
        )
    return float(value)


def errors_of(estimates: Iterable[Parameter], truth: Values) -> list[dict[str, Any]]:
    """Each estimate with its true value and its error, in percent and in standard deviations."""
    rows = []
    for each in estimates:
        if each.key not in truth:
            continue
        true, value, std = truth[each.key], each.value, each.std
        error = None if value is None else value - true
        rows.append(
            {
                "label": label_of(*each.key),
                "unit": each.unit,
                "true": true,
                "value": value,
                "ci95": each.ci95,
                "percent": 100.0 * error / abs(true) if error is not None and true else None,
                "stds": error / std if error is not None and std else None,
            }
        )
    return rows
