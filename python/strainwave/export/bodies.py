"""Base parameters -> rigid bodies that have them.

The motion of an arm tells only alpha, beta, gamma and the gravity torques; many sets of masses
share them. Chosen here, for two links with kappa = gamma^2/(alpha beta), which is below one where
the inertia matrix is positive definite:

    m2 l1^2 = alpha (1 + kappa)/2,   m2 lc2 = gamma/l1,   I2 = beta (1 - kappa)/(1 + kappa)

so that what is left for link 1, alpha (1 - kappa)/2, and I2 are positive for every such arm. Link 1
is `about_axis` with what gravity tells of its first moment.
"""

from __future__ import annotations

from dataclasses import dataclass

from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm
from strainwave.records import Caution

_WORTH_TELLING = 0.01  # of a gravity torque
_ASSUMED_LENGTH = 1.0  # [m] of a single link whose study names none


@dataclass(frozen=True, slots=True)
class Body:
    """One link as a rigid body; its centre of mass lies on its x axis."""

    mass: float  # [kg]
    centre: float  # [m] from its own axis; negative beyond it
    inertia: float  # [kg m^2] about the centre of mass
    weightless: float = 0.0  # share of its weight that gravity does not have


def link_bodies(arm: IdentifiedArm) -> tuple[Body, ...]:
    """Bodies whose base parameters are the arm's.

    Parameters
    ----------
    arm : IdentifiedArm

    Returns
    -------
    tuple of Body
        One a link, from the base. With gravity, G2 may differ a little from g gamma/l1, which
        `weightless` of link 2 makes up for.

    Raises
    ------
    InvalidInput
        A base parameter is null or not there, or no bodies have these.
    """
    gravity = arm.study.arm.gravity or 0.0
    length = arm.study.arm.link_length or _ASSUMED_LENGTH
    if arm.study.n_joints == 1:
        inertia = _single_inertia(arm)
        if arm.joint(1).motion == "prismatic":
            return (Body(inertia, 0.0, inertia * length**2),)  # it does not turn: any inertia does
        moment = arm.need("gravity_torque_1") / gravity if gravity else 0.0
        return (about_axis(inertia, moment, length),)
    alpha, beta, gamma = (arm.need(name) for name in ("alpha", "beta", "gamma"))
    if not (alpha > 0.0 and beta > 0.0 and alpha * beta > gamma**2):
        raise InvalidInput(
            f"no bodies have alpha = {alpha:g}, beta = {beta:g}, gamma = {gamma:g} kg m^2: "
            "their inertia matrix is not positive definite",
            where=f"{arm.source}: parameters",
            remedy="record faster motions of both joints and identify again",
        )
    kappa = gamma**2 / (alpha * beta)
    mass = alpha * (1.0 + kappa) / (2.0 * length**2)
    moment = gamma / length
    weightless = 0.0
    if gravity and gamma:
        weightless = 1.0 - arm.need("gravity_torque_2") / (gravity * moment)
    second = Body(mass, moment / mass, beta * (1.0 - kappa) / (1.0 + kappa), weightless=weightless)
    first_moment = 0.0
    if gravity:
        carried = (1.0 - weightless) * mass * length
        first_moment = arm.need("gravity_torque_1") / gravity - carried
    return about_axis(alpha * (1.0 - kappa) / 2.0, first_moment, length), second


def about_axis(inertia: float, moment: float, length: float) -> Body:
    """A body with given inertia and first moment about its axis.

    m = 3 J/l^2 + s^2/J: a uniform rod's mass, and what keeps the inertia about the centre of mass,
    J - s^2/m, positive.

    Parameters
    ----------
    inertia : float [kg m^2]
        J > 0, about the axis.
    moment : float [kg m]
        s, first moment.
    length : float [m]
        l, of the rod.

    Returns
    -------
    Body
    """
    mass = 3.0 * inertia / length**2 + moment**2 / inertia
    return Body(mass, moment / mass, inertia - moment**2 / mass)


def told_of_gravity(arm: IdentifiedArm, bodies: tuple[Body, ...]) -> tuple[Caution, ...]:
    """Where masses alone miss the measured gravity torque of link 2 by more than a little."""
    off = bodies[-1].weightless
    if abs(off) < _WORTH_TELLING:
        return ()
    message = (
        f"gravity_torque_2 is {-100.0 * off:+.1f} % off g gamma/link_length, which a rigid body "
        "cannot be; check link_length and torque_per_volt"
    )
    return (Caution("gravity-torque", arm.source, message),)


def holds_motor(arm: IdentifiedArm) -> bool:
    """Whether the link's inertia has the motor's in it: a single link behind a rigid gear."""
    return arm.study.n_joints == 1 and arm.joint(1).spring == "rigid"


def _single_inertia(arm: IdentifiedArm) -> float:
    """The link's inertia, or mass; behind a rigid gear the motor's is in it."""
    inertia = arm.need("link_inertia", 1)
    if holds_motor(arm):
        inertia += arm.need("motor_inertia", 1) / arm.joint(1).gear_ratio ** 2
    if inertia <= 0.0:
        raise InvalidInput(
            f"the link's inertia is {inertia:g}, not positive",
            where=f"{arm.source}: parameters",
            remedy="record faster motions and identify again",
        )
    return inertia
