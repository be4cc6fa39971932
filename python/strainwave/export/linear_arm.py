"""The whole arm as one linear state-space model, at zero link angles and at rest.

With the coordinates p = (theta_M, q), motor angles of the elastic joints and all link angles, (1)
and (2) are

    M ddp + D dp + K p = P tau_M

with deviations p and tau_M from equilibrium: M has the motor inertias and M(q), K the gears and the
slope of gravity dg/dq, and P transmits torques to motors behind rigid gears.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import ArmDescription, FloatArray
from strainwave.domain.arm.base_parameters import transmission
from strainwave.domain.keys import JointNumber
from strainwave.dynamics.arm import Arm
from strainwave.export.source import IdentifiedArm


@dataclass(frozen=True, slots=True, eq=False)
class Coordinates:
    """Motor angles and torsions as linear functions of the coordinates."""

    elastic: tuple[int, ...]  # joints, from 1, whose motors come first
    motor_angles: FloatArray  # theta_M, (n_joints, n_elastic + n_joints)
    torsions: FloatArray  # C N theta_M - q of the elastic joints, (n_elastic, n_elastic + n_joints)

    def has_own_motor(self, joint: JointNumber) -> bool:
        """Whether the motor of a rigid joint turns with this joint's link only."""
        others = np.delete(self.motor_angles[joint - 1], len(self.elastic) + joint - 1)
        return not others.any()


def coordinates_of(arm: ArmDescription) -> Coordinates:
    """Coordinates of an arm; a transmission couples only rigid or only elastic joints."""
    ratios, is_rigid = transmission(arm), [not joint.elastic for joint in arm.joints]
    elastic = np.flatnonzero(np.logical_not(is_rigid))
    behind_rigid_gears = np.where(is_rigid, np.linalg.inv(ratios).T, 0.0).T
    motors = np.hstack([np.eye(arm.n_joints)[:, elastic], behind_rigid_gears])
    links = np.eye(arm.n_joints, motors.shape[1], k=len(elastic))
    torsions = (ratios @ motors - links)[elastic]
    return Coordinates(tuple((elastic + 1).tolist()), motors, torsions)


@dataclass(frozen=True, slots=True, eq=False)
class LinearArm:
    """dx/dt = A x + B u, y = C x + D u with the named states, inputs and outputs.

    Names end with the number of the joint: angles and velocities of the elastic joints' motors and
    of the links, motor torques, motor velocities and link accelerations.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray

    @property
    def matrices(self) -> dict[str, FloatArray]:
        """The matrices by name."""
        return {"A": self.A, "B": self.B, "C": self.C, "D": self.D}


def linear_arm(arm: IdentifiedArm) -> LinearArm:
    """All joints, coupled by links, gravity and transmission; Coulomb friction is neglected.

    Raises `InvalidInput` if a parameter is missing or not physical.
    """
    n, coordinates = arm.study.arm.n_joints, coordinates_of(arm.study.arm)
    motors, torsions = coordinates.motor_angles, coordinates.torsions
    numbers, size = range(1, n + 1), motors.shape[1]
    links = np.eye(n, size, k=size - n)
    inertia, gravity = _links_at_rest(arm)

    def combine(of_motors: list[float], of_gears: list[float], of_links: FloatArray) -> FloatArray:
        """Quadratic form of motors, torsions and links over the coordinates."""
        form = motors.T @ np.diag(of_motors) @ motors + torsions.T @ np.diag(of_gears) @ torsions
        return np.asarray(form + links.T @ of_links @ links)

    def of_motors(name: str) -> list[float]:
        return [arm.need(name, number) for number in numbers]

    def of_gears(name: str | None = None) -> list[float]:
        laws = ((number, arm.joint(number).law) for number in coordinates.elastic)
        return [arm.need(name or law.linearised_by, number) for number, law in laws]

    none = [0.0] * len(coordinates.elastic)
    M = combine(of_motors("motor_inertia"), none, inertia)
    viscous = np.diag(of_motors("link_viscous_friction"))
    damping = combine(of_motors("motor_viscous_friction"), of_gears("gear_damping"), viscous)
    K = combine([0.0] * n, of_gears(), gravity)
    acceleration = np.linalg.solve(M, np.hstack([-K, -damping, motors.T]))
    A = np.vstack([np.eye(size, 2 * size, k=size), acceleration[:, : 2 * size]])
    B = np.vstack([np.zeros((size, n)), acceleration[:, 2 * size :]])
    velocities = np.hstack([np.zeros_like(motors), motors])
    of_elastic = [f"motor_{{}}_{number}" for number in coordinates.elastic]
    names = [*of_elastic, *(f"link_{{}}_{number}" for number in numbers)]
    return LinearArm(
        states=tuple(name.format(kind) for kind in ("angle", "velocity") for name in names),
        inputs=tuple(f"motor_torque_{number}" for number in numbers),
        outputs=tuple(
            f"{kind}_{number}" for kind in ("motor_velocity", "link_acceleration")
            for number in numbers
        ),
        A=A,
        B=B,
        C=np.vstack([velocities, A[-n:]]),
        D=np.vstack([np.zeros((n, n)), B[-n:]]),
    )  # fmt: skip


def _links_at_rest(arm: IdentifiedArm) -> tuple[FloatArray, FloatArray]:
    """M(0) and the slope of gravity dg/dq at zero link angles, both (n_joints, n_joints)."""
    dynamics = Arm.of(arm.study.arm)
    effective = dynamics.base.effective
    base = np.array([arm.need(*key) if key in effective else 0.0 for key in dynamics.base_names])
    # gravity torques are sinusoids of each angle and linear in each displacement, so that these
    # steps give the exact slope
    is_prismatic = [joint.motion == "prismatic" for joint in dynamics.joints]
    steps = np.diag(np.where(is_prismatic, 1.0, 0.5 * np.pi))
    rest = np.zeros_like(steps)
    ahead, behind = (dynamics.link_torques(base, sign * steps, rest, rest) for sign in (1.0, -1.0))
    return dynamics.inertia_matrix(base, np.zeros(len(steps))), 0.5 * (ahead - behind).T
