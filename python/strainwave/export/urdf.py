"""The rigid part of an arm as URDF: bodies, joints, friction at the link, gear ratios."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from strainwave.domain import Joint, JointLimits
from strainwave.domain.core_arm import transmission
from strainwave.export.bodies import gravity_warnings, holds_motor, link_bodies
from strainwave.export.markup import comment_text, numbers
from strainwave.export.omissions import Part, notes_of, sentence_of
from strainwave.export.source import Export, IdentifiedArm
from strainwave.io.templates import fill_text

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
    Part.TRANSMISSION: "a URDF transmission has one joint; friction and motor inertia of "
    "a joint are those of all motors that turn with it",
    Part.DRIVE: "the effort of a URDF joint is the torque at the link",
    Part.SENSORS: "URDF has no sensors",
    Part.SERVO: "URDF has no controllers",
    Part.UNCERTAINTY: "see result.json",
}


_NO_LIMIT = 1e6  # of a joint without limits, where URDF requires numbers


def _kind(joint: Joint) -> str:
    """Type of a URDF joint: a revolute joint without limits of its position is continuous."""
    return "continuous" if joint.motion == "revolute" and not _is_bounded(joint) else joint.motion


def _is_bounded(joint: Joint) -> bool:
    limits = joint.limits
    return limits is not None and limits.lower is not None and limits.upper is not None


def _limits(joint: Joint) -> dict[str, float]:
    """Attributes of `<limit>`, which revolute and prismatic joints need; unknown ones are wide."""
    known, given = joint.limits or JointLimits(), _kind(joint)
    if given == "continuous" and not (known.velocity or known.effort):
        return {}
    limits = {"effort": known.effort or _NO_LIMIT, "velocity": known.velocity or _NO_LIMIT}
    if given != "continuous":
        limits["lower"] = -_NO_LIMIT if known.lower is None else known.lower
        limits["upper"] = _NO_LIMIT if known.upper is None else known.upper
    return limits


def to_urdf(arm: IdentifiedArm) -> Export:
    """URDF of the arm behind rigid gears (5); `InvalidInput` if a needed parameter is missing."""
    bodies = link_bodies(arm, arm.study.arm.gravity_size)
    joints = arm.study.arm.joints
    reasons = dict(_OMISSIONS)
    if holds_motor(arm):  # the inertia of the link includes it
        del reasons[Part.MOTOR_INERTIA]
    notes = notes_of(arm, reasons)
    # speeds of the motors per speed of each joint alone; transmissions may couple them
    inertias = arm.standard | arm.values
    speeds = np.abs(np.linalg.inv(transmission(arm.study.arm)))

    def viscous_friction(number: int) -> float:
        """d_M/n^2 of all its motors + d_L at the link."""
        of_link = arm.need("link_viscous_friction", number)
        return of_link + at_link("motor_viscous_friction", number, 2)

    def coulomb_friction(number: int) -> float:
        """f_M/n of all its motors at the link."""
        return at_link("motor_coulomb_friction", number, 1)

    def motor_inertia(number: int) -> float | None:
        """m_M/n^2 of all its motors at the link; None: unknown, or part of the link."""
        motors = (np.flatnonzero(speeds[:, number - 1]) + 1).tolist()
        is_known = all(("motor_inertia", motor) in inertias for motor in motors)
        if holds_motor(arm) or not is_known:
            return None
        weights = speeds[[motor - 1 for motor in motors], number - 1] ** 2
        return float(weights @ [inertias["motor_inertia", motor] for motor in motors])

    def at_link(name: str, number: int, power: int) -> float:
        """A property of the motors that turn with one joint, seen from the joint."""
        weights = enumerate((speeds[:, number - 1] ** power).tolist(), start=1)
        return sum((arm.need(name, i) * weight for i, weight in weights if weight), 0.0)

    text = fill_text(
        Path(__file__).with_name("arm.urdf.j2"),
        notes=notes,
        links=list(zip(bodies, joints, arm.study.arm.joint_names, strict=True)),
        coulomb_friction=coulomb_friction,
        kind_of=_kind,
        limits_of=_limits,
        motor_inertia=motor_inertia,
        viscous_friction=viscous_friction,
        comment_text=comment_text,
        numbers=numbers,
        quoted=quoteattr,
        sentence_of=sentence_of,
    )
    warnings = arm.warnings + arm.assumed() + arm.assumed_bodies() + gravity_warnings(arm)
    return Export(text.encode(), warnings, notes)
