"""Names of parameters in options, values that follow from others, symbols and descriptions."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.arm.base_parameters import base_parameters
from strainwave.domain.arm.description import ArmDescription
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.link_sensors import SensorConstant, sensor_constants
from strainwave.domain.arm.parameter_table import ParameterDescription, parameter_table
from strainwave.domain.keys import Values
from strainwave.errors import InvalidInput


def whole_arm_parameter_names(arm: ArmDescription) -> tuple[str, ...]:
    """Parameter names that the options of the whole-arm fit accept.

    They are names of the arm and of all joints, "gear_stiffness", or of one joint, "gear_stiffness
    1".
    """
    links = base_parameters(arm).effective
    names = [name for name, joint in links if joint is None]
    joints_by_name: dict[str, list[int]] = {}
    for number, joint in enumerate(arm.joints, start=1):
        joint_names = ["motor_inertia", "motor_viscous_friction", "motor_coulomb_friction"]
        joint_names += ["friction_offset", "link_viscous_friction", STIFFNESS, "gear_damping"]
        joint_names += [name for name, owner in links if owner == number]
        for name in dict.fromkeys((*joint_names, *joint.law.names)):
            joints_by_name.setdefault(name, []).append(number)
    for name, numbers in joints_by_name.items():
        names += [name, *(f"{name} {number}" for number in numbers)]
    return tuple(names)


def with_known_constants(arm: ArmDescription, values: Values) -> ArmDescription:
    """The arm with what `values` determine and the study leaves open.

    These are the torques per volt of unknown drives, and the laws of gears with `spring = "auto"`.
    Raises InvalidInput if a torque per volt is missing.
    """
    arm = arm.with_selected_laws(values.keys())
    for number in arm.unknown_drives:
        gain = values.get(("torque_per_volt", number))
        if gain is None:
            raise InvalidInput(
                f"the torque_per_volt of joint {number} is unknown",
                where="--parameters",
                remedy="add it to the parameters, or set it in the study",
            )
        arm = arm.with_joint(number, torque_per_volt=gain)
    return arm


def complete_values(values: Values, arm: ArmDescription) -> Values:
    """Identified values and those that follow from them, as a simulation of the arm needs them.

    A sum replaces its parts if the parts have little separate effect: `total_viscous_friction` for
    the motor's, one `gear_stiffness` for all slopes of a gear, and, with a rigid gear, `inertia` or
    `rigid_inertia` for motor and link. The arm's kind completes the link inertias. Existing values
    do not change.
    """
    known = dict(values)
    for number, joint in enumerate(arm.joints, start=1):
        total = known.get(("total_viscous_friction", number))
        if total is not None:
            link = known.setdefault(("link_viscous_friction", number), 0.0)
            of_motor = total - joint.gear_ratio**2 * link
            known.setdefault(("motor_viscous_friction", number), of_motor)
        if not joint.elastic:
            known.setdefault(("link_viscous_friction", number), 0.0)
        if (STIFFNESS, number) in known:
            for name, value in joint.law.straight(known[STIFFNESS, number]).items():
                known.setdefault((name, number), value)
    kind_of(arm).complete(known, arm)
    return known


def parameter_descriptions() -> Mapping[str, ParameterDescription | SensorConstant]:
    """Parameters and sensor constants in results by name, with symbol and description."""
    return {
        **parameter_table(),
        **{name: c for name, c in sensor_constants().items() if c.description},
    }
