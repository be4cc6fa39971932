"""Gear stiffness from the torsion that encoders on both sides of a gear show in slow motion.

The links' torque, which the rigid model predicts, twists the gear by delta = n theta_M - theta_L:

    delta = tau / k + e ddelta + a ddq + b dq + c

The column of the own acceleration absorbs the part of the inertia that rigid motion does not
separate from the motor's; that of the velocity absorbs the link's viscous friction and a delay
between the encoders; that of the rate of the torsion absorbs the gear damping. Each record has its
own zero c.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import (
    BoolArray,
    Diagnostic,
    FloatArray,
    IntArray,
    Log,
    Parameter,
    Place,
    RigidModel,
    TorsionFit,
)
from strainwave.domain.arm.description import unit_in
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.domain.arm.kinds.base import MOTOR_SHARE
from strainwave.domain.keys import JointIndex, JointNumber
from strainwave.domain.results.distributions import student_quantile
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import link_motion, torsion_motion
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.motor import measured_torsion, period_of, prepare_motor_signals
from strainwave.signals.standstill import running

_BLOCKS = 20  # of the jackknife, of all records together
_ROWS_PER_CUTOFF = 4.0  # rows per period of the filter's cut-off
# the torques are nonlinear in the motion, which keeps frequencies up to eight cut-offs
_MOTION_RATE = 32.0
_TWIST_BAND = 4.0  # cut-offs up to which two derivatives of the torsion are exact
_MIN_WEIGHT = 1e-10  # of a direction of columns that counts as zero
_EDGE_PERIODS = 2.5  # of the cut-off, after which the filter's response to the ends has decayed


@dataclass(frozen=True, slots=True)
class _TorsionRows:
    """One record at the rows of the regression, all low-passed to the rigid model's bandwidth."""

    name: str
    torque: FloatArray  # (n_rows, n_joints, n_body) [N m] of the links, per base parameter
    payload: FloatArray  # (n_rows, n_joints) [N m] that a known payload adds
    velocity: FloatArray  # (n_rows, n_joints)
    acceleration: FloatArray  # (n_rows, n_joints)
    torsion: FloatArray  # (n_rows, n_joints) [rad, m]; zero without a reading
    rate: FloatArray  # (n_rows, n_joints) [rad/s, m/s] of the torsion
    valid: BoolArray  # (n_rows, n_joints)
    phase: FloatArray  # (n_rows,) 0 to 1 within one period of the motion


def fit_torsions(
    logs: Sequence[Log], model: RigidModel, arm: Arm, joints: Sequence[JointNumber]
) -> tuple[tuple[TorsionFit, ...], tuple[Diagnostic, ...]]:
    """Estimate the stiffness of joints from records of slow motion.

    Joints without torsion in any record are left out. A joint whose torsion does not follow its
    torque gets a warning instead of an estimate.
    """
    channels = {name for log in logs for name in log.channels}
    joints = [j for j in joints if {f"theta_l{j}", f"deflection{j}"} & channels]
    if not joints:
        return (), ()
    records = run_parallel([partial(_prepare, log, model.bandwidth_hz, arm) for log in logs])
    fits = [_fit_joint([r for r in records if r is not None], model, arm, j) for j in joints]
    return (
        tuple(fit for fit in fits if isinstance(fit, TorsionFit)),
        tuple(fit for fit in fits if isinstance(fit, Diagnostic)),
    )


def _prepare(log: Log, bandwidth_hz: float, arm: Arm) -> _TorsionRows | None:
    """The rows of a record; None if it is shorter than the filter needs."""
    signals, T = prepare_motor_signals(log, arm), log.sample_time
    edge = int(_EDGE_PERIODS / (bandwidth_hz * T))
    step = max(1, int(1.0 / (_MOTION_RATE * bandwidth_hz * T)))
    per_row = max(1, int(1.0 / (_ROWS_PER_CUTOFF * bandwidth_hz * T)) // step)
    rows = np.arange(edge - edge % step, len(log) - edge, step * per_row)
    if not len(rows):
        return None
    torsion, is_measured = measured_torsion(log, arm)
    twist = low_pass(torsion, _TWIST_BAND * bandwidth_hz, T)
    motors = signals.motor_angle, signals.motor_velocity, signals.motor_acceleration
    motion = link_motion(arm, motors, torsion_motion(replace(signals, torsion=twist)))
    q, dq, ddq = (np.ascontiguousarray(x[::step]) for x in motion)

    def filtered(values: FloatArray) -> FloatArray:
        return low_pass(values, bandwidth_hz, T, decimated=step)[rows // step]

    def at_rows(values: FloatArray) -> FloatArray:
        return low_pass(values, bandwidth_hz, T, kept=slice(0, None, step))[rows // step]

    regressor = arm.base_regressor(q, dq, ddq) @ arm.links_of_rigid(MOTOR_SHARE)
    added = arm.link_torques(arm.payload_vector(log.experiment.payload), q, dq, ddq)
    gap = round(1.0 / (8.0 * bandwidth_hz * T))
    bad = ~(signals.valid & is_measured)
    valid = ~np.column_stack([running(np.logical_or, column, 2 * gap + 1) for column in bad.T])
    span = min(period_of(signals), float(len(log)))
    return _TorsionRows(
        log.name,
        filtered(regressor),
        filtered(added),
        filtered(dq),
        filtered(ddq),
        at_rows(torsion),
        at_rows(differentiate(torsion, T)),
        valid[rows],
        np.asarray((rows % span) / span, dtype=np.float64),
    )


@dataclass(frozen=True, slots=True)
class _TorsionRegression:
    """Regression of one joint, all records together."""

    per_parameter: FloatArray  # (n_rows, n_body) [N m] torque per base parameter
    payload: FloatArray  # (n_rows,) [N m]
    # (n_rows, 3 + n_records) acceleration, velocity, rate of the torsion, one per record
    others: FloatArray
    torsion: FloatArray  # (n_rows,) [rad, m]
    block: IntArray  # (n_rows,) of the jackknife

    @staticmethod
    def of(records: Sequence[_TorsionRows], joint: JointIndex) -> _TorsionRegression | None:
        """The rows of a joint; None if there are too few."""
        parts = [(r, r.valid[:, joint]) for r in records if r.valid[:, joint].any()]
        per_record = max(2, round(_BLOCKS / max(1, len(parts))))
        blocks = [k * per_record + (per_record * r.phase[at]) for k, (r, at) in enumerate(parts)]
        block = np.concatenate(blocks or [np.zeros(0)]).astype(np.int64)
        n_columns = 4 + len(parts)
        if len(np.unique(block)) < 3 or len(block) <= 2 * n_columns:
            return None
        number = np.repeat(np.arange(len(parts)), [int(at.sum()) for _, at in parts])
        others = [
            np.concatenate([r.acceleration[at, joint] for r, at in parts]),
            np.concatenate([r.velocity[at, joint] for r, at in parts]),
            np.concatenate([r.rate[at, joint] for r, at in parts]),
            *(number == k for k in range(len(parts))),
        ]
        return _TorsionRegression(
            np.concatenate([r.torque[at, joint] for r, at in parts]),
            np.concatenate([r.payload[at, joint] for r, at in parts]),
            np.column_stack(others),
            np.concatenate([r.torsion[at, joint] for r, at in parts]),
            block,
        )


def _fit_joint(
    records: Sequence[_TorsionRows], model: RigidModel, arm: Arm, joint: JointNumber
) -> TorsionFit | Diagnostic:
    """The stiffness of one joint with its interval; a warning without one."""
    key, lacking = (STIFFNESS, joint), Diagnostic("no-torsion", Place(joint=joint), joint=joint)
    equations = _TorsionRegression.of(records, joint - 1)
    if equations is None:
        return lacking
    solution = model.solution[: arm.n_body]
    torque = equations.per_parameter @ solution + equations.payload
    others = equations.others
    compliance, (own_torque, own_torsion) = _slope(torque, others, equations.torsion)
    residual = own_torsion - compliance * own_torque
    without = [equations.block != block for block in np.unique(equations.block)]
    parts = [_slope(torque[at], others[at], equations.torsion[at])[0] for at in without]
    # errors of the rigid model shift the torque along its columns
    shifts = _projected(equations.per_parameter, others)
    change = (residual - compliance * own_torque) @ shifts / (own_torque @ own_torque)
    of_model = np.nan_to_num(model.covariance[: arm.n_body, : arm.n_body])
    variance = (len(parts) - 1) * float(np.var(parts)) + float(change @ of_model @ change)
    half = student_quantile(0.975, len(parts) - 1) * float(np.sqrt(variance))
    if not compliance > half:
        return lacking
    value, ends = 1.0 / compliance, (1.0 / (compliance + half), 1.0 / (compliance - half))
    std = float(np.sqrt(variance)) * value**2
    return TorsionFit(
        joint,
        tuple(record.name for record in records if record.valid[:, joint - 1].any()),
        Parameter(*key, value, std, unit_in(arm, key), "decoupled", ends),
        own_torque,
        own_torsion,
        100.0 * (1.0 - float(np.linalg.norm(residual) / np.linalg.norm(own_torsion))),
    )


def _slope(torque: FloatArray, others: FloatArray, torsion: FloatArray) -> tuple[float, FloatArray]:
    """Coefficient of the torque in the regression of the torsion on it and on other columns.

    Second, torque and torsion (2, n_rows) without the parts that follow the other columns.
    """
    own = _projected(np.column_stack([torque, torsion]), others)
    squares = float(own[:, 0] @ own[:, 0])
    slope = float(own[:, 0] @ own[:, 1]) / squares if squares > 0.0 else 0.0
    return slope, own.T


def _projected(columns: FloatArray, others: FloatArray) -> FloatArray:
    """The parts of columns that are orthogonal to others."""
    scale = np.linalg.norm(others, axis=0)
    basis, weights, _ = np.linalg.svd(
        others / np.where(scale > 0.0, scale, 1.0), full_matrices=False
    )
    basis = basis[:, weights > _MIN_WEIGHT * weights[0]]
    return np.asarray(columns - basis @ (basis.T @ columns))
