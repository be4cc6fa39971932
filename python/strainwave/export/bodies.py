"""Rigid bodies that have the base parameters of an arm."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from strainwave.domain import ArmDescription, Diagnostic, FloatArray, LinkPrior, Place
from strainwave.domain.base_parameters import MOTOR_INERTIA
from strainwave.domain.combinations import is_rigid_drive
from strainwave.domain.consistent_links import standard_parameters
from strainwave.domain.kinds import arm_keys, kind_of
from strainwave.domain.kinds.base import Body
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm
from strainwave.io.base_parameters import motor_regressor

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


def standard_links(arm: IdentifiedArm, gravity: float) -> list[LinkPrior]:
    """Standard parameters of `link_bodies`."""
    links = []
    for body in link_bodies(arm, gravity):
        xx, yy, zz, xy, xz, yz = body.inertia
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        links.append(standard_parameters(body.mass, np.array(body.centre), inertia))
    return links


def rotor_inertias(arm: IdentifiedArm) -> list[float]:
    """Inertias of the motors that the links do not include."""
    numbers = range(1, arm.study.arm.n_joints + 1)
    return [0.0 if holds_motor(arm) else arm.need(MOTOR_INERTIA, number) for number in numbers]


def chain_of(arm: IdentifiedArm, gravity: float) -> ArmDescription:
    """The arm as a chain of bodies under a gravity [m/s^2] of the study's direction."""
    description = arm.study.arm
    vector = np.array(description.gravity or (0.0, 0.0, 0.0))
    x, y, z = (vector * gravity / (description.gravity_size or 1.0)).tolist()
    return replace(description, kind="serial", gravity=(x, y, z) if gravity else None)


def body_torques(arm: IdentifiedArm, motion: FloatArray, gravity: float) -> FloatArray:
    """Torques of links, rotors and link friction for a motion of the motors: (n_samples, n)."""
    bodies = np.concatenate([*standard_links(arm, gravity), rotor_inertias(arm)])
    description = Arm.of(arm.study.arm)
    viscous = [arm.need("link_viscous_friction", i + 1) for i in range(description.n_joints)]
    friction = description.motors_of(description.links_of(motion[1]) * viscous)
    return np.asarray(motor_regressor(chain_of(arm, gravity), motion) @ bodies + friction)


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
