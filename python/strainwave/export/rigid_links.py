"""The rigid part of an arm joint by joint, with servos, as simulators of rigid bodies have it."""

from __future__ import annotations

from dataclasses import dataclass

from strainwave.domain import Diagnostic, Joint, JointLimits
from strainwave.domain.arm.kinds.base import Body
from strainwave.domain.keys import JointNumber
from strainwave.errors import InvalidInput
from strainwave.export import source
from strainwave.export.mjcf_drives import ServoGains, servo_gains
from strainwave.export.source import IdentifiedArm
from strainwave.export.urdf import projected_links

DELAY, STICTION = "servo_delay", "stribeck_friction"
_HELD = (
    *("motor_inertia", "motor_viscous_friction", "link_viscous_friction"),
    *("motor_coulomb_friction", "servo_kp", "servo_kd", "servo_damping", "torque_limit"),
)


def held_parts(arm: IdentifiedArm, *further: str) -> set[str]:
    """Parts of an arm that formats of rigid links hold, and `further` ones of one format."""
    return {*_HELD, *further, *["servo"] * (arm.study.arm.position_servo is not None)}


def lost_shapes(arm: IdentifiedArm) -> tuple[Diagnostic, ...]:
    """The loss of formats that do not have the meshes of the study's URDF."""
    return () if arm.study.arm.urdf is None else (source.loss("meshes of the URDF"),)


@dataclass(frozen=True, slots=True)
class RigidLink:
    """A link behind a rigid gear: its body, friction and inertia at its joint, and its servo."""

    number: JointNumber
    name: str  # of the joint
    joint: Joint
    body: Body  # in the frame of the joint
    armature: float  # [kg m^2, kg] of the motor at the joint; zero: the body includes it
    viscous_friction: float  # [N m s/rad, N s/m]
    dry_friction: float  # [N m, N]
    static_friction: float  # [N m, N] at standstill, not below the dry friction
    servo: ServoGains | None  # the nearest law in continuous time

    @property
    def limits(self) -> JointLimits:
        """Limits of the joint; the effort is that of the servo, if it has one."""
        return self.joint.limits or JointLimits()

    @property
    def effort_limit(self) -> float | None:
        """Limit of the torque [N m] or force [N]: that of the servo, else that of the joint."""
        limit = self.servo.limit if self.servo else None
        return self.limits.effort if limit is None else limit


def rigid_links(
    arm: IdentifiedArm, *, has_rotors: bool
) -> tuple[tuple[RigidLink, ...], tuple[str, ...]]:
    """The links from the base as in URDF, and notes on what they approximate.

    The bodies include the rotors, unless the format `has_rotors`.
    """
    bodies, rotors, friction, notes = projected_links(arm, has_rotors)
    joints = zip(arm.study.arm.joint_names, arm.study.arm.joints, bodies, strict=True)
    links = tuple(
        RigidLink(
            number=i + 1,
            name=name,
            joint=joint,
            body=Body.of_standard(body),
            armature=rotors[i],
            viscous_friction=friction[i][0],
            dry_friction=friction[i][1],
            static_friction=max(friction[i][1], _breakaway(arm, i + 1)),
            servo=servo_law(arm, i + 1),
        )
        for i, (name, joint, body) in enumerate(joints)
    )
    return links, (*arm.assumptions, *notes)


def _breakaway(arm: IdentifiedArm, number: JointNumber) -> float:
    """Friction of the joint at standstill (S10); zero if it does not differ from dry friction."""
    excess = arm.identified.get((STICTION, number), 0.0)
    dry = arm.identified.get(("motor_coulomb_friction", number), 0.0)
    return (dry + excess) / abs(arm.joint(number).gear_ratio) if excess else 0.0


def servo_law(arm: IdentifiedArm, number: JointNumber) -> ServoGains | None:
    """The position servo of a joint in continuous time; None without.

    Raises `InvalidInput` if its gain is unknown, and torques of several joints are relative to
    different gains. A single joint has the same motion with a gain of 1.
    """
    servo = arm.study.arm.position_servo
    if servo is None:
        return None
    gains = servo_gains(arm, number, servo)
    if gains.is_relative and arm.study.arm.n_joints > 1:
        raise no_torques(arm, number)
    return gains.continuous(servo.period)


def no_torques(arm: IdentifiedArm, number: JointNumber) -> InvalidInput:
    """The refusal of a format that needs torques where the result has ratios to a gain."""
    return InvalidInput(
        f"the gain of servo {number} is not determined: the result has ratios, and no torques",
        where=f"{arm.source}: servo_kp {number}",
        remedy="give kp in the study, or identify with a record that has a known payload",
    )
