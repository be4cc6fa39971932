"""Where the whole-arm fit starts: what the steps before found, or what such arms have.

A value of a step before that no arm can have, as negative gear damping, says that something is
wrong with the data or the study. It does not keep the fit from finding out what: an ordinary value
takes its place, and a warning says so.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import Diagnostic, JointModel, RigidModel
from strainwave.domain.combinations import value_of
from strainwave.domain.kinds import kind_of
from strainwave.domain.kinds.starts import StageInertias, is_positive
from strainwave.domain.parameters import Values, unit_of
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable

Key = tuple[str, int | None]

VISCOUS = ("motor_viscous_friction", "link_viscous_friction")
COULOMB = "motor_coulomb_friction"
OFFSET = "friction_offset"

_LEAST_SHARE = 0.05  # of the total viscous friction, where a start would be negative
_ANTI_RESONANCE_HZ = 15.0  # of arms with strain-wave gears: 10 to 30, small ones up to 60
_DAMPING = 0.03  # damping ratio of such gears
_RATIOS = (0.01, 0.5)  # damping ratios to start within: ranges lie about the start


@dataclass(frozen=True, slots=True)
class Starts:
    """Values to start from, and what was impossible among those of the steps before."""

    values: Values
    rejected: Mapping[Key, float]


def starts_of(model: RigidModel | None, joints: Sequence[JointModel], arm: Arm) -> Starts:
    """A start for every parameter but the curves'.

    `model`: Dispensable for a single joint without gravity.
    `joints`: One per joint.

    Raises `NotIdentifiable`: A joint has no model, or the rigid model lacks something that nothing
    can stand for.
    """
    models = _by_joint(joints, arm)
    found = StageInertias(
        motor={number: joint.values["motor_inertia"] for number, joint in models.items()},
        link={number: joint.values["link_inertia"] for number, joint in models.items()},
        rigid={(p.name, p.joint): p.value for p in model.parameters} if model else {},
    )
    start, rejected = kind_of(arm).starting_inertias(arm, found)
    if arm.gravity is not None:
        for i in range(1, arm.n_joints + 1):
            start[f"gravity_torque_{i}", None] = found.needed(f"gravity_torque_{i}")
    for number in sorted(models):
        values = models[number].values
        stiffness, damping = values["gear_stiffness"], values["gear_damping"]
        load = value_of(arm.link_inertia(number), start)
        if not is_positive(stiffness):
            rejected["gear_stiffness", number] = stiffness
            stiffness = (2.0 * np.pi * _ANTI_RESONANCE_HZ) ** 2 * load
        critical = 2.0 * float(np.sqrt(stiffness * load))
        if not is_positive(damping):
            rejected["gear_damping", number] = damping
            damping = _DAMPING * critical
        damping = min(max(damping, _RATIOS[0] * critical), _RATIOS[1] * critical)
        friction = _friction(model, models[number], arm, number)
        for name, value in friction.items():
            start[name, number] = value
        start["gear_stiffness", number], start["gear_damping", number] = stiffness, damping
    return Starts(start, rejected)


def rejected_starts(starts: Starts, arm: Arm) -> Iterator[Diagnostic]:
    """What a reader must know of starts that were impossible."""
    for (name, joint), value in starts.rejected.items():
        place = name if joint is None else f"{name} of joint {joint}"
        unit = unit_of(name, None if joint is None else arm.joints[joint - 1])
        text = f"the steps before found {value:.3g} {unit}, which is impossible; the whole-arm fit"
        text += f" started from {starts.values[name, joint]:.3g}, which is usual for such arms"
        yield Diagnostic("start-rejected", place, text)


def _friction(
    model: RigidModel | None, joint: JointModel, arm: Arm, number: int
) -> dict[str, float]:
    """Of the joint's model, Coulomb friction and its offset of the rigid one where it has them."""
    values = _mended(joint.values, arm.joints[number - 1].gear_ratio)
    found = {name: values[name] for name in VISCOUS}
    found[OFFSET] = _known(model, OFFSET, number) or 0.0
    coulomb = _known(model, COULOMB, number)  # not every route to a joint's model gives it
    return found | {COULOMB: values.get(COULOMB, 0.0) if coulomb is None else coulomb}


def _mended(values: Mapping[str, float], ratio: float) -> dict[str, float]:
    """A negative viscous friction starts at a small share of the total, the other at the rest."""
    mended = dict(values)
    motor, link = (values[name] for name in VISCOUS)
    least = _LEAST_SHARE * abs(motor + ratio**2 * link)
    if motor < least:
        mended[VISCOUS[0]] = least
        mended[VISCOUS[1]] = max(link + (motor - least) / ratio**2, least / ratio**2)
    elif ratio**2 * link < least:
        mended[VISCOUS[1]] = least / ratio**2
        mended[VISCOUS[0]] = max(motor + ratio**2 * link - least, least)
    return mended


def _by_joint(joints: Sequence[JointModel], arm: Arm) -> dict[int, JointModel]:
    found = {joint.joint: joint for joint in joints}
    for number, joint in enumerate(arm.joints, start=1):
        if not joint.elastic or number not in found:
            raise NotIdentifiable(
                f"the whole-arm fit starts from a model of each elastic joint, and joint {number}"
                ' has none: record it with use = "frequency"'
            )
    return found


def _known(model: RigidModel | None, name: str, joint: int) -> float | None:
    for parameter in model.parameters if model is not None else ():
        if (parameter.name, parameter.joint) == (name, joint):
            return parameter.value
    return None
