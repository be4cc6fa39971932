"""Torques per volt of drives, from motions with and without a known payload.

The torque of motor i is e_i u_i, and a known payload adds the known torque p_i to the equations:

    Phi_i theta + p_i = e_i u_i

Without a payload, all parameters and all e_i have a common factor. Bodies couple the joints, so a
payload that one joint does not feel contributes to its gain through the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import (
    BoolArray,
    Diagnostic,
    DriveGains,
    FloatArray,
    IntArray,
    Parameter,
    Place,
    Signals,
)
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.rigid.equations import Estimate, assemble
from strainwave.identification.rigid.filtered_record import FilteredRecord
from strainwave.identification.rigid.trial import (
    Motion,
    Trial,
    bandwidths_of,
    excess_variance,
    fit_trial,
    neighbours,
    prepare_all,
    search_bandwidths,
    select_bandwidth,
)
from strainwave.numerics import least_squares as ls
from strainwave.numerics.parallel import one_blas_thread
from strainwave.signals.motor import period_of

_MAX_ITERATIONS = 15  # of the refinement
_TOLERANCE = 1e-4  # relative change of the gains at convergence
_MAX_FACTOR = 2.0  # on a gain in one iteration
_MAX_UNRESOLVED = 0.1  # component of a gain in a direction that the records do not determine
_MAX_RELATIVE_STD = 0.5  # above which a gain is not identifiable


def estimate_drive_gains(signals: Sequence[Signals], arm: Arm) -> DriveGains:
    """Estimate the unknown torques per volt of an arm from its motion records.

    The torques of `signals` are in volts for joints with an unknown drive. Raises NotIdentifiable
    if the records do not determine a gain.
    """
    joints = np.array(arm.unknown_drives) - 1
    with one_blas_thread():
        motions = [(s, period_of(s)) for s in signals]
        first = _first_gains(arm.behind_rigid_gears(), motions, joints)
        scale = _scale_of(arm, joints, first)
        scaled = [(_scaled(s, scale), period) for s, period in motions]
        trials = search_bandwidths(scaled, arm)
        best = select_bandwidth(trials)
        at_best = _refine(best, joints, np.ones(len(joints)))
        nearby = [_rescaled(t, joints, at_best.factor) for t in neighbours(trials, best)]
        others = [_refine(trial, joints, at_best.factor) for trial in nearby]
    pairs = [(np.log(o.factor), np.diag(o.covariance)) for o in others if o.identified.all()]
    excess = excess_variance(np.log(at_best.factor), pairs)
    covariance = at_best.covariance + np.diag(excess)
    gains, stds = first * at_best.factor, np.sqrt(np.diag(covariance))
    _require(joints, at_best.identified & (stds < _MAX_RELATIVE_STD) & (gains > 0.0))
    width = best.interval_half_width
    parameters = tuple(
        Parameter.estimated(
            ("torque_per_volt", joint + 1),
            gain,
            gain * std,
            "N m/V" if arm.joints[joint].motion == "revolute" else "N/V",
            "rigid",
            width,
        )
        for joint, gain, std in zip(joints.tolist(), gains.tolist(), stds.tolist(), strict=True)
    )
    warnings = [  # later stages take the estimates for exact
        Diagnostic(
            "estimated-drive",
            Place(joint=p.joint, parameter=p.name),
            value=p.value,
            share=(p.std or 0.0) / (p.value or 1.0),
        )
        for p in parameters
    ]
    return DriveGains(parameters, covariance, tuple(warnings))


def gain_sensitivity(trial: Trial, gains: DriveGains) -> FloatArray:
    """Changes of the rigid parameters per relative change of each gain: (n_parameters, n_gains)."""
    joints = np.array([(p.joint or 1) - 1 for p in gains.parameters])
    torque = _torque_rows(trial.arm, trial.stretches, trial.estimate, trial.equations)
    return ls.moves(
        trial.equations, trial.factor, torque[:, None] * _is_of(trial.equations, joints)
    )


@dataclass(frozen=True, slots=True)
class _Refined:
    """Gains at one bandwidth, relative to those of the signals."""

    factor: FloatArray  # (n_gains,)
    covariance: FloatArray  # (n_gains, n_gains) relative
    identified: BoolArray  # (n_gains,)


def _first_gains(arm: Arm, motions: Sequence[Motion], joints: IntArray) -> FloatArray:
    """Gains by linear least squares at the lowest bandwidth, with rigid gears: (n_gains,).

    Raises NotIdentifiable if a gain is not positive or belongs to an unresolved direction.
    """
    stretches = prepare_all(arm, motions, next(bandwidths_of(motions, 2.0)))
    equations = assemble(arm, stretches, None)
    if not len(equations.target):
        raise NotIdentifiable("every sample is at an edge or in saturation; record for longer")
    of_joint = _is_of(equations, joints)
    torque = _torque_rows(arm, stretches, None, equations)
    known = np.where(of_joint.any(axis=1), equations.target - torque, equations.target)
    extended = _extended(replace(equations, target=known), -torque[:, None] * of_joint)
    factor = ls.factorise(extended, ls.initial_weights(equations.target, equations.group))
    gains = np.asarray(factor.value[-len(joints) :])
    unresolved = np.abs(factor.directions[~factor.is_resolved, -len(joints) :]).max(0, initial=0.0)
    _require(joints, (gains > 0.0) & (unresolved <= _MAX_UNRESOLVED))
    return gains


def _refine(trial: Trial, joints: IntArray, factors: FloatArray) -> _Refined:
    """Gauss-Newton search for the gains at the bandwidth of a trial.

    The torques of the trial are those of the signals times `factors`.

    The column of a gain is the torque of the model; with the measured torque, noise would bias the
    gain towards zero.
    """
    n_gains = len(joints)
    for _ in range(_MAX_ITERATIONS):
        equations, root = trial.equations, trial.factor.root
        measured = _torque_rows(trial.arm, trial.stretches, trial.estimate, equations)
        torque = measured - ls.residual_of(equations, trial.factor)
        extended = _extended(equations, -torque[:, None] * _is_of(equations, joints))
        factor = ls.factorise(extended, root)
        step = factor.value[-n_gains:]
        if np.all(np.abs(step) < _TOLERANCE):
            break
        changes = np.clip(1.0 + step, 1.0 / _MAX_FACTOR, _MAX_FACTOR)
        factors = factors * changes
        trial = _rescaled(trial, joints, changes)
    covariance = ls.jackknife(extended, factor)[0]
    identified = ls.determined(extended, factor, covariance)[-n_gains:]
    return _Refined(factors, np.asarray(covariance[-n_gains:, -n_gains:]), identified)


def _rescaled(trial: Trial, joints: IntArray, factors: FloatArray) -> Trial:
    """The trial repeated with multiplied torques of joints, from 0."""
    scale = _scale_of(trial.arm, joints, factors)
    stretches = tuple(
        replace(
            s,
            torque=s.torque * scale,
            drive=(s.drive[0] * scale, s.drive[1]),
            signals=_scaled(s.signals, scale),
        )
        for s in trial.stretches
    )
    return fit_trial(trial.arm, stretches, trial.estimate, trial.estimate.shares)


def _extended(equations: ls.Equations, columns: FloatArray) -> ls.Equations:
    """Equations with further unknowns of exact columns (n_rows, n_gains)."""
    return replace(
        equations,
        shared=np.hstack([equations.shared, columns]),
        noise=np.append(equations.noise, np.zeros(columns.shape[1])),
    )


def _torque_rows(
    arm: Arm,
    stretches: Sequence[FilteredRecord],
    linearised_at: Estimate | None,
    equations: ls.Equations,
) -> FloatArray:
    """The part of the target that is the measured torque: (n_rows,)."""
    unmoved = [replace(s, torque=np.zeros_like(s.torque)) for s in stretches]
    return np.asarray(equations.target - assemble(arm, unmoved, linearised_at).target)


def _is_of(equations: ls.Equations, joints: IntArray) -> BoolArray:
    """Whether rows belong to joints, from 0: (n_rows, n_joints)."""
    return np.asarray(equations.group[:, None] == joints)


def _scale_of(arm: Arm, joints: IntArray, factors: FloatArray) -> FloatArray:
    """Factors (n_joints,) on the torques of all joints; `joints` count from 0."""
    scale = np.ones(arm.n_joints)
    scale[joints] = factors
    return scale


def _scaled(signals: Signals, scale: FloatArray) -> Signals:
    return replace(signals, motor_torque=signals.motor_torque * scale)


def _require(joints: IntArray, is_clear: BoolArray) -> None:
    """Raise NotIdentifiable unless the gains of all joints, from 0, are clear."""
    if not is_clear.all():
        listed = ", ".join(map(str, (joints[~is_clear] + 1).tolist()))
        raise NotIdentifiable(
            "the records with and without payload do not determine torque_per_volt of joint "
            f"{listed}: move the payload so that its weight and inertia load these joints, or take "
            "a heavier one"
        )
