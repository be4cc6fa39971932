"""Ratios of the torque constants of joints, and suspicion of a wrong constant.

M(q) is symmetric, so the same base parameters act on coupled joints. The torques of two such joints
determine the ratio of their torque constants. A common factor of all joints is not identifiable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import (
    Channel,
    Clause,
    Consistency,
    Correction,
    FloatArray,
    Place,
    Study,
    Suspicion,
    channel_parts,
)
from strainwave.identification.rigid.filtered_record import n_compliances
from strainwave.identification.rigid.trial import Trial, excess_variance, neighbours
from strainwave.numerics import least_squares as ls

_MAX_ITERATIONS = 15  # maximum number of iterations
_TOLERANCE = 1e-3  # relative change at convergence
_MAX_FACTOR = 2.0  # maximum factor on a ratio in one iteration
_PRIOR_STD = 3.0  # prior standard deviation of the relative change, practically uninformative
_MAX_RELATIVE_STD = 0.5  # relative standard deviation above which a ratio is not identifiable
# Minimum significance of a ratio other than 1, in standard deviations.
_MIN_SIGNIFICANCE = 4.0
# Tolerated relative error; data sheets and amplifiers are accurate to a few percent.
_MAX_RATIO_ERROR = 0.03
# Largest factor that unmodelled effects can imitate.
_MAX_DOUBTFUL_FACTOR = 1.25
# Relative standard deviation above which messages state the factor as approximate.
_MIN_APPROXIMATE_STD = 0.02


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
    root, n = trial.factor.root, trial.arm.n_joints - 1
    ratios = np.ones(n)
    unknown = np.full(n, np.nan), np.full(n, np.nan)
    factor = trial.factor
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


def suspect_torque_constants(
    ratios: Mapping[int, tuple[float, float]], study: Study
) -> Suspicion | None:
    """Suspicion of a wrong torque constant if a torque ratio differs significantly from 1.

    `ratios` has the ratio of the torque-constant error of joint 1 to that of each other joint, from
    the symmetry of M(q), and its standard deviation.
    """
    wrong = {
        joint: (value, std)
        for joint, (value, std) in ratios.items()
        if abs(value - 1.0) > max(_MIN_SIGNIFICANCE * std, _MAX_RATIO_ERROR)
    }
    if not wrong:
        return None
    joint = max(wrong, key=lambda each: abs(wrong[each][0] - 1.0) / max(wrong[each][1], 1e-300))
    value, std = wrong[joint]
    is_precise = std < _MIN_APPROXIMATE_STD * value
    factor = Clause("factor" if is_precise else "factor/about", value=value)
    logged = any(channel_parts(name)[0] == "torque" for name in study.channels)
    remedy = "remedy/logged-torques" if logged else "remedy/torque-constants"
    # of joint 1; the signals do not determine which of the two constants is wrong
    corrections: tuple[Correction, ...] = ()
    if logged:
        scale = study.channels.get("torque1", Channel("torque1")).scale / value
        corrections = (Correction("channels", "torque1", "scale", scale),)
    elif constant := study.arm.joints[0].known_torque_per_volt:
        corrections = (Correction("joint", "1", "torque_per_volt", constant / value),)
    return Suspicion(
        code="wrong-torque-constant",
        places=(Place(key="torque_per_volt"),),
        clause=Clause("wrong-torque-constant", factor=factor, std=std, joint=joint),
        remedy_clause=Clause(remedy, factor=factor, joint=joint),
        factor=value,
        corrections=corrections,
    )


def find_doubtful_torque_constant(consistency: Consistency) -> Suspicion | None:
    """The only suspicion, if it is a wrong torque constant with a factor near 1; else None.

    The rigid fit assumes Coulomb and viscous friction and a linear drive. Other friction terms or
    a nonlinear drive can violate the symmetry of M(q) in the same way as a wrong torque constant.
    """
    if len(consistency.deciding) != 1:
        return None
    (suspicion,) = consistency.deciding
    is_near_one = (
        suspicion.factor is not None
        and 1.0 / _MAX_DOUBTFUL_FACTOR < suspicion.factor < _MAX_DOUBTFUL_FACTOR
    )
    return suspicion if suspicion.code == "wrong-torque-constant" and is_near_one else None
