"""The rigid part of an arm as URDF: bodies, joints, friction at the link, gears by their ratio."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from strainwave.domain.kinds.bodies import Body
from strainwave.export.bodies import holds_motor, known_of_gravity, link_bodies
from strainwave.export.markup import numbers, remark, root, to_bytes
from strainwave.export.source import Export, IdentifiedArm

_HARDWARE = "hardware_interface/EffortJointInterface"
_WIDE = "1e6"  # a study knows no limits, and a prismatic joint must have some


def to_urdf(arm: IdentifiedArm) -> Export:
    """URDF of the arm behind rigid gears (5).

    Parameters
    ----------
    arm : IdentifiedArm

    Returns
    -------
    Export

    Raises
    ------
    InvalidInput
        A parameter the model needs is null or impossible.
    """
    bodies = link_bodies(arm, arm.study.arm.gravity or 0.0)
    robot = root("robot", "name")
    remark(robot, "Of many masses with the same motion one set; see docs/export.md.")
    ET.SubElement(robot, "link", name="base")
    for number, body in enumerate(bodies, start=1):
        _link(robot, number, body)
        _joint(robot, arm, number)
    for number in range(1, arm.study.arm.n_joints + 1):
        _transmission(robot, arm, number)
    warnings = arm.warnings + arm.assumed() + known_of_gravity(arm)
    return Export(to_bytes(robot), warnings)


def _link(robot: ET.Element, number: int, body: Body) -> None:
    link = ET.SubElement(robot, "link", name=f"link{number}")
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=numbers(body.centre, 0.0, 0.0), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=numbers(body.mass))
    # a planar arm shows only izz
    diagonal = dict.fromkeys(("ixx", "iyy", "izz"), numbers(body.inertia))
    ET.SubElement(inertial, "inertia", {**diagonal, "ixy": "0", "ixz": "0", "iyz": "0"})


def _joint(robot: ET.Element, arm: IdentifiedArm, number: int) -> None:
    """The joint with its friction, the motor's seen from the link: d_M/n^2 + d_L, f_M/n."""
    sliding = arm.joint(number).motion == "prismatic"
    n = arm.joint(number).gear_ratio
    kind = "prismatic" if sliding else "continuous"
    joint = ET.SubElement(robot, "joint", name=f"joint{number}", type=kind)
    ET.SubElement(joint, "parent", link=f"link{number - 1}" if number > 1 else "base")
    ET.SubElement(joint, "child", link=f"link{number}")
    length = (arm.study.arm.link_length or 0.0) if number > 1 else 0.0
    ET.SubElement(joint, "origin", xyz=numbers(length, 0.0, 0.0), rpy="0 0 0")
    ET.SubElement(joint, "axis", xyz="1 0 0" if sliding else "0 0 1")
    viscous = arm.need("motor_viscous_friction", number) / n**2
    viscous += arm.need("link_viscous_friction", number)
    friction = arm.need("motor_coulomb_friction", number) / n
    ET.SubElement(joint, "dynamics", damping=numbers(viscous), friction=numbers(friction))
    if sliding:
        ET.SubElement(joint, "limit", lower=f"-{_WIDE}", upper=_WIDE, effort=_WIDE, velocity=_WIDE)


def _transmission(robot: ET.Element, arm: IdentifiedArm, number: int) -> None:
    """The gear's ratio; the motor's inertia, for which URDF has no place, in a comment."""
    transmission = ET.SubElement(robot, "transmission", name=f"transmission{number}")
    ET.SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
    joint = ET.SubElement(transmission, "joint", name=f"joint{number}")
    ET.SubElement(joint, "hardwareInterface").text = _HARDWARE
    actuator = ET.SubElement(transmission, "actuator", name=f"motor{number}")
    ET.SubElement(actuator, "hardwareInterface").text = _HARDWARE
    ratio = arm.joint(number).gear_ratio
    ET.SubElement(actuator, "mechanicalReduction").text = numbers(1.0 / ratio)
    inertia = arm.values.get(("motor_inertia", number))
    if inertia is not None and not holds_motor(arm):
        reflected = numbers(inertia / ratio**2)
        remark(actuator, f"motor inertia seen from the link, not in the link: {reflected} kg m^2")
