"""Notes on the parts of an identified arm that an export format cannot hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum

from strainwave.domain import ArmDescription, Parameter
from strainwave.domain.base_parameters import link_inertia
from strainwave.domain.combinations import change_from
from strainwave.domain.effects import effect_named
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors import link_keys, sensor_constants
from strainwave.domain.parameter_table import base_name, family_of
from strainwave.export.source import IdentifiedArm


class Part(Enum):
    """A part of the model; a format states for each part that it cannot hold the reason."""

    MOTOR_INERTIA = "motor inertia"
    COUPLING = "inertial coupling"
    TRANSMISSION = "coupling of motors"
    GRAVITY = "gravity"
    GEAR = "gear spring and damping"
    VISCOUS = "viscous friction of motor and link"
    COULOMB = "Coulomb friction"
    OFFSET = "constant friction"
    SETTLING = "settling of Coulomb friction"
    EFFECTS = "further effects"
    DRIVE = "voltage to torque"
    SENSORS = "sensors"
    SERVO = "servo"
    UNCERTAINTY = "uncertainty"


_PART_OF = {
    "motor_inertia": Part.MOTOR_INERTIA,
    "motor_viscous_friction": Part.VISCOUS,
    "link_viscous_friction": Part.VISCOUS,
    "motor_coulomb_friction": Part.COULOMB,
    "friction_offset": Part.OFFSET,
    "friction_settling_time": Part.SETTLING,
}
_DRIVE_KEYS = ("torque_per_volt", "current_loop_hz")
_SENSOR_KEYS = ("encoder_counts", *link_keys())


def notes_of(arm: IdentifiedArm, reasons: Mapping[Part, str]) -> tuple[str, ...]:
    """One note per part of the arm that the format cannot represent: names, joints, reason."""
    parts = _parts_of(arm)
    return tuple(
        f"omitted: {parts[part]}: {reason}" for part, reason in reasons.items() if part in parts
    )


def sentence_of(note: str) -> str:
    """Note as a sentence."""
    return f"{note[:1].upper()}{note[1:]}."


CORRELATIONS = "omitted: correlations between parameters: see covariance in result.json"
"""Note of formats that contain standard deviations."""


def names_of(arm: IdentifiedArm, parts: Iterable[Part]) -> str:
    """Names of the values of the arm in some parts, in one list."""
    present = _parts_of(arm)
    return ", ".join(present[part] for part in parts if part in present)


def _parts_of(arm: IdentifiedArm) -> dict[Part, str]:
    """Each part that the arm has, with the names and joints of its values."""
    names: dict[Part, list[str]] = {}
    joints: dict[Part, list[int]] = {}

    def add(part: Part, name: str, joint: int | None) -> None:
        names.setdefault(part, []).append(name)
        joints.setdefault(part, []).extend([] if joint is None else [joint])

    for p in arm.parameters:
        part = _part_of(arm, p)
        effects = () if p.joint is None else arm.joint(p.joint).named_effects
        is_named = any(
            base_name(p.name) in effect_named(effect_name).names for effect_name in effects
        )
        if p.value is not None and part is not None and not is_named:
            add(part, base_name(p.name), p.joint)
    for number, joint in enumerate(arm.study.arm.joints, start=1):
        for effect in joint.named_effects:
            add(Part.EFFECTS, effect, number)
        for part, keys in ((Part.DRIVE, _DRIVE_KEYS), (Part.SENSORS, _SENSOR_KEYS)):
            for key in keys:
                if getattr(joint, key) is not None:
                    add(part, key, number)
    if arm.study.arm.gravity:
        add(Part.GRAVITY, "gravity", None)
    if arm.study.arm.is_coupled:
        add(Part.TRANSMISSION, "transmission", None)
    if arm.study.arm.servo is not None:
        add(Part.SERVO, "servo", None)
    add(Part.UNCERTAINTY, "standard deviations and correlations", None)
    return {part: _list_with_joints(names[part], joints[part]) for part in names}


def _part_of(arm: IdentifiedArm, p: Parameter) -> Part | None:
    """None if every format holds it: in bodies or matrices, or with other parameters."""
    name = base_name(p.name)
    if name in _PART_OF or name == "total_viscous_friction":
        return _PART_OF.get(name)
    if family_of(name) == "gravity":
        return Part.GRAVITY
    if family_of(name) == "inertia":
        return Part.COUPLING if _is_coupling((name, p.joint), arm.study.arm) else None
    gear_names = () if p.joint is None else arm.joint(p.joint).law.names
    if name in (*gear_names, "gear_stiffness", "gear_damping"):
        return Part.GEAR
    return Part.SENSORS if name in sensor_constants() else Part.EFFECTS


def _is_coupling(key: Key, arm: ArmDescription) -> bool:
    """Whether a parameter of the links couples joints: it moves several, or depends on posture."""
    joints = range(1, arm.n_joints + 1)
    posture = [float(joint) for joint in joints]  # any
    n_moved = sum(key in link_inertia(arm, joint) for joint in joints)
    return n_moved > 1 or any(key in change_from(arm, joint, posture) for joint in joints)


def _list_with_joints(names: Iterable[str], joints: Iterable[int]) -> str:
    numbers = sorted(set(joints))
    of = f" (joint {', '.join(map(str, numbers))})" if numbers else ""
    return ", ".join(dict.fromkeys(names)) + of
