"""Rigid bodies that have the base parameters of an arm."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from strainwave.domain import Diagnostic, Place
from strainwave.domain.combinations import is_rigid_drive
from strainwave.domain.kinds import arm_keys, kind_of
from strainwave.domain.kinds.bodies import Body
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm

_MAX_GRAVITY_ERROR = 0.01  # relative; errors of torque constants are smaller


def link_bodies(arm: IdentifiedArm, gravity: float) -> tuple[Body, ...]:
    """One body per link, from the base, with the base parameters of the arm.

    Motion identifies only base parameters; the kind of arm chooses one of the sets of masses that
    have them. Under `gravity` [m/s^2] link 1 has the measured gravity torque; without, its centre
    of mass is on the axis. Raises `InvalidInput` if a base parameter is missing or no bodies
    have these parameters.
    """
    with _source_in_message(arm):
        return kind_of(arm.study.arm).bodies(arm.study.arm, arm.need, gravity)


def effective_gravity(arm: IdentifiedArm) -> float:
    """Gravity [m/s^2] under which rigid bodies have all measured gravity torques.

    It differs from that of the study by the errors of the estimates, and is zero for a horizontal
    arm. Raises `InvalidInput` if a parameter is missing or the gravity torques contradict.
    """
    with _source_in_message(arm):
        return kind_of(arm.study.arm).effective_gravity(arm.study.arm, arm.need)


@contextmanager
def _source_in_message(arm: IdentifiedArm) -> Iterator[None]:
    try:
        yield
    except InvalidInput as error:
        where = error.where or f"{arm.source}: parameters"
        raise InvalidInput(error.problem, where=where, remedy=error.remedy) from error


def gravity_warnings(arm: IdentifiedArm) -> tuple[Diagnostic, ...]:
    """A warning if bodies under the gravity of the study miss a measured gravity torque."""
    gravity = arm.study.arm.gravity_size
    if not gravity:
        return ()
    error = effective_gravity(arm) / gravity - 1.0
    if abs(error) < _MAX_GRAVITY_ERROR:
        return ()
    law, keys = kind_of(arm.study.arm).gravity_note, tuple(arm_keys(arm.study.arm))
    place = Place(file=arm.source)
    return (Diagnostic("gravity-torque", place, law=law, error=error, keys=keys),)


def holds_motor(arm: IdentifiedArm) -> bool:
    """Whether the inertia of the link includes the motor: a single link behind a rigid gear."""
    return is_rigid_drive(arm.study.arm)
