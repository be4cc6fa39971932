"""Base parameters -> rigid bodies that have them, as the arm's kind chooses among many."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from strainwave.domain import Diagnostic
from strainwave.domain.combinations import is_rigid_drive
from strainwave.domain.kinds import kind_of
from strainwave.domain.kinds.bodies import Body
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm

_WORTH_TELLING = 0.01  # of a gravity torque


def link_bodies(arm: IdentifiedArm, gravity: float) -> tuple[Body, ...]:
    """Bodies whose base parameters are the arm's.

    The motion of an arm identifies only its base parameters; many sets of masses share them.

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
    with _refusing(arm):
        return kind_of(arm.study.arm).bodies(arm.study.arm, arm.need, gravity)


def effective_gravity(arm: IdentifiedArm) -> float:
    """Gravity under which rigid bodies have all measured gravity torques.

    It is the study's but for the errors of what is identified.

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
    with _refusing(arm):
        return kind_of(arm.study.arm).effective_gravity(arm.study.arm, arm.need)


@contextmanager
def _refusing(arm: IdentifiedArm) -> Iterator[None]:
    """Refusals that say where the parameters come from."""
    try:
        yield
    except InvalidInput as error:
        where = error.where or f"{arm.source}: parameters"
        raise InvalidInput(error.problem, where=where, remedy=error.remedy) from error


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
    return is_rigid_drive(arm.study.arm)
