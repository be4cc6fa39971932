"""The rigid part of an arm as URDF: bodies, joints, friction at the link, gear ratios."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from strainwave.domain import FloatArray, Joint, JointLimits, LinkPrior
from strainwave.domain.consistent_links import consistent_links, standard_parameters
from strainwave.domain.kinds.bodies import Body
from strainwave.dynamics.arm import Arm
from strainwave.export.bodies import gravity_warnings, holds_motor, link_bodies
from strainwave.export.completion import motion_of, project_friction
from strainwave.export.markup import comment_text, numbers
from strainwave.export.omissions import omission_note, sentence_of
from strainwave.export.source import Export, IdentifiedArm
from strainwave.io.templates import fill_text
from strainwave.io.urdf import patch_urdf

_HELD = (
    *("motor_inertia", "motor_viscous_friction", "link_viscous_friction"),
    *("motor_coulomb_friction", "friction_offset"),
)
_ERROR_SHARE = 0.03  # of a joint's torque: its weight in the choice of links with rotors


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
    """URDF of the arm behind rigid gears (5); `InvalidInput` if a needed parameter is missing.

    If a URDF places the joints of the study, it is that file with other inertial values and
    friction.
    """
    links = [_standard(body) for body in link_bodies(arm, arm.study.arm.gravity_size)]
    motors = motion_of(arm)
    links, rotor_notes = _with_rotors(arm, links, motors)
    friction = _friction(arm, motors)
    notes = (*arm.assumptions, *rotor_notes, *omission_note(arm, _HELD))
    warnings = arm.warnings + arm.assumed() + arm.assumed_bodies() + gravity_warnings(arm)
    urdf = arm.study.arm.urdf
    if urdf is not None:
        texts = map(sentence_of, notes)
        comments = ["Inertial values and friction identified by strainwave.", *texts]
        path = arm.study.path.parent / urdf.file
        return Export(patch_urdf(path, urdf.held, links, friction, comments), warnings, notes)
    joints = arm.study.arm.joints
    bodies = [Body.of_standard(link) for link in links]
    text = fill_text(
        Path(__file__).with_name("arm.urdf.j2"),
        notes=notes,
        links=list(zip(bodies, joints, arm.study.arm.joint_names, strict=True)),
        friction=friction,
        kind_of=_kind,
        limits_of=_limits,
        comment_text=comment_text,
        numbers=numbers,
        quoted=quoteattr,
        sentence_of=sentence_of,
    )
    return Export(text.encode(), warnings, notes)


def _standard(body: Body) -> LinkPrior:
    xx, yy, zz, xy, xz, yz = body.inertia
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return standard_parameters(body.mass, np.array(body.centre), inertia)


def _with_rotors(
    arm: IdentifiedArm, links: list[LinkPrior], motors: FloatArray
) -> tuple[list[LinkPrior], tuple[str, ...]]:
    """Links that include the rotors, for which URDF has no place, and a note on them.

    They are the bodies nearest to the links whose torques are nearest to those of links and rotors,
    over a motion (3, n_samples, n_joints) of the motors.
    """
    description = Arm.of(arm.study.arm)
    rotors = np.diag([arm.need("motor_inertia", i + 1) for i in range(description.n_joints)])
    if holds_motor(arm) or not rotors.any():
        return links, ()
    chain = replace(description, kind="serial")
    regressor = chain.base_regressor(*map(chain.links_of, motors))
    values = np.concatenate(links)
    target = regressor @ values + chain.joints_of(motors[2] @ rotors)
    size = np.std(target, axis=0) + np.finfo(float).tiny
    rows = (regressor / (_ERROR_SHARE * size[:, None])).reshape(-1, len(values))
    Q, R = np.linalg.qr(rows)
    merged = consistent_links(links, R, Q.T @ (target / (_ERROR_SHARE * size)).ravel())
    errors = 100.0 * np.sqrt(np.mean((target - regressor @ merged) ** 2, axis=0)) / size
    at_joints = np.diag(chain.joints_of(chain.joints_of(rotors).T))
    listed = ", ".join(
        f"joint {i}: {inertia:.4g} kg m^2 at the joint, torque differs by {error:.2g} %"
        for i, (inertia, error) in enumerate(zip(at_joints, errors, strict=True), start=1)
    )
    note = f"the links include the rotors ({listed}); MJCF holds rotors exactly, as armature"
    return [tuple(link) for link in merged.reshape(-1, 10).tolist()], (note,)


def _friction(arm: IdentifiedArm, motors: FloatArray) -> list[tuple[float, float]]:
    """Damping and friction of each joint: nearest to all friction that acts on it, over a motion.

    Exact if a joint has a motor of its own without offset.
    """
    description = Arm.of(arm.study.arm)
    numbers = range(1, description.n_joints + 1)
    viscous, coulomb, of_links = (
        np.array([arm.need(name, i) for i in numbers])
        for name in ("motor_viscous_friction", "motor_coulomb_friction", "link_viscous_friction")
    )
    offset = [arm.values.get(("friction_offset", i), 0.0) for i in numbers]
    speed = motors[1]
    links = description.links_of(speed)
    torque = description.joints_of(viscous * speed + coulomb * np.sign(speed) + offset)
    torque += of_links * links
    fits = (
        project_friction(torque[:, i], links[:, i], has_offset=False)
        for i in range(description.n_joints)
    )
    return [(float(damping), float(dry)) for damping, dry, *_ in fits]
