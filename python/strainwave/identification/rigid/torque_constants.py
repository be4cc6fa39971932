"""Estimate the ratios of the joints' torque constants from the symmetry of M(q).

M(q) is symmetric, so the same base parameters act on coupled joints. The torques of two such joints
determine the ratio of their torque constants. A common factor of all joints is not identifiable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.identification.rigid.bandwidth import excess_variance, neighbours
from strainwave.identification.rigid.filtered_record import n_compliances
from strainwave.identification.rigid.trial import Trial
from strainwave.numerics import least_squares as ls

_MAX_ITERATIONS = 15  # maximum number of iterations
_TOLERANCE = 1e-3  # relative change at convergence
_MAX_FACTOR = 2.0  # maximum factor on a ratio in one iteration
_PRIOR_STD = 3.0  # prior standard deviation of the relative change, practically uninformative
_MAX_RELATIVE_STD = 0.5  # relative standard deviation above which a ratio is not identifiable


def torque_ratios(
    trials: Sequence[Trial], best: Trial, plain: Trial
) -> dict[int, tuple[float, float]]:
    """Torque of joint 1 over that of each further joint, relative to the study, by joint.

    Each ratio has a standard deviation, which includes the scatter between neighbouring bandwidths
    and the difference from `plain`, the fit without further terms of friction: friction that grows
    with the load acts as another torque constant. Ratios that the motion does not determine are
    omitted.
    """
    if best.arm.n_joints < 2:
        return {}
    values, variances = _ratios_at(best)
    if np.isnan(values).all():
        return {}
    others = [_ratios_at(trial) for trial in neighbours(trials, best)]
    plain_values = values if plain is best else _ratios_at(plain)[0]
    ratios = {}
    for k, value in enumerate(values.tolist()):
        if np.isnan(value):
            continue
        pairs = [(other[k], error[k]) for other, error in others if np.isfinite(other[k])]
        variance = variances[k] + float(excess_variance(value, pairs))
        if np.isfinite(plain_values[k]):
            variance += (plain_values[k] - value) ** 2
        ratios[k + 2] = 1.0 / value, float(np.sqrt(variance)) / value**2
    return ratios


def _ratios_at(trial: Trial) -> tuple[FloatArray, FloatArray]:
    """Torques of joints 2 and further over those that joint 1 and the symmetry of M(q) imply.

    Returns the ratios at one bandwidth, NaN if not identifiable, and their variances, both
    (n_joints - 1,).

    The rows of joint i have the additional unknown r_i: B_i (r_i theta) + F_i phi_i = tau_i, with
    theta shared by all joints and r_1 = 1. Gauss-Newton solves for theta and all r_i. The column of
    r_i is the model torque B_i theta; with the measured torque, noise would bias r_i towards zero.
    """
    equations, root = trial.equations, trial.factor.root
    n = trial.arm.n_joints - 1
    ratios = np.ones(n)
    unknown = np.full(n, np.nan), np.full(n, np.nan)
    factor = ls.factorise(equations, root)
    for _ in range(_MAX_ITERATIONS):
        scaled = _scale(trial, factor.value, ratios)
        factor = ls.factorise(scaled, root)
        step = factor.common[-n:] / ratios
        if not np.isfinite(step).all():
            return unknown
        if np.all(np.abs(step) < _TOLERANCE):
            variance = ls.jackknife(scaled, factor)[1][-n:]
            is_identified = variance < (_MAX_RELATIVE_STD * ratios) ** 2
            return np.where(is_identified, ratios * (1.0 + step), np.nan), variance
        ratios = ratios * np.clip(1.0 + step, 1.0 / _MAX_FACTOR, _MAX_FACTOR)
        root = ls.root_weights(scaled, factor)
    return unknown


def _scale(trial: Trial, solution: FloatArray, ratios: FloatArray) -> ls.Equations:
    """Multiply torques that couple joints by ratios and add columns for their relative changes."""
    equations, arm = trial.equations, trial.arm
    coupling = np.r_[: arm.n_body, len(solution) - arm.n_shared : len(solution)]
    factor = np.append(1.0, ratios)[equations.group]
    is_of_joint = equations.group[:, None] == np.arange(1, len(ratios) + 1)
    torque = equations.shared[:, coupling] @ solution[coupling]
    shared = equations.shared.copy()
    shared[:, coupling] *= factor[:, None]
    # the common unknowns are compliances, then terms of friction; only compliances are linearised
    n = n_compliances(trial.arm)
    lag = equations.common[:, :n] @ trial.estimate.compliance[:n]
    return replace(
        equations,
        shared=shared,
        common=np.column_stack([equations.common * factor[:, None], torque[:, None] * is_of_joint]),
        common_deviation=np.append(equations.common_deviation, _PRIOR_STD * ratios),
        target=equations.target + (factor - 1.0) * lag,
    )
