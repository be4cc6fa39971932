"""The rigid part of an arm as URDF: bodies, joints, friction at the link, gear ratios."""

from __future__ import annotations

from pathlib import Path

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
    Part.DRIVE: "the effort of a URDF joint is the torque at the link",
    Part.SENSORS: "URDF has no sensors",
    Part.SERVO: "URDF has no controllers",
    Part.UNCERTAINTY: "see result.json",
}


def to_urdf(arm: IdentifiedArm) -> Export:
    """URDF of the arm behind rigid gears (5); `InvalidInput` if a needed parameter is missing."""
    bodies = link_bodies(arm, arm.study.arm.gravity_size)
    joints = arm.study.arm.joints
    reasons = dict(_OMISSIONS)
    if holds_motor(arm):  # the inertia of the link includes it
        del reasons[Part.MOTOR_INERTIA]
    notes = notes_of(arm, reasons)

    def viscous_friction(number: int) -> float:
        """d_M/n^2 + d_L at the link."""
        of_motor = arm.need("motor_viscous_friction", number) / joints[number - 1].gear_ratio ** 2
        return of_motor + arm.need("link_viscous_friction", number)

    def coulomb_friction(number: int) -> float:
        """f_M/n at the link."""
        return arm.need("motor_coulomb_friction", number) / abs(joints[number - 1].gear_ratio)

    def motor_inertia(number: int) -> float | None:
        """At the link; None: unknown, or part of the link."""
        inertia = arm.values.get(("motor_inertia", number))
        if inertia is None or holds_motor(arm):
            return None
        return inertia / joints[number - 1].gear_ratio ** 2

    text = fill_text(
        Path(__file__).with_name("arm.urdf.j2"),
        notes=notes,
        links=list(zip(bodies, joints, strict=True)),
        coulomb_friction=coulomb_friction,
        motor_inertia=motor_inertia,
        viscous_friction=viscous_friction,
        comment_text=comment_text,
        numbers=numbers,
        sentence_of=sentence_of,
    )
    warnings = arm.warnings + arm.assumed() + gravity_warnings(arm)
    return Export(text.encode(), warnings, notes)
