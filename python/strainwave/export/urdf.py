"""The rigid part of an arm as URDF: bodies, joints, friction at the link, gear ratios."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from strainwave.domain.kinds.bodies import Body
from strainwave.export.bodies import gravity_warnings, holds_motor, link_bodies
from strainwave.export.markup import comment, numbers, root, to_bytes
from strainwave.export.omissions import Part, notes_of
from strainwave.export.source import Export, IdentifiedArm

_HARDWARE = "hardware_interface/EffortJointInterface"
_NO_LIMIT = "1e6"  # a study has no limits, but URDF requires them of a prismatic joint
_OMISSIONS = {
    Part.MOTOR_INERTIA: "URDF has no motor inertia; a comment in each transmission gives its value "
    "at the link, motor_inertia/gear_ratio^2, to add as armature or rotor inertia in a simulator",
    Part.GEAR: "joints are rigid in URDF",
    Part.VISCOUS: "URDF has one damping per joint, their sum at the link",
    Part.OFFSET: "URDF friction is viscous and Coulomb friction",
    Part.SETTLING: "URDF friction is viscous and Coulomb friction",
    Part.EFFECTS: "URDF has no element for them",
    Part.GRAVITY: "gravity is set in the simulator; masses have the measured gravity torques if it "
    "acts as in the study",
    Part.DRIVE: "the effort of a URDF joint is the torque at the link",
    Part.SENSORS: "URDF has no sensors",
    Part.SERVO: "URDF has no controllers",
    Part.UNCERTAINTY: "see result.json",
}


def to_urdf(arm: IdentifiedArm) -> Export:
    """URDF of the arm behind rigid gears (5); `InvalidInput` if a needed parameter is missing."""
    bodies = link_bodies(arm, arm.study.arm.gravity_size)
    reasons = dict(_OMISSIONS)
    if holds_motor(arm):  # the inertia of the link includes it
        del reasons[Part.MOTOR_INERTIA]
    notes = notes_of(arm, reasons)
    robot = root("robot", "name", notes)
    comment(robot, "One of many sets of masses with the same motion; see docs/export.md.")
    ET.SubElement(robot, "link", name="base")
    for number, body in enumerate(bodies, start=1):
        _link(robot, number, body)
        _joint(robot, arm, number)
    for number in range(1, arm.study.arm.n_joints + 1):
        _transmission(robot, arm, number)
    warnings = arm.warnings + arm.assumed() + gravity_warnings(arm)
    return Export(to_bytes(robot), warnings, notes)


def _link(robot: ET.Element, number: int, body: Body) -> None:
    link = ET.SubElement(robot, "link", name=f"link{number}")
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=numbers(*body.centre), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=numbers(body.mass))
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    ET.SubElement(inertial, "inertia", dict(zip(names, map(numbers, body.inertia), strict=True)))


def _joint(robot: ET.Element, arm: IdentifiedArm, number: int) -> None:
    """A joint with friction at the link: d_M/n^2 + d_L and f_M/n."""
    is_prismatic = arm.joint(number).motion == "prismatic"
    n = arm.joint(number).gear_ratio
    kind = "prismatic" if is_prismatic else "continuous"
    joint = ET.SubElement(robot, "joint", name=f"joint{number}", type=kind)
    ET.SubElement(joint, "parent", link=f"link{number - 1}" if number > 1 else "base")
    ET.SubElement(joint, "child", link=f"link{number}")
    origin = arm.joint(number).origin
    ET.SubElement(joint, "origin", xyz=numbers(*origin.xyz), rpy=numbers(*origin.rpy))
    ET.SubElement(joint, "axis", xyz=numbers(*arm.joint(number).axis))
    viscous = arm.need("motor_viscous_friction", number) / n**2
    viscous += arm.need("link_viscous_friction", number)
    friction = arm.need("motor_coulomb_friction", number) / abs(n)
    ET.SubElement(joint, "dynamics", damping=numbers(viscous), friction=numbers(friction))
    if is_prismatic:
        limits = dict.fromkeys(("upper", "effort", "velocity"), _NO_LIMIT)
        ET.SubElement(joint, "limit", limits, lower=f"-{_NO_LIMIT}")


def _transmission(robot: ET.Element, arm: IdentifiedArm, number: int) -> None:
    """The gear ratio, and the motor inertia at the link as a comment."""
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
        comment(actuator, f"motor inertia at the link, not part of the link: {reflected} kg m^2")
