"""Base parameters -> rigid bodies that have them.

The motion of an arm identifies only alpha, beta, gamma and the gravity torques; many sets of masses
share them. Chosen here, for two links with kappa = gamma^2/(alpha beta), which is below one where
the inertia matrix is positive definite:

    m2 l1^2 = alpha (1 + kappa)/2,   m2 lc2 = gamma/l1,   I2 = beta (1 - kappa)/(1 + kappa)

so that the rest, for link 1, alpha (1 - kappa)/2, and I2 are positive for every such arm. Link 1
is `about_axis` with what gravity shows of its first moment.
"""

from __future__ import annotations

from dataclasses import dataclass

from strainwave.domain import Diagnostic
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm

_WORTH_TELLING = 0.01  # of a gravity torque
_ASSUMED_LENGTH = 1.0  # [m] of a single link whose study names none


@dataclass(frozen=True, slots=True)
class Body:
    """One link as a rigid body; its centre of mass lies on its x axis."""

    mass: float  # [kg]
    centre: float  # [m] from its own axis; negative beyond it
    inertia: float  # [kg m^2] about the centre of mass


def link_bodies(arm: IdentifiedArm, gravity: float) -> tuple[Body, ...]:
    """Bodies whose base parameters are the arm's.

    Parameters
    ----------
    arm : IdentifiedArm
    gravity : float [m/s^2]
        Under which link 1 has the measured gravity torque; zero: its centre lies on the axis.

    Returns
    -------
    tuple of Body
        One a link, from the base.

    Raises
    ------
    InvalidInput
        A base parameter is null or not there, or no bodies have these.
    """
    length = arm.study.arm.link_length or _ASSUMED_LENGTH
    if arm.study.arm.n_joints == 1:
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
    second = Body(mass, moment / mass, beta * (1.0 - kappa) / (1.0 + kappa))
    first_moment = arm.need("gravity_torque_1") / gravity - mass * length if gravity else 0.0
    return about_axis(alpha * (1.0 - kappa) / 2.0, first_moment, length), second


def effective_gravity(arm: IdentifiedArm) -> float:
    """Gravity under which rigid bodies have all measured gravity torques: G2 l1/gamma.

    It is the study's but for the errors of G2 and gamma.

    Parameters
    ----------
    arm : IdentifiedArm

    Returns
    -------
    float [m/s^2]
        Zero for a horizontal arm.

    Raises
    ------
    InvalidInput
        A parameter is null or not there, or the two contradict each other.
    """
    gravity = arm.study.arm.gravity or 0.0
    if not gravity or arm.study.arm.n_joints == 1:
        return gravity
    torque, gamma = arm.need("gravity_torque_2"), arm.need("gamma")
    if torque * gamma <= 0.0:
        raise InvalidInput(
            f"gravity_torque_2 = {torque:g} N m and gamma = {gamma:g} kg m^2 put the centre of "
            "link 2 on opposite sides of its axis",
            where=f"{arm.source}: parameters",
            remedy="record faster motions of both joints and identify again",
        )
    return torque * (arm.study.arm.link_length or _ASSUMED_LENGTH) / gamma


def about_axis(inertia: float, moment: float, length: float) -> Body:
    """A body with given inertia and first moment about its axis.

    m = 3 J/l^2 + s^2/J: a uniform rod's mass, and what keeps the inertia about the centre of mass,
    J - s^2/m = (3 J/l^2) J/m, positive.

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
    rod = 3.0 * inertia / length**2
    mass = rod + moment**2 / inertia
    return Body(mass, moment / mass, inertia * rod / mass)


def known_of_gravity(arm: IdentifiedArm) -> tuple[Diagnostic, ...]:
    """Where bodies under the study's gravity miss the torque of link 2 by more than a little."""
    gravity = arm.study.arm.gravity or 0.0
    if not gravity or abs(off := effective_gravity(arm) / gravity - 1.0) < _WORTH_TELLING:
        return ()
    message = (
        f"gravity_torque_2 is {100.0 * off:+.1f} % off g gamma/link_length, which it is for "
        "rigid bodies; check gravity, link_length and torque_per_volt"
    )
    return (Diagnostic("gravity-torque", arm.source, message),)


def holds_motor(arm: IdentifiedArm) -> bool:
    """Whether the link's inertia has the motor's in it: a single link behind a rigid gear."""
    return arm.study.arm.n_joints == 1 and arm.joint(1).spring == "rigid"


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
