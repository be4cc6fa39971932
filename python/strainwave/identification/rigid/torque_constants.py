"""Estimate the ratio of the torque constants of two joints from the symmetry of M(q).

M(q) is symmetric: beta and gamma appear in the torques of both joints, and G2 acts on both. The
torques of joint 1 and joint 2 therefore determine the ratio of their torque constants. A common
factor of both is not identifiable.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.dynamics.arm import Arm
from strainwave.numerics import least_squares as ls

_MAX_ITERATIONS = 15  # maximum number of iterations
_TOLERANCE = 1e-3  # relative change at convergence
_MAX_FACTOR = 2.0  # maximum factor on the ratio in one iteration
_PRIOR_STD = 3.0  # prior standard deviation of the relative change, practically uninformative
_MAX_RELATIVE_STD = 0.5  # relative standard deviation above which the ratio is not identifiable
_JOINT_2_GROUP = 1  # group of the rows of joint 2


@dataclass(frozen=True, slots=True)
class TorqueRatio:
    """Torque of joint 2 over the torque that joint 1 and the symmetry of M(q) imply."""

    value: float
    variance: float


def torque_ratio(
    arm: Arm, equations: ls.Equations, root: FloatArray, compliance: FloatArray
) -> TorqueRatio | None:
    """Ratio r of the torques of joint 2 to those that the torques of joint 1 imply.

    The rows of joint 2 have the additional unknown r: B_2 (r theta) + F_2 phi_2 = tau_2, with theta
    shared by both joints. Gauss-Newton solves for (theta, r). The column of r is the model torque
    B_2 theta; with the measured torque, noise would bias r towards zero.

    `equations` are those of a converged rigid fit, `root` (n_rows,) the square roots of its
    weights, and `compliance` (n_elastic,) the compliances of its linearisation.

    Returns None for an arm without two joints, if the iteration does not converge, or if the motion
    does not determine the ratio.
    """
    if arm.n_joints != 2:
        return None
    ratio = 1.0
    factor = ls.factorise(equations, root)
    for _ in range(_MAX_ITERATIONS):
        scaled = _scaled(arm, equations, compliance, factor.value, ratio)
        factor = ls.factorise(scaled, root)
        step = float(factor.common[-1]) / ratio
        if not np.isfinite(step):
            return None
        if abs(step) < _TOLERANCE:
            variance = float(ls.jackknife(scaled, factor)[1][-1])
            identified = variance < _MAX_RELATIVE_STD**2 * ratio**2
            return TorqueRatio(ratio * (1.0 + step), variance) if identified else None
        ratio *= float(np.clip(1.0 + step, 1.0 / _MAX_FACTOR, _MAX_FACTOR))
        root = ls.root_weights(scaled, factor)
    return None


def _scaled(
    arm: Arm,
    equations: ls.Equations,
    compliance: FloatArray,
    solution: FloatArray,
    ratio: float,
) -> ls.Equations:
    """Multiply the body torques of joint 2 by a ratio and add a column for its relative change."""
    is_joint_2 = equations.group == _JOINT_2_GROUP
    n = arm.n_body
    shared, common = equations.shared.copy(), equations.common.copy()
    torque = shared[:, :n] @ solution[:n] * is_joint_2
    lag = common @ compliance if common.shape[1] else np.zeros(len(torque))
    target = equations.target + (ratio - 1.0) * lag * is_joint_2
    shared[is_joint_2, :n] *= ratio
    common[is_joint_2] *= ratio
    return replace(
        equations,
        shared=shared,
        common=np.column_stack([common, torque]),
        common_deviation=np.append(equations.common_deviation, _PRIOR_STD * ratio),
        target=target,
    )
