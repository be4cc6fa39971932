"""An arm for MuJoCo: motors and links as bodies of their own, gears as tendons between them.

A fixed tendon over motor and link joint with coefficients n and -1 has the length
delta = n theta_M - theta_L; its stiffness and damping act on both sides as in (1) and (2). A tendon
with a slack range acts beyond the range only, so parallel tendons give a law whose slope changes at
knees. Motors rotate relative to the world: (1) neglects the motion of the link that carries them.
Where a transmission couples joints, a gear's tendon extends over all its motors. A motor behind a
rigid gear is part of its joint, or, if it turns with several joints, a tendon over them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import partial
from xml.etree import ElementTree as ET

from strainwave.domain import Diagnostic, FloatArray, Joint, Place
from strainwave.domain.arm.combinations import is_rigid_drive
from strainwave.domain.arm.description import Vector
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.kinds.base import Body
from strainwave.domain.arm.link_sensors import SensorAxis, installed_axes
from strainwave.domain.arm.link_sensors.imu import IMU_ATTITUDE, IMU_POSITION
from strainwave.domain.arm.link_sensors.link_space import axes_about, link_space
from strainwave.domain.arm.link_sensors.single_axis import Accelerometer, Gyro
from strainwave.export import completion, source
from strainwave.export.linear_models import Coordinates, coordinates_of
from strainwave.export.read_back import by_mujoco
from strainwave.export.source import Export, IdentifiedArm, numbers

_STEP_S = 1e-4  # [s] time step; Coulomb friction, a constraint, takes two steps to stop a motor
_FAR = 1e9  # [rad or m] of a spring: its force is constant to 1e-9 per radian
_LINK_RADIUS = 0.02  # [m] of the drawn links
_HELD = (
    *(*source.LINEAR, "motor_coulomb_friction", "friction_offset", "friction_settling_time"),
    *("torque_per_volt", "current_loop_hz", source.SENSORS),
)


def to_mjcf(arm: IdentifiedArm) -> Export:
    """MuJoCo model of the arm (1), (2).

    Controls are voltages, or motor torques if the study has no `torque_per_volt`. Raises
    `InvalidInput` if a parameter that the model needs is missing or not physical.
    """
    losses = source.losses(arm, _HELD)
    joints = enumerate(arm.study.arm.joints, start=1)
    unplaced = [i for i, joint in joints if joint.imu and _mounting(arm, i) is None]
    if unplaced:
        losses += (source.loss("IMU at an unknown place", unplaced),)
    notes = (*arm.assumptions, *source.loss_note(losses))
    gravity = completion.effective_gravity(arm)
    bodies = completion.link_bodies(arm, gravity)
    coordinates = coordinates_of(arm.study.arm)
    mujoco = ET.Element("mujoco", model="arm")
    origin = "Identified by strainwave. SI units, angles in rad."
    for text in (origin, *map(source.sentence_of, notes)):
        _comment(mujoco, text)
    ET.SubElement(mujoco, "compiler", angle="radian", eulerseq="XYZ")  # as rpy in URDF
    note = kind_of(arm.study.arm).gravity_note
    if gravity and note:
        _comment(mujoco, f"Gravity is {note}, which gives the measured gravity torques.")
    option = ET.SubElement(mujoco, "option", timestep=numbers(_STEP_S), integrator="RK4")
    option.set("gravity", numbers(*(completion.chain_of(arm, gravity).gravity or (0.0, 0.0, 0.0))))
    world = ET.SubElement(mujoco, "worldbody")
    _comment(world, "One of many sets of masses with the same motion; see docs/export.md.")
    parent = world
    for number, body in enumerate(bodies, start=1):
        parent = _link(parent, arm, number, body, coordinates)
    for number in coordinates.elastic:
        _motor(world, arm, number)
    # motors behind rigid gears that turn with several joints
    numbers_of_joints = range(1, arm.study.arm.n_joints + 1)
    rigid = [i for i in numbers_of_joints if not arm.joint(i).elastic]
    shared = [i for i in rigid if not coordinates.has_own_motor(i)]
    if coordinates.elastic or shared:
        tendons = ET.SubElement(mujoco, "tendon")
        for torsion, number in zip(coordinates.torsions, coordinates.elastic, strict=True):
            _gear(tendons, arm, number, _terms(arm, coordinates, torsion))
        for number in shared:
            angle = coordinates.motor_angles[number - 1]
            _shared_motor(tendons, arm, number, _terms(arm, coordinates, angle))
    actuators = ET.SubElement(mujoco, "actuator")
    for number in numbers_of_joints:
        _actuator(actuators, arm, number, is_shared=number in shared)
    sensors = ET.SubElement(mujoco, "sensor")
    names = "Named as channels: a is the second component, gyro the third, imu_a is ax, ay, az."
    _comment(sensors, names)
    for number in numbers_of_joints:
        _sensors(sensors, arm, number, is_shared=number in shared)
    warnings = arm.assumed() + _approximations(arm)
    ET.indent(mujoco)
    data: bytes = ET.tostring(mujoco, encoding="utf-8", xml_declaration=True)
    return Export(
        data + b"\n", warnings + completion.gravity_warnings(arm), notes, losses, by_mujoco
    )


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
        attributes |= _motor_friction(arm, number, "springref", joint.gear_ratio, viscous)
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
    inertia = arm.need("motor_inertia", number)
    element = ET.SubElement(world, "body", name=f"motor{number}")
    _inertial(element, Body.in_plane(inertia, 0.0, inertia))
    # also the motor of a prismatic joint turns; gravity would pull a slide
    hinge = {"type": "hinge", "axis": numbers(*arm.joint(number).axis)}
    hinge |= _motor_friction(arm, number, "springref")
    ET.SubElement(element, "joint", hinge, name=f"motor_joint{number}")


def _inertial(element: ET.Element, body: Body) -> None:
    mass, centre = numbers(body.mass), numbers(*body.centre)
    inertia = numbers(*body.inertia)
    ET.SubElement(element, "inertial", pos=centre, mass=mass, fullinertia=inertia)


def _motor_friction(
    arm: IdentifiedArm, number: int, rest: str, ratio: float = 1.0, of_link: float = 0.0
) -> dict[str, str]:
    """Attributes for the friction of a motor at an element that turns `ratio` times as fast.

    `of_link` is the viscous friction of the element itself. The time constant of the friction
    constraint is twice the settling time (S9). The offset is a soft spring that is far from its
    rest, the attribute `rest`: -stiffness (q - rest). It is a passive force, so that inverse
    dynamics contain it.
    """
    higher = [arm.values.get((name, number), 0.0) for name in completion.DAMPING]
    powers = [arm.need("motor_viscous_friction", number), *(higher if any(higher) else ())]
    turns = 1.0 / abs(ratio)
    damping = [coefficient * turns ** (k + 2) for k, coefficient in enumerate(powers)]
    damping[0] += of_link
    settling = arm.values.get(("friction_settling_time", number), 0.0)
    attributes = {
        "damping": numbers(*damping),
        "frictionloss": numbers(arm.need("motor_coulomb_friction", number) / abs(ratio)),
        "solreffriction": numbers(max(2.0 * settling, 2.0 * _STEP_S), 1.0),
        "solimpfriction": "0.9999 0.9999 0.001",
    }
    offset = arm.values.get(("friction_offset", number), 0.0) / ratio
    if offset:
        attributes["stiffness"] = numbers(abs(offset) / _FAR)
        attributes[rest] = numbers(-math.copysign(_FAR, offset))
    return attributes


def _gear(
    tendons: ET.Element, arm: IdentifiedArm, number: int, terms: Iterable[tuple[str, float]]
) -> None:
    """The spring as parallel tendons, one per slope (1); the first has the damping."""
    law = arm.joint(number).law
    springs = law.parallel_springs(partial(arm.need, joint=number))
    if springs is None:
        springs = ((arm.need(law.linearised_by, number), 0.0),)
    for part, (stiffness, slack) in enumerate(springs, start=1):
        name = f"gear{number}" if part == 1 else f"gear{number}_beyond_t{part - 1}"
        fixed = ET.SubElement(tendons, "fixed", name=name, stiffness=numbers(stiffness))
        fixed.set("springlength", numbers(-slack, slack) if slack else "0")
        if part == 1:
            fixed.set("damping", numbers(arm.need("gear_damping", number)))
        _add_terms(fixed, terms)


def _shared_motor(
    tendons: ET.Element, arm: IdentifiedArm, number: int, terms: Iterable[tuple[str, float]]
) -> None:
    """A motor behind a rigid gear that turns with several joints."""
    attributes = {"name": f"motor{number}", **_motor_friction(arm, number, "springlength")}
    if not is_rigid_drive(arm.study.arm):
        attributes["armature"] = numbers(arm.need("motor_inertia", number))
    _add_terms(ET.SubElement(tendons, "fixed", attributes), terms)


def _add_terms(fixed: ET.Element, terms: Iterable[tuple[str, float]]) -> None:
    for joint, weight in terms:
        ET.SubElement(fixed, "joint", joint=joint, coef=numbers(weight))


def _actuator(actuators: ET.Element, arm: IdentifiedArm, number: int, *, is_shared: bool) -> None:
    """Voltage to torque (1): e u behind the current loop."""
    joint = arm.joint(number)
    target, gear = {"joint": f"motor_joint{number}"}, 1.0
    if is_shared:
        target = {"tendon": f"motor{number}"}
    elif not joint.elastic:
        target = {"joint": arm.study.arm.joint_names[number - 1]}
        gear = 1.0 / joint.gear_ratio
    drive = {"name": f"drive{number}", **target, "gear": numbers(gear)}
    element = ET.SubElement(actuators, "general", drive, gainprm=numbers(joint.torque_per_command))
    if (lag := _lag(joint)) is not None:
        element.set("dyntype", "filterexact")
        element.set("dynprm", numbers(lag))


def _lag(joint: Joint) -> float | None:
    """Time constant [s] of a drive; None: it has none, or one too short for the time step.

    MuJoCo holds the filtered torque over a step, which adds a lag of half a step. Its Runge-Kutta
    integrator diverges for time constants below 0.36 steps.
    """
    if not joint.current_loop_hz:
        return None
    lag = 1.0 / (2.0 * math.pi * joint.current_loop_hz) - 0.5 * _STEP_S
    return lag if lag > 0.5 * _STEP_S else None


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
    ET.SubElement(sensors, "actuatorfrc", name=f"torque{number}", actuator=f"drive{number}")
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


def _approximations(arm: IdentifiedArm) -> tuple[Diagnostic, ...]:
    """Warnings on gears and drives that the file approximates."""
    warnings = []
    for number, joint in enumerate(arm.study.arm.joints, start=1):
        place, hz = Place(joint=number), joint.current_loop_hz
        if joint.elastic and joint.law.parallel_springs(partial(arm.need, joint=number)) is None:
            warnings.append(Diagnostic("linearised", place, note=joint.law.linearised_note))
        if hz and _lag(joint) is None:
            warnings.append(Diagnostic("left-out", place, bandwidth_hz=hz, step=_STEP_S))
    return tuple(warnings)
