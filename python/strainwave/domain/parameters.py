"""Values of an arm's parameters: units, names in options, and what follows from them."""

from __future__ import annotations

from strainwave.domain.arm import ArmDescription, Joint
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.kinds import Values, kind_of
from strainwave.domain.parameter_table import base_name, parameter_table

__all__ = [
    "SENSOR_PARAMETERS",
    "Values",
    "completed",
    "unit_of",
    "whole_arm_parameters",
]

SENSOR_PARAMETERS = (
    "accelerometer_delay",
    "accelerometer_scale",
    "gyro_delay",
    "gyro_scale",
    "link_encoder_delay",
    "accelerometer_bandwidth",
    "accelerometer_tilt",
    "gyro_bandwidth",
    "imu_accelerometer_delay",
    "imu_accelerometer_bandwidth",
    "imu_gyro_delay",
    *(f"imu_{axis}_scale" for axis in ("ax", "ay", "az", "gx", "gy", "gz")),
    "imu_gyro_bandwidth",
    *(
        f"{sensor}_mount_{what}"
        for sensor in ("accelerometer", "gyro", "imu_accelerometer", "imu_gyro")
        for what in ("frequency", "damping")
    ),
    "accelerometer_drift",
    "gyro_drift",
    *(f"imu_{axis}_drift" for axis in ("ax", "ay", "az", "gx", "gy", "gz")),
)
"""Constants of link sensors that the whole-arm fit estimates where the records show them."""


def unit_of(name: str, joint: Joint | None = None) -> str:
    """The SI unit of a parameter.

    `name`: As in docs/notation.md. `joint`: Whose it is; None: the arm's. Raises `KeyError`: There
    is no parameter of that name.
    """
    return parameter_table()[base_name(name)].units[
        joint is not None and joint.motion == "prismatic"
    ]


def whole_arm_parameters(arm: ArmDescription) -> tuple[str, ...]:
    """Names that the options of the whole-arm fit may use: of all joints, and of each on its own.

    Returns: "beta", "gear_stiffness", "gear_stiffness 1", ...
    """
    inertias = kind_of(arm).inertias
    names = [name for name, joint in inertias if joint is None]
    if arm.gravity is not None:
        names += [f"gravity_torque_{i}" for i in range(1, arm.n_joints + 1)]
    of_joints: dict[str, list[int]] = {}
    for number, joint in enumerate(arm.joints, start=1):
        own = ["motor_inertia", "motor_viscous_friction", "motor_coulomb_friction"]
        own += ["friction_offset", "link_viscous_friction", STIFFNESS, "gear_damping"]
        own += [name for name, of in inertias if of == number]
        for name in dict.fromkeys((*own, *joint.law.names)):
            of_joints.setdefault(name, []).append(number)
    for name, numbers in of_joints.items():
        names += [name, *(f"{name} {number}" for number in numbers)]
    return tuple(names)


def completed(values: Values, arm: ArmDescription) -> Values:
    """What an arm needs for being simulated, made of what an identification found.

    A sum stands for its parts where they hardly matter apart: `total_viscous_friction` for the
    motor's, where that is not known; one `gear_stiffness` for all slopes of a gear; and
    where motor and link only ever move together, `inertia` or `rigid_inertia` for both. The links'
    inertias follow as their kind of arm has it.

    `values`: (name, joint) -> value. Returns: With what follows added; nothing that was there is
    changed.
    """
    known = dict(values)
    for number, joint in enumerate(arm.joints, start=1):
        _complete_joint(known, number, joint)
    kind_of(arm).complete(known, arm)
    return known


def _complete_joint(known: Values, number: int, joint: Joint) -> None:
    n2 = joint.gear_ratio**2
    total = known.get(("total_viscous_friction", number))
    if total is not None:
        link = known.setdefault(("link_viscous_friction", number), 0.0)
        known.setdefault(("motor_viscous_friction", number), total - n2 * link)
    if not joint.elastic:
        known.setdefault(("link_viscous_friction", number), 0.0)
    if (STIFFNESS, number) in known:
        for name, value in joint.law.straight(known[STIFFNESS, number]).items():
            known.setdefault((name, number), value)
