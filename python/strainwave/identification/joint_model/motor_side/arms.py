"""Arms that a search among gears goes through: few coordinates a joint, the rest as rigid.

The rigid model knows each joint's inertia on the whole, c_1 = m_M + n^2 m_L, its viscous friction
c_0 = d_M + n^2 d_L and its Coulomb friction. What remains is how the inertia is shared between
motor and link, and the gear. Of a single joint without a rigid model c_1 and c_0 are searched for,
too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray, RigidModel
from strainwave.domain.kinds import kind_of
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.interaction_torque import base_parameters, total_inertias
from strainwave.dynamics.two_inertia import TwoInertia
from strainwave.identification.joint_model.motor_side.impedance import LinearArm

PER_JOINT = 3
"""Coordinates of each joint: log k, log d_G, and the log odds of the motor's share of c_1."""

_STEP = 1e-4  # [rad] of a central difference
_LEAST_DEVIATION = 0.02  # of a motor inertia that the rigid model knows apart from the link's
_START_VISCOUS = 0.5  # [1/s] c_0 over c_1 where a search for it starts
_SPLIT = 0.5  # of the viscous friction, which motor signals do not part


@dataclass(frozen=True, slots=True)
class Posture:
    """What each base parameter adds to the arm's inertia and to gravity's stiffness there."""

    inertia: FloatArray  # (n_base, n_joints, n_joints) of M(q)
    gravity: FloatArray  # (n_base, n_joints, n_joints) of the slope of gravity's torques


def posture_of(arm: Arm, angle: FloatArray) -> Posture:
    """The arm's inertia and gravity in a posture, by base parameter.

    `angle` (n_joints,) [rad]: Of the links.
    """
    unit = np.eye(len(arm.base_names))
    inertia = np.stack([arm.inertia_matrix(one, angle) for one in unit])
    return Posture(inertia, _gravity_slopes(arm, angle))


@dataclass(frozen=True, slots=True)
class Family:
    """All arms that agree with a rigid model."""

    arm: Arm
    ratio: FloatArray  # (n_joints,)
    total_inertia: FloatArray | None  # (n_joints,) c_1 [kg m^2] at the motors; None: searched for
    total_viscous: FloatArray | None  # (n_joints,) c_0 [N m s/rad]; None with the above
    coulomb: FloatArray | None  # (n_joints,) [N m]; None: whatever explains the records best
    base: FloatArray  # (n_base,) of the links, where it is not a link's own inertia
    known_share: FloatArray  # (n_joints,) motor's share of c_1 that the rigid model knows; NaN
    known_deviation: FloatArray  # (n_joints,) of the log of that motor inertia

    @property
    def n_joints(self) -> int:
        """How many joints."""
        return len(self.ratio)

    @property
    def n_coordinates(self) -> int:
        """Length of a point."""
        return self.n_joints * (PER_JOINT + (2 if self.total_inertia is None else 0))

    def point(
        self, ring: FloatArray, share: FloatArray, damping: float, total: FloatArray | None = None
    ) -> FloatArray:
        """Coordinates of an arm by its anti-resonances: (n_coordinates,).

        `ring` (n_joints,) [rad/s]: sqrt(k / m_L) of each joint.
        `share` (n_joints,): The motor's, of each c_1.
        `damping`: Ratio of the anti-resonances.
        `total` (n_joints,) [kg m^2]: c_1, where the rigid model does not know it.
        """
        c1 = np.asarray(self.total_inertia if total is None else total)
        link = (1.0 - share) * c1 / self.ratio**2
        gears = [np.log(ring**2 * link), np.log(2.0 * damping * ring * link)]
        blocks = np.column_stack([*gears, np.log(share / (1.0 - share))]).ravel()
        if self.total_inertia is not None:
            return blocks
        return np.concatenate([blocks, np.log(c1), np.log(_START_VISCOUS * c1)])

    def parts(self, points: FloatArray) -> dict[str, FloatArray]:
        """Physical parameters of the joints at points.

        Returns: Of (..., n_joints) each, by the names of `TwoInertia`.
        """
        n = self.n_joints
        own = points[..., : PER_JOINT * n].reshape(*points.shape[:-1], n, PER_JOINT)
        share = 1.0 / (1.0 + np.exp(-own[..., 2]))
        total, viscous = self.total_inertia, self.total_viscous
        if total is None or viscous is None:
            total, viscous = np.exp(points[..., -2 * n : -n]), np.exp(points[..., -n:])
        viscous = np.broadcast_to(viscous, share.shape)
        return {
            "motor_inertia": share * total,
            "motor_viscous_friction": _SPLIT * viscous,
            "link_inertia": (1.0 - share) * total / self.ratio**2,
            "link_viscous_friction": (1.0 - _SPLIT) * viscous / self.ratio**2,
            "gear_stiffness": np.exp(own[..., 0]),
            "gear_damping": np.exp(own[..., 1]),
        }

    def joints(self, point: FloatArray) -> list[TwoInertia]:
        """Each joint on its own: (n_coordinates,) -> n_joints."""
        parts = self.parts(point)
        return [
            TwoInertia(**{name: float(x[i]) for name, x in parts.items()}, gear_ratio=float(n))
            for i, n in enumerate(self.ratio)
        ]

    def proper(self, points: FloatArray) -> FloatArray:
        """Where the inertia matrix is positive definite, the arm stretched and at right angles.

        (..., n_coordinates) -> (...,) of bool.
        """
        base = self._base(self.parts(points)["link_inertia"])
        fine = np.ones(points.shape[:-1], dtype=bool)
        for angle in (0.0, 0.5 * np.pi):
            posture = posture_of(self.arm, np.full(self.n_joints, angle))
            inertia = np.tensordot(base, posture.inertia, axes=1)
            fine &= np.linalg.eigvalsh(inertia)[..., 0] > 0.0
        return np.asarray(fine)

    def linear(self, points: FloatArray, posture: Posture) -> LinearArm:
        """The arms about a posture."""
        parts = self.parts(points)
        base = self._base(parts.pop("link_inertia"))
        inertia = np.asarray(np.tensordot(base, posture.inertia, axes=1))
        gravity = np.asarray(np.tensordot(base, posture.gravity, axes=1))
        return LinearArm(gear_ratio=self.ratio, inertia=inertia, gravity=gravity, **parts)

    def _base(self, link_inertia: FloatArray) -> FloatArray:
        """Base parameters of arms whose links, stretched, have these inertias: (..., n_base)."""
        base = np.broadcast_to(self.base, (*link_inertia.shape[:-1], len(self.base))).copy()
        at = {key: k for k, key in enumerate(self.arm.base_names)}
        for key, row in kind_of(self.arm).from_link_inertias:
            base[..., at[key]] = sum(
                weight * (link_inertia[..., of - 1] if of else base[..., at[name, of]])
                for (name, of), weight in row.items()
            )
        return base


def family_of(model: RigidModel | None, arm: Arm) -> Family:
    """All arms that agree with a rigid model; without one, all single joints.

    `model`: None will do for a single joint without gravity.

    Raises `NotIdentifiable`: the rigid model lacks an inertia.
    """
    n = arm.n_joints
    ratio, nothing = arm.gear_ratios, np.full(n, np.nan)
    if model is None:
        base = np.zeros(len(arm.base_names))
        return Family(arm, ratio, None, None, None, base, nothing, nothing)
    total = total_inertias(model, arm)
    share, deviation = nothing.copy(), nothing.copy()
    for parameter in model.parameters:
        named = parameter.name == "motor_inertia" and parameter.joint is not None
        if named and parameter.value and parameter.value > 0.0:
            i = (parameter.joint or 1) - 1
            share[i] = min(0.95, parameter.value / total[i])
            own = (parameter.std or 0.0) / parameter.value
            deviation[i] = max(own, _LEAST_DEVIATION)
    return Family(
        arm,
        ratio,
        total,
        np.array([_least(model, "total_viscous_friction", i, total[i - 1]) for i in _numbers(n)]),
        np.array([max(0.0, _value(model, "motor_coulomb_friction", i)) for i in _numbers(n)]),
        base_parameters(model, arm),
        share,
        deviation,
    )


def _numbers(n: int) -> Sequence[int]:
    return range(1, n + 1)


def _value(model: RigidModel, name: str, joint: int) -> float:
    return model.value(name, joint) or 0.0


def _least(model: RigidModel, name: str, joint: int, inertia: float) -> float:
    """A viscous friction that may be nothing by the rigid model: it stops the joint in minutes."""
    return max(_value(model, name, joint), 0.01 * float(inertia))


def _gravity_slopes(arm: Arm, angle: FloatArray) -> FloatArray:
    """Derivative of gravity's torques by the links' angles, by base parameter: (n_base, n, n)."""
    n = arm.n_joints
    moved = np.concatenate([angle + _STEP * np.eye(n), angle - _STEP * np.eye(n)])
    still = np.zeros_like(moved)
    regressor = arm.base_regressor(moved, still, still)  # (2n, n, n_base)
    slope = (regressor[:n] - regressor[n:]) / (2.0 * _STEP)  # by angle, torque, parameter
    return np.asarray(np.transpose(slope, (2, 1, 0)))
