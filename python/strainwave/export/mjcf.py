"""An arm for MuJoCo: motors and links as bodies of their own, gears as tendons between them.

Motors rotate relative to the world: (1) neglects the motion of the link that carries them. Where a
transmission couples joints, a gear's tendon extends over all its motors. A motor behind a rigid
gear is part of its joint, or, if it turns with several joints, a tendon over them.
"""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree import ElementTree as ET

from strainwave.domain import Diagnostic, FloatArray
from strainwave.domain.arm.combinations import is_rigid_drive
from strainwave.domain.arm.description import Vector
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.kinds.base import Body
from strainwave.domain.arm.link_sensors import SensorAxis, installed_axes
from strainwave.domain.arm.link_sensors.imu import IMU_ATTITUDE, IMU_POSITION
from strainwave.domain.arm.link_sensors.link_space import axes_about, link_space
from strainwave.domain.arm.link_sensors.single_axis import Accelerometer, Gyro
from strainwave.export import completion, source
from strainwave.export import mjcf_drives as drives
from strainwave.export.linear_models import Coordinates, coordinates_of
from strainwave.export.mjcf_drives import STEP_S, Target
from strainwave.export.read_back import by_mujoco
from strainwave.export.source import Export, IdentifiedArm, numbers

_LINK_RADIUS = 0.02  # [m] of the drawn links
_HELD = (
    *(*source.LINEAR, "motor_coulomb_friction", "friction_offset", "friction_settling_time"),
    *("torque_per_volt", "current_loop_hz", source.SENSORS),
)


def to_mjcf(arm: IdentifiedArm, target: Target | None = None) -> Export:
    """MuJoCo model of the arm (1), (2) for a version of MuJoCo; by default the newest.

    Controls are voltages, or motor torques if the study has no `torque_per_volt`, or angles of the
    joints if it has a position servo. Raises `InvalidInput` if a parameter that the model needs is
    missing or not physical.
    """
    target = target or Target()
    joints = list(enumerate(arm.study.arm.joints, start=1))
    gravity = completion.effective_gravity(arm)
    bodies = completion.link_bodies(arm, gravity)
    coordinates = coordinates_of(arm.study.arm)
    rigid = [i for i, joint in joints if not joint.elastic]
    # motors behind rigid gears that turn with several joints
    shared = [i for i in rigid if not coordinates.has_own_motor(i)]
    losses = _losses(arm, target, shared)
    of_servo = [drives.NOTE_OF_HOLD] if arm.study.arm.position_servo else []
    notes = (*arm.assumptions, *of_servo, *source.loss_note(losses))
    mujoco = ET.Element("mujoco", model="arm")
    origin = "Identified by strainwave. SI units, angles in rad."
    for text in (origin, *map(source.sentence_of, notes)):
        _comment(mujoco, text)
    ET.SubElement(mujoco, "compiler", angle="radian", eulerseq="XYZ")  # as rpy in URDF
    note = kind_of(arm.study.arm).gravity_note
    if gravity and note:
        _comment(mujoco, f"Gravity is {note}, which gives the measured gravity torques.")
    option = ET.SubElement(mujoco, "option", timestep=numbers(STEP_S), integrator="RK4")
    option.set("gravity", numbers(*(completion.chain_of(arm, gravity).gravity or (0.0, 0.0, 0.0))))
    world = ET.SubElement(mujoco, "worldbody")
    _comment(world, "One of many sets of masses with the same motion; see docs/export.md.")
    parent = world
    for number, body in enumerate(bodies, start=1):
        parent = _link(parent, arm, number, body, coordinates)
    for number in coordinates.elastic:
        _motor(world, arm, number)
    on_cables = [i for i, _ in joints if drives.has_effect(arm, i, "ground-spring")]
    if coordinates.elastic or shared or on_cables:
        tendons = ET.SubElement(mujoco, "tendon")
        for torsion, number in zip(coordinates.torsions, coordinates.elastic, strict=True):
            drives.add_gear(tendons, arm, number, _terms(arm, coordinates, torsion), target)
        for number in shared:
            angle = coordinates.motor_angles[number - 1]
            terms = _terms(arm, coordinates, angle)
            drives.add_shared_motor(tendons, arm, number, terms, target)
        for number in on_cables:
            drives.add_ground_spring(tendons, arm, number)
    actuators = ET.SubElement(mujoco, "actuator")
    for number, _ in joints:
        drives.add_actuator(actuators, arm, number, target, is_shared=number in shared)
    sensors = ET.SubElement(mujoco, "sensor")
    names = "Named as channels: a is the second component, gyro the third, imu_a is ax, ay, az."
    _comment(sensors, names)
    for number, _ in joints:
        _sensors(sensors, arm, number, is_shared=number in shared)
    warnings = arm.assumed() + drives.approximations(arm, target)
    of_version = drives.note_of_version(mujoco)
    for k, note in enumerate(of_version, start=1):
        mujoco.insert(k, ET.Comment(f" {source.sentence_of(note)} "))
    ET.indent(mujoco)
    data: bytes = ET.tostring(mujoco, encoding="utf-8", xml_declaration=True)
    return Export(
        data + b"\n",
        warnings + completion.gravity_warnings(arm),
        (*notes, *of_version),
        losses,
        by_mujoco,
    )


def _losses(arm: IdentifiedArm, target: Target, shared: list[int]) -> tuple[Diagnostic, ...]:
    """Parts that the file lacks; motors `shared` turn with several joints."""
    held, losses_of_values = drives.losses_of_effects(arm, target)
    held |= set(drives.SERVO_PARAMETERS) if arm.study.arm.position_servo else set()
    losses = [*source.losses(arm, (*_HELD, *held)), *losses_of_values]
    losses += drives.losses_by_version(arm, target, shared)
    joints = enumerate(arm.study.arm.joints, start=1)
    if unplaced := [i for i, joint in joints if joint.imu and _mounting(arm, i) is None]:
        losses.append(source.loss("IMU at an unknown place", unplaced))
    return tuple(losses)


def _comment(parent: ET.Element, text: str) -> None:
    parent.append(ET.Comment(f" {source.comment_text(text)} "))


def _terms(
    arm: IdentifiedArm, coordinates: Coordinates, weights: FloatArray
) -> tuple[tuple[str, float], ...]:
    """The joints of a tendon with their coefficients, from weights of the coordinates."""
    names = [f"motor_joint{number}" for number in coordinates.elastic]
    names += arm.study.arm.joint_names
    pairs = zip(names, weights.tolist(), strict=True)
    return tuple((name, weight) for name, weight in pairs if weight)


def _link(
    parent: ET.Element, arm: IdentifiedArm, number: int, body: Body, coordinates: Coordinates
) -> ET.Element:
    """One link and its joint, which includes its own motor if the gear is rigid."""
    origin = arm.joint(number).origin
    element = ET.SubElement(parent, "body", name=f"link{number}", pos=numbers(*origin.xyz))
    if any(origin.rpy):
        element.set("euler", numbers(*origin.rpy))
    _inertial(element, body)
    joint = arm.joint(number)
    attributes = {
        "name": arm.study.arm.joint_names[number - 1],
        "type": "slide" if joint.motion == "prismatic" else "hinge",
        "axis": numbers(*joint.axis),
    }
    viscous = arm.need("link_viscous_friction", number)
    attributes["damping"] = numbers(viscous)
    if not joint.elastic and coordinates.has_own_motor(number):
        attributes |= drives.motor_friction(arm, number, "springref", joint.gear_ratio, viscous)
        if not is_rigid_drive(arm.study.arm):
            inertia = arm.need("motor_inertia", number) / joint.gear_ratio**2
            attributes["armature"] = numbers(inertia)
    ET.SubElement(element, "joint", attributes)
    x, y, _ = axes_about(joint.axis)
    for axis, tag, _ in _installed(arm, number):
        site = ET.SubElement(element, "site", name=f"{tag}{number}")
        if isinstance(axis.sensor, Accelerometer):
            site.set("pos", numbers(*((joint.accelerometer_distance or 0.0) * x)))
        if joint.axis != (0.0, 0.0, 1.0):
            site.set("xyaxes", numbers(*x, *y))
    mounting = _mounting(arm, number)
    if mounting is not None:
        xyz, rpy = mounting
        ET.SubElement(
            element,
            "site",
            name=f"imu{number}",
            pos=numbers(*xyz),
            euler=numbers(*rpy),
        )
    following = arm.study.arm.joints[number:]
    end = following[0].origin.xyz if following else tuple(2.0 * part for part in body.centre)
    fromto = numbers(0, 0, 0, *(end if any(end) else (10.0 * _LINK_RADIUS, 0, 0)))
    drawn = {"type": "capsule", "fromto": fromto, "size": numbers(_LINK_RADIUS)}
    ET.SubElement(element, "geom", drawn, contype="0", conaffinity="0")
    return element


def _motor(world: ET.Element, arm: IdentifiedArm, number: int) -> None:
    """A motor with its friction; its axis passes through its centre of mass."""
    inertia, ratio = arm.need("motor_inertia", number), arm.joint(number).gear_ratio
    inertia -= ratio**2 * drives.inertia_of_hold(arm, number, inertia / ratio**2)
    element = ET.SubElement(world, "body", name=f"motor{number}")
    _inertial(element, Body.in_plane(inertia, 0.0, inertia))
    # also the motor of a prismatic joint turns; gravity would pull a slide
    hinge = {"type": "hinge", "axis": numbers(*arm.joint(number).axis)}
    hinge |= drives.motor_friction(arm, number, "springref")
    ET.SubElement(element, "joint", hinge, name=f"motor_joint{number}")


def _inertial(element: ET.Element, body: Body) -> None:
    mass, centre = numbers(body.mass), numbers(*body.centre)
    inertia = numbers(*body.inertia)
    ET.SubElement(element, "inertial", pos=centre, mass=mass, fullinertia=inertia)


def _sensors(sensors: ET.Element, arm: IdentifiedArm, number: int, *, is_shared: bool) -> None:
    """Channels of a joint: drive and link sensors.

    The accelerometer measures specific force (8), (9). The torque is that of the actuator, which
    includes the friction offset.
    """
    link = arm.study.arm.joint_names[number - 1]
    if is_shared or arm.joint(number).elastic:
        motor = {"tendon": f"motor{number}"} if is_shared else {"joint": f"motor_joint{number}"}
        kind = next(iter(motor))
        ET.SubElement(sensors, f"{kind}pos", {"name": f"theta_m{number}", **motor})
        ET.SubElement(sensors, f"{kind}vel", {"name": f"omega_m{number}", **motor})
    ET.SubElement(
        sensors, "actuatorfrc", name=f"torque{number}", actuator=drives.actuator_name(arm, number)
    )
    ET.SubElement(sensors, "jointpos", name=f"theta_l{number}", joint=link)
    if _mounting(arm, number) is not None:
        for name, tag in (("imu_a", "accelerometer"), ("imu_g", "gyro")):
            ET.SubElement(sensors, tag, name=f"{name}{number}", site=f"imu{number}")
    for axis, site, tag in _installed(arm, number):
        ET.SubElement(sensors, tag, name=axis.channel, site=f"{site}{number}")


def _installed(arm: IdentifiedArm, number: int) -> Iterator[tuple[SensorAxis, str, str]]:
    """Sensors of a revolute joint's link that the file describes: axis, site, and element."""
    if arm.joint(number).motion == "revolute":
        for axis in installed_axes(arm.study.arm, number, ()):
            if isinstance(axis.sensor, Accelerometer):
                yield axis, "accelerometer", "accelerometer"
            elif isinstance(axis.sensor, Gyro):
                yield axis, "gyroscope", "gyro"


def _mounting(arm: IdentifiedArm, number: int) -> tuple[Vector, Vector] | None:
    """Position and attitude of a link's IMU, given or identified; None if a part is unknown.

    A coordinate along the only axis of the link, which changes no reading, is zero.
    """
    imu = arm.joint(number).imu
    if imu is None:
        return None
    free = link_space(arm.study.arm, number).free_coordinates
    position = [arm.values.get((name, number)) for name in IMU_POSITION]
    xyz = imu.xyz or tuple(0.0 if k not in free else x for k, x in enumerate(position))
    rpy = imu.rpy or tuple(arm.values.get((name, number)) for name in IMU_ATTITUDE)
    return None if None in (*xyz, *rpy) else (xyz, rpy)  # type: ignore[return-value]
