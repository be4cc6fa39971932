"""Rigid equations of two joints -> the ratio of their torque constants' errors.

M(q) is symmetric: beta and gamma couple either joint to the other by the same torque, and G2 acts
on both. So joint 1's torques, with joint 2's, show whether both are measured in the same unit. One
overall factor of both is beyond any signal of the arm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.dynamics.arm import Arm
from strainwave.numerics import least_squares as ls

_ROUNDS = 15
_SETTLED = 1e-3
_LARGEST_STEP = 2.0  # by which the ratio changes in one round
_UNKNOWN = 3.0  # prior deviation of a round's change: as good as none
_VAGUE = 0.5  # relative deviation from which nothing is known
_SECOND = 1  # group of joint 2's rows


@dataclass(frozen=True, slots=True)
class TorqueRatio:
    """Torque of joint 2 over what joint 1's torques and the symmetry of M(q) imply."""

    value: float
    variance: float


def torque_ratio(
    arm: Arm, equations: ls.Equations, root: FloatArray, compliance: FloatArray
) -> TorqueRatio | None:
    """By what joint 2's torques differ from those that joint 1's torques imply.

    One more unknown, r, in joint 2's rows: B_2 (r theta) + F_2 phi_2 = tau_2, with theta shared
    by both joints. Gauss-Newton about (theta, r): the column of r is the model's torque B_2 theta,
    not the measured one, whose noise would draw r towards nothing.

    `equations`: Of a rigid fit that has settled.
    `root` (n_rows,): Square roots of its weights.
    `compliance` (n_elastic,): Of elastic joints, which the equations were built around.

    Returns: None of a single joint, and where the rounds do not settle: the motion does not show
    it.
    """
    if arm.n_joints != 2:
        return None
    ratio = 1.0
    factor = ls.factorise(equations, root)
    for _ in range(_ROUNDS):
        scaled = _scaled(arm, equations, compliance, factor.value, ratio)
        factor = ls.factorise(scaled, root)
        step = float(factor.common[-1]) / ratio
        if not np.isfinite(step):
            return None
        if abs(step) < _SETTLED:
            variance = float(ls.jackknife(scaled, factor)[1][-1])
            identified = variance < _VAGUE**2 * ratio**2
            return TorqueRatio(ratio * (1.0 + step), variance) if identified else None
        ratio *= float(np.clip(1.0 + step, 1.0 / _LARGEST_STEP, _LARGEST_STEP))
        root = ls.root_weights(scaled, factor)
    return None


def _scaled(
    arm: Arm,
    equations: ls.Equations,
    compliance: FloatArray,
    solution: FloatArray,
    ratio: float,
) -> ls.Equations:
    """Joint 2's body torques times a ratio, and a column for that ratio's change."""
    second = equations.group == _SECOND
    n = arm.n_body
    shared, common = equations.shared.copy(), equations.common.copy()
    torque = shared[:, :n] @ solution[:n] * second
    lag = common @ compliance if common.shape[1] else np.zeros(len(torque))
    target = equations.target + (ratio - 1.0) * lag * second
    shared[second, :n] *= ratio
    common[second] *= ratio
    return replace(
        equations,
        shared=shared,
        common=np.column_stack([common, torque]),
        common_deviation=np.append(equations.common_deviation, _UNKNOWN * ratio),
        target=target,
    )
