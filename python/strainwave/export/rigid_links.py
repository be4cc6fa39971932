"""The rigid part of an arm joint by joint, with servos, as simulators of rigid bodies have it."""

from __future__ import annotations

from dataclasses import dataclass

from strainwave.domain import Joint, JointLimits
from strainwave.domain.arm.kinds.base import Body
from strainwave.domain.keys import JointNumber
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm
from strainwave.export.urdf import projected_links

SERVO = ("servo_kp", "servo_kd", "servo_damping", "torque_limit")
"""Parameters of a position servo without its delay."""
HELD = (
    *("motor_inertia", "motor_viscous_friction", "link_viscous_friction"),
    *("motor_coulomb_friction", *SERVO),
)
"""Parameters that formats of rigid links hold."""
DELAY = "servo_delay"


@dataclass(frozen=True, slots=True)
class ServoLaw:
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
    servo: ServoLaw | None

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
            servo=servo_law(arm, i + 1),
        )
        for i, (name, joint, body) in enumerate(joints)
    )
    return links, (*arm.assumptions, *notes)


def servo_law(arm: IdentifiedArm, number: JointNumber) -> ServoLaw | None:
    """The position servo of a joint; the damping is the sum with friction if only that is known.

    Raises `InvalidInput` if its gain is unknown: then the result has ratios, and no torques.
    """
    servo, values = arm.study.arm.position_servo, arm.values
    if servo is None:
        return None

    def value_of(name: str, known: float | None) -> float | None:
        return values.get((name, number), known)

    stiffness = value_of("servo_kp", servo.gain(number))
    if stiffness is None:
        raise InvalidInput(
            f"the gain of servo {number} is not determined: the result has ratios, and no torques",
            where=f"{arm.source}: servo_kp {number}",
            remedy="give kp in the study, or identify with a record that has a known payload",
        )
    damping = value_of("servo_kd", servo.damping_gain(number))
    return ServoLaw(
        stiffness,
        values.get(("servo_damping", number), 0.0) if damping is None else damping,
        value_of("torque_limit", servo.torque_limit(number)),
        value_of("servo_delay", servo.delay_of(number)) or 0.0,
    )
