"""The rigid part of an arm as URDF: bodies, joints, friction at the link, gear ratios."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from strainwave.domain import Joint, JointLimits, LinkPrior
from strainwave.domain.arm.kinds.base import Body
from strainwave.dynamics.arm import Arm
from strainwave.errors import NumericalFailure
from strainwave.export import completion, source
from strainwave.export.read_back import UrdfValues, by_pinocchio
from strainwave.export.source import Export, IdentifiedArm, numbers
from strainwave.io.base_parameters import links_of_torques, motor_regressor, torque_errors
from strainwave.io.templates import fill_text
from strainwave.io.urdf import patch_urdf

_HELD = (
    *("motor_inertia", "motor_viscous_friction", "link_viscous_friction"),
    *("motor_coulomb_friction", "friction_offset"),
)
NO_LIMIT = 1e6  # of a joint without limits, where URDF requires numbers


def _kind(joint: Joint) -> str:
    """Type of a URDF joint: a revolute joint without limits of its position is continuous."""
    limits = joint.limits or JointLimits()
    is_bounded = limits.lower is not None and limits.upper is not None
    return "continuous" if joint.motion == "revolute" and not is_bounded else joint.motion


def _limits(joint: Joint) -> dict[str, float]:
    """Attributes of `<limit>`, which revolute and prismatic joints need; unknown ones are wide."""
    known, given = joint.limits or JointLimits(), _kind(joint)
    if given == "continuous" and not (known.velocity or known.effort):
        return {}
    limits = {"effort": known.effort or NO_LIMIT, "velocity": known.velocity or NO_LIMIT}
    if given != "continuous":
        limits["lower"] = -NO_LIMIT if known.lower is None else known.lower
        limits["upper"] = NO_LIMIT if known.upper is None else known.upper
    return limits


def to_srdf(arm: IdentifiedArm) -> Export:
    """URDF of links without rotors, which follow as `rotor_params`, read by Pinocchio."""
    return to_urdf(arm, has_rotors=True)


def to_urdf(arm: IdentifiedArm, *, has_rotors: bool = False) -> Export:
    """URDF of the arm behind rigid gears (5); `InvalidInput` if a needed parameter is missing.

    If a URDF places the joints of the study, it is that file with other inertial values and
    friction. The links include the rotors, unless the file `has_rotors`.
    """
    links, rotors, friction, notes_of_links = projected_links(arm, has_rotors)
    losses = source.losses(arm, _HELD)
    notes = (*arm.assumptions, *notes_of_links, *source.loss_note(losses))
    urdf, names = arm.study.arm.urdf, arm.study.arm.joint_names
    if urdf is not None:
        comments = ["Inertial values and friction identified by strainwave."]
        comments += map(source.sentence_of, notes)
        path = arm.study.path.parent / urdf.file
        data = patch_urdf(path, urdf.held, links, friction, comments)
    else:
        bodies = map(Body.of_standard, links)
        data = fill_text(
            Path(__file__).with_name("arm.urdf.j2"),
            notes=notes,
            links=list(zip(bodies, arm.study.arm.joints, names, strict=True)),
            friction=friction,
            kind_of=_kind,
            limits_of=_limits,
            comment_text=source.comment_text,
            numbers=numbers,
            quoted=quoteattr,
            sentence_of=source.sentence_of,
        ).encode()
    if has_rotors:
        rotor_texts = "".join(
            f'    <joint name={quoteattr(name)} mass="{numbers(rotor)}" gear_ratio="1.0" />\n'
            for name, rotor in zip(names, rotors, strict=True)
        )
        start, end, rest = data.rpartition(b"</robot>")
        element = f"  <rotor_params>\n{rotor_texts}  </rotor_params>\n".encode()
        data = start + element + end + rest
    joints = arm.study.arm.joints
    values = UrdfValues(
        names,
        tuple(links),
        tuple(friction),
        limits=tuple(map(_limits, joints)),
        origins=None if urdf and urdf.held else tuple(joint.origin for joint in joints),
        rotors=tuple(rotors) if has_rotors else None,
    )
    check = partial(by_pinocchio, values=values)
    return Export(data, arm.assumed() + completion.gravity_warnings(arm), notes, losses, check)


def projected_links(
    arm: IdentifiedArm, has_rotors: bool
) -> tuple[list[LinkPrior], list[float], list[tuple[float, float]], list[str]]:
    """The model whose torques at the motors over the recorded motion are nearest to the arm's.

    Links, inertias of rotors at the joints that the links do not include, damping and dry friction
    of the joints, and notes.
    URDF has friction of single joints, and no place for rotors. What of them it does not hold is
    in the links: the nearest consistent bodies.
    """
    gravity, motion = arm.study.arm.gravity_size, completion.motion_of(arm)
    description, chain = Arm.of(arm.study.arm), completion.chain_of(arm, gravity)
    n, speeds = description.n_joints, description.links_of(motion[1])
    target, notes = arm.torques, list[str]()
    if target is None:
        target = completion.body_torques(arm, motion, gravity)
        target = target + completion.motor_friction(arm, motion)
        arm = replace(arm, torques=target)
    regressor = motor_regressor(chain, motion)
    links = np.concatenate(completion.standard_links(arm, gravity))
    inertias = completion.rotor_inertias(arm)
    rotors = np.diag(description.joints_of(description.joints_of(np.diag(inertias)).T))
    held = rotors * has_rotors
    of_rotors = description.motors_of(held * description.links_of(motion[2]))
    columns = [description.motors_of(x * e) for x in (speeds, np.sign(speeds)) for e in np.eye(n)]
    laws = np.stack(columns, axis=2)
    if any(inertias) and (description.coupling is not None or not has_rotors):
        bodies = regressor @ np.concatenate([links, inertias]) - of_rotors
        errors = torque_errors(arm.rigid, target)
        merged = links_of_torques(chain, motion, bodies, errors, laws, [0.0] * n)
        if merged is None:
            raise NumericalFailure("no consistent links include the rotors")
        links = merged[: 10 * n]
        if not has_rotors:
            listed = ", ".join(f"joint {i + 1}: {x:.4g} kg m^2" for i, x in enumerate(rotors))
            notes.append(f"the links include the rotors ({listed}); SRDF and MJCF hold them apart")
    rest = target - regressor[:, :, : 10 * n] @ links - of_rotors
    weights = (motion[1] != 0.0) / (np.std(target, axis=0) + np.finfo(float).tiny)
    friction = completion.nonnegative_fit(
        (laws * weights[:, :, None]).reshape(rest.size, -1), (rest * weights).ravel()
    )
    notes.append(completion.loss_note(arm, target - rest + laws @ friction))
    bodies = [tuple(link) for link in links.reshape(-1, 10).tolist()]
    pairs = list(zip(*friction.reshape(2, n).tolist(), strict=True))
    return bodies, held.tolist(), pairs, notes
