"""Coordinates of an arm: the motor angles of its elastic joints, and all link angles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import ArmDescription, FloatArray
from strainwave.domain.base_parameters import transmission


@dataclass(frozen=True, slots=True, eq=False)
class Coordinates:
    """Motor angles and torsions as linear functions of the coordinates."""

    elastic: tuple[int, ...]  # joints, from 1, whose motors come first
    motor_angles: FloatArray  # theta_M, (n_joints, n_elastic + n_joints)
    torsions: FloatArray  # C N theta_M - q of the elastic joints, (n_elastic, n_elastic + n_joints)

    def has_own_motor(self, joint: int) -> bool:
        """Whether the motor of a rigid joint, from 1, turns with this joint's link only."""
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
