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
from strainwave.domain.parameters import Values, unit_of
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable

Key = tuple[str, int | None]

VISCOUS = ("motor_viscous_friction", "link_viscous_friction")
COULOMB = "motor_coulomb_friction"
OFFSET = "friction_offset"

_LEAST_SHARE = 0.05  # of the total viscous friction, where a start would be negative
_MOTOR_SHARE = 0.3  # of a joint's inertia: motors are chosen to match their load, about
_ANTI_RESONANCE_HZ = 15.0  # of arms with strain-wave gears: 10 to 30, small ones up to 60
_DAMPING = 0.03  # damping ratio of such gears
_RATIOS = (0.01, 0.5)  # damping ratios to start within: ranges lie about the start
_PROPER = 1.05  # times gamma^2 / beta, which alpha must exceed for a positive definite inertia
_CHOSEN = 1.5  # and where it is chosen


@dataclass(frozen=True, slots=True)
class Starts:
    """Values to start from, and what was impossible among those of the steps before."""

    values: Values
    rejected: Mapping[Key, float]


def starts_of(model: RigidModel | None, joints: Sequence[JointModel], arm: Arm) -> Starts:
    """A start for every parameter but the curves'.

    Parameters
    ----------
    model : RigidModel or None
        Dispensable for a single joint without gravity.
    joints : sequence of JointModel
        One per joint.
    arm : Arm

    Returns
    -------
    Starts

    Raises
    ------
    NotIdentifiable
        A joint has no model, or the rigid model lacks something that nothing can stand for.
    """
    models = _by_joint(joints, arm)
    start, rejected = _inertias(model, models, arm)
    if arm.gravity is not None:
        for i in range(1, arm.n_joints + 1):
            start[f"gravity_torque_{i}", None] = _rigid(model, f"gravity_torque_{i}")
    for number in sorted(models):
        values = models[number].values
        stiffness, damping = values["gear_stiffness"], values["gear_damping"]
        load = _link_inertia(start, arm, number)
        if not _positive(stiffness):
            rejected["gear_stiffness", number] = stiffness
            stiffness = (2.0 * np.pi * _ANTI_RESONANCE_HZ) ** 2 * load
        critical = 2.0 * float(np.sqrt(stiffness * load))
        if not _positive(damping):
            rejected["gear_damping", number] = damping
            damping = _DAMPING * critical
        damping = min(max(damping, _RATIOS[0] * critical), _RATIOS[1] * critical)
        friction = _friction(model, models[number], arm, number)
        for name, value in friction.items():
            start[name, number] = value
        start["gear_stiffness", number], start["gear_damping", number] = stiffness, damping
    return Starts(start, rejected)


def rejected_starts(starts: Starts, arm: Arm) -> Iterator[Diagnostic]:
    """What a reader must know of starts that were impossible.

    Parameters
    ----------
    starts : Starts
    arm : Arm

    Yields
    ------
    Diagnostic
    """
    for (name, joint), value in starts.rejected.items():
        place = name if joint is None else f"{name} of joint {joint}"
        unit = "kg m^2" if joint is None else unit_of(name, arm.joints[joint - 1])
        text = f"the steps before found {value:.3g} {unit}, which is impossible; the whole-arm fit"
        text += f" started from {starts.values[name, joint]:.3g}, which is usual for such arms"
        yield Diagnostic("start-rejected", place, text)


def _inertias(
    model: RigidModel | None, joints: Mapping[int, JointModel], arm: Arm
) -> tuple[Values, dict[Key, float]]:
    """Inertias of links and motors; each that is impossible made of what the rigid model knows."""
    rejected: dict[Key, float] = {}
    motor = {number: joint.values["motor_inertia"] for number, joint in joints.items()}
    link = {number: joint.values["link_inertia"] for number, joint in joints.items()}
    n2 = {i: joint.gear_ratio**2 for i, joint in enumerate(arm.joints, start=1)}
    if arm.n_joints == 1:
        total = _known(model, "inertia", 1)
        if not _positive(link[1]):
            rejected["link_inertia", 1] = link[1]
            whole = total if _positive(total) else _sure("inertia", motor[1]) / _MOTOR_SHARE
            link[1] = (1.0 - _MOTOR_SHARE) * (whole or 0.0) / n2[1]
        if not _positive(motor[1]):
            rejected["motor_inertia", 1] = motor[1]
            motor[1] = _MOTOR_SHARE / (1.0 - _MOTOR_SHARE) * n2[1] * link[1]
        return {("link_inertia", 1): link[1], ("motor_inertia", 1): motor[1]}, rejected
    gamma, beta = _rigid(model, "gamma"), link[2]
    if not _positive(beta):
        rejected["beta", None] = beta
        beta = _sure("beta", _rigid(model, "beta"))
    if not _positive(motor[2]):
        rejected["motor_inertia", 2] = motor[2]
        known = _known(model, "motor_inertia", 2)
        motor[2] = known if known is not None and _positive(known) else n2[2] * beta
    rigid = _known(model, "rigid_inertia", 1)
    if not _positive(motor[1]):
        rejected["motor_inertia", 1] = motor[1]
        whole = rigid if rigid is not None and _positive(rigid) else link[1]
        motor[1] = _MOTOR_SHARE * n2[1] * _sure("rigid_inertia of joint 1", whole)
    alpha, least = link[1] - beta - 2.0 * gamma, gamma**2 / beta
    if not np.isfinite(alpha) or alpha <= max(0.0, _PROPER * least):
        rejected["alpha", None] = alpha
        alpha = max((rigid or 0.0) - motor[1] / n2[1], _CHOSEN * least)
    start: Values = {("alpha", None): alpha, ("beta", None): beta, ("gamma", None): gamma}
    return start | {("motor_inertia", i): motor[i] for i in (1, 2)}, rejected


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


def _link_inertia(start: Values, arm: Arm, joint: int) -> float:
    if arm.n_joints == 1:
        return start["link_inertia", 1]
    beta = start["beta", None]
    return beta if joint == 2 else start["alpha", None] + beta + 2.0 * start["gamma", None]


def _positive(value: float | None) -> bool:
    return value is not None and bool(np.isfinite(value)) and value > 0.0


def _sure(name: str, value: float) -> float:
    """A value that must be positive for there to be any start at all."""
    if not _positive(value):
        raise NotIdentifiable(
            f"the whole-arm fit has no start: {name} is {value:.3g} by the steps before, which is"
            " impossible. Check the signs, units and assignment of the channels, gear_ratio and"
            " torque_per_volt"
        )
    return value


def _by_joint(joints: Sequence[JointModel], arm: Arm) -> dict[int, JointModel]:
    found = {joint.joint: joint for joint in joints}
    for number, joint in enumerate(arm.joints, start=1):
        if joint.spring == "rigid" or number not in found:
            raise NotIdentifiable(
                f"the whole-arm fit starts from a model of each elastic joint, and joint {number}"
                ' has none: record it with use = "frequency"'
            )
    return found


def _rigid(model: RigidModel | None, name: str) -> float:
    value = model.value(name) if model is not None else None
    if value is None:
        raise NotIdentifiable(
            f"the whole-arm fit needs {name}, which the motion records do not identify: record both"
            ' joints moving together with use = "motion"'
        )
    return value


def _known(model: RigidModel | None, name: str, joint: int) -> float | None:
    for parameter in model.parameters if model is not None else ():
        if (parameter.name, parameter.joint) == (name, joint):
            return parameter.value
    return None
