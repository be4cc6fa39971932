"""The rigid part of an arm joint by joint, with servos, as simulators of rigid bodies have it."""

from __future__ import annotations

from dataclasses import dataclass

from strainwave.domain import Joint, JointLimits
from strainwave.domain.arm.kinds.base import Body
from strainwave.domain.keys import JointNumber
from strainwave.export.source import IdentifiedArm
from strainwave.export.urdf import projected_links

SERVO, DELAY = ("servo_kp", "servo_kd", "servo_damping", "torque_limit"), "servo_delay"
"""Parameters of a position servo."""
_JOINT = (
    *("motor_inertia", "motor_viscous_friction", "link_viscous_friction"),
    "motor_coulomb_friction",
)


@dataclass(frozen=True, slots=True)
class PositionServo:
    """The law of a joint's servo: limited torque of stiffness (ref - q) - damping dq."""

    stiffness: float  # [N m/rad, N/m]
    damping: float  # [N m s/rad, N s/m]; with the viscous friction, unless that is known
    limit: float | None  # [N m, N]
    delay: float  # [s] of the command


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
    servo: PositionServo | None

    @property
    def limits(self) -> JointLimits:
        """Limits of the joint; the effort is that of the servo, if it has one."""
        return self.joint.limits or JointLimits()

    @property
    def effort_limit(self) -> float | None:
        """Limit of the torque [N m] or force [N]: that of the servo, else that of the joint."""
        limit = self.servo.limit if self.servo else None
        return self.limits.effort if limit is None else limit


def held_parts(arm: IdentifiedArm) -> list[str]:
    """Parts of an arm that formats of rigid links hold: inertia, friction, gains of the servo."""
    has_gains = any(name == "servo_kp" for name, _ in arm.values)
    return [*_JOINT, *SERVO, *["servo"] * has_gains]


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
            servo=_servo(arm, i + 1),
        )
        for i, (name, joint, body) in enumerate(joints)
    )
    return links, (*arm.assumptions, *notes)


def _servo(arm: IdentifiedArm, number: JointNumber) -> PositionServo | None:
    """The position servo of a joint; the damping is the sum with friction if only that is known."""
    values = arm.values
    if values.get(("servo_kp", number)) is None:
        return None
    damping = values.get(("servo_kd", number))
    if damping is None:
        damping = values.get(("servo_damping", number), 0.0)
    return PositionServo(
        arm.need("servo_kp", number),
        damping,
        values.get(("torque_limit", number)),
        values.get(("servo_delay", number), 0.0),
    )
