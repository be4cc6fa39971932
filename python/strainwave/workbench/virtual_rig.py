"""The built-in virtual arm with the settings of a page, and its estimate against the truth."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from strainwave.domain import Study
from strainwave.domain.gear_laws import is_slope
from strainwave.domain.keys import Values, label_of
from strainwave.errors import InvalidInput
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study
from strainwave.virtual.experiments import derived
from strainwave.virtual.scara import MAX_DISKS, SOFT

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
