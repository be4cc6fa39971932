"""Consistency of the motor signals: servo references, servo outputs, velocities, torques.

At low frequency, a servo-controlled motor follows its reference, its voltage is the servo output
for the tracking error, and the torques satisfy the equations of rigid joints, (5) to (7), for any
gear stiffness.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate
from strainwave.signals.consistency.evidence import Evidence, SlowRecord, is_slow
from strainwave.signals.consistency.regression import Fit, regress

# Maximum share of samples at the servo limit; above it, the servo law does not hold.
_MAX_SATURATED_SHARE = 0.01
# Minimum magnitude of the mean sign of the motor velocity for a row to count as sliding.
_MIN_MEAN_DIRECTION = 0.8
# Minimum number of sliding rows. With fewer, the regression uses all rows.
_MIN_SLIDING_ROWS = 60
# Search range of the log ratio of the torque constants; 1000 is the largest unit factor.
_MAX_LOG_RATIO = float(np.log(1e3))
# Number of grid points of the ratio search; the spacing is 0.7 %.
_RATIO_GRID_SIZE = 2001
# Parameters that occur in the equations of both joints.
_SHARED_PARAMETERS = ("beta", "gamma", "gravity_torque_2")


@dataclass(frozen=True, slots=True)
class Ratio:
    """Regression of a motor signal on its prediction in one record; 1 if they agree."""

    channel: str
    record: str
    value: float
    std: float
    explained: float  # share of the variance of the signal


@dataclass(frozen=True, slots=True)
class TorqueRegression:
    """Regression of the torque of one joint on its rigid-joint equation, over all slow records."""

    joint: int  # from 1
    inertia: float  # [kg m^2] motor side, coefficient of the joint's own acceleration
    inertia_std: float
    explained: float  # share of the variance of the torque
    shared: tuple[str, ...]  # names of the coupling parameters: beta, gamma, G2
    coupling: FloatArray  # (n_shared,) estimates of the coupling parameters
    coupling_covariance: FloatArray  # (n_shared, n_shared)


def compute_reference_ratios(evidence: Evidence) -> list[Ratio]:
    """Ratios of low-frequency motor velocity to servo reference.

    Covers the joints under servo control whose reference varies.
    """
    ratios: list[Ratio] = []
    for record, i in _servo_controlled(evidence):
        reference = record.channels[f"ref{i}"]
        velocity = differentiate(record.channels[f"theta_m{i}"], record.sample_time)
        slope = differentiate(reference, record.sample_time)
        slope2 = differentiate(slope, record.sample_time)
        columns = np.column_stack([reference, slope, slope2])[record.inside]
        ratios.extend(_regress_ratio(record, f"theta_m{i}", velocity, columns))
    return ratios


def compute_servo_output_ratios(evidence: Evidence) -> list[Ratio]:
    """Ratios of the logged voltage to the servo output kp e + ki int(e) of the study.

    e is reference minus motor velocity. Excludes joints with a PRBS added to the servo output.
    """
    ratios: list[Ratio] = []
    servo = evidence.arm.servo
    for record, i in _servo_controlled(evidence):
        name = f"u{i}"
        has_prbs = record.experiment.prbs is not None and record.experiment.joint in (None, i)
        if servo is None or has_prbs or name not in record.channels:
            continue
        angle, reference = record.channels[f"theta_m{i}"], record.channels[f"ref{i}"]
        error = reference - differentiate(angle, record.sample_time)
        integral = np.cumsum(reference) * record.sample_time - angle
        if servo.position_gain is not None:
            correction = servo.position_gain[i - 1] * (integral - integral[0])
            error = error + correction
            integral = integral + np.cumsum(correction) * record.sample_time
        expected = servo.kp[i - 1] * error + servo.ki[i - 1] * integral
        ratios.extend(
            _regress_ratio(record, name, record.channels[name], expected[record.inside, None])
        )
    return ratios


def compute_velocity_ratios(evidence: Evidence) -> list[Ratio]:
    """Ratios of the logged motor velocity to the derivative of the motor angle."""
    ratios: list[Ratio] = []
    for record in evidence.records:
        for i in range(1, evidence.arm.n_joints + 1):
            name = f"omega_m{i}"
            if name in record.channels:
                slope = differentiate(record.channels[f"theta_m{i}"], record.sample_time)
                columns = slope[record.inside, None]
                ratios.extend(_regress_ratio(record, name, record.channels[name], columns))
    return ratios


def regress_torques(evidence: Evidence) -> list[TorqueRegression]:
    """Regress the torque of each joint on the regressor of the rigid-joint equations.

    The two joints are regressed separately, so the shared parameters beta, gamma and G2 are
    estimated twice. Joints without a torque or voltage channel are omitted.
    """
    slow = [r for r in evidence.records if is_slow(r.experiment)]
    estimates = []
    for i in range(evidence.arm.n_joints):
        records = slow or [r for r in evidence.records if r.experiment.joint in (None, i + 1)]
        records = [r for r in records if {f"u{i + 1}", f"torque{i + 1}"} & set(r.channels)]
        fit, names = _regress_torque(records, evidence.arm, i)
        if fit is None:
            continue
        std = np.sqrt(np.diag(fit.covariance))
        indices = [names.index(name) for name in _SHARED_PARAMETERS if name in names]
        shared = tuple(names[k] for k in indices)
        inertia = float(fit.value[0]), float(std[0])
        coupling = fit.value[indices], fit.covariance[np.ix_(indices, indices)]
        estimates.append(TorqueRegression(i + 1, *inertia, fit.explained, shared, *coupling))
    return estimates


def _servo_controlled(evidence: Evidence) -> Iterator[tuple[SlowRecord, int]]:
    """Records and joints (from 1) under servo control, unsaturated, with a varying reference."""
    if evidence.arm.servo is None:
        return
    limit = 0.999 * evidence.arm.servo.limit
    for record in evidence.records:
        for i, control in enumerate(record.experiment.control, start=1):
            if control != "servo" or f"ref{i}" not in record.channels:
                continue
            voltage = record.channels.get(f"u{i}")
            if voltage is not None and np.mean(np.abs(voltage) >= limit) > _MAX_SATURATED_SHARE:
                continue
            if np.ptp(record.channels[f"ref{i}"]) > 0.0:
                yield record, i


def _regress_ratio(
    record: SlowRecord, channel: str, target: FloatArray, columns: FloatArray
) -> Iterator[Ratio]:
    """Coefficient of the first column in a regression; no ratio if the regression fails."""
    fit = regress(target[record.inside], columns)
    if fit is not None:
        std = float(np.sqrt(fit.covariance[0, 0]))
        yield Ratio(channel, record.experiment.name, float(fit.value[0]), std, fit.explained)


def _regress_torque(records: list[SlowRecord], arm: Arm, i: int) -> tuple[Fit | None, list[str]]:
    """Regress the torque of joint i (from 0) over all records, with one constant per record."""
    targets, blocks = [], []
    names: list[str] = []
    for record in records:
        columns = _regressor_columns(record, arm, i)
        names = list(columns)
        # Near a velocity reversal, the Coulomb friction is undetermined between its two values.
        rows = record.inside & (np.abs(record.direction[:, i]) > _MIN_MEAN_DIRECTION)
        rows = rows if rows.sum() > _MIN_SLIDING_ROWS else record.inside
        torque = compute_motor_torque(record, arm, i)[rows]
        block = np.column_stack(list(columns.values()))[rows]
        targets.append(torque - torque.mean())
        blocks.append(block - block.mean(axis=0))
    if not targets:
        return None, names
    return regress(np.concatenate(targets), np.concatenate(blocks)), names


def compute_motor_torque(record: SlowRecord, arm: Arm, i: int) -> FloatArray:
    """Motor torque of joint i (from 0), (n_rows,) [N m].

    Returns the logged torque, or torque_per_volt times the voltage. If the study gives no
    torque_per_volt, the scale is 1.
    """
    name = f"torque{i + 1}"
    if name in record.channels:
        return record.channels[name]
    return (arm.joints[i].torque_per_volt or 1.0) * record.channels[f"u{i + 1}"]


def _regressor_columns(record: SlowRecord, arm: Arm, i: int) -> dict[str, FloatArray]:
    """Regressor columns of the equation of joint i (from 0), by parameter, motor side."""
    n = arm.gear_ratios
    joints = range(1, arm.n_joints + 1)
    motor = np.column_stack([record.channels[f"theta_m{j}"] for j in joints])
    q = motor * n
    dq = differentiate(q, record.sample_time)
    ddq = differentiate(dq, record.sample_time)
    friction = {"viscous": dq[:, i] / n[i], "coulomb": record.direction[:, i]}
    gravity = arm.gravity is not None
    if arm.n_joints == 1:
        gravity_columns = {"gravity_torque_1": n[0] * np.cos(q[:, 0])} if gravity else {}
        return {"inertia": ddq[:, 0] / n[0]} | friction | gravity_columns
    c, s = np.cos(q[:, 1]), np.sin(q[:, 1])
    inertia = {"inertia": ddq[:, i] / n[i]}
    if i == 0:
        accelerations = 2.0 * ddq[:, 0] + ddq[:, 1]
        velocity_products = 2.0 * dq[:, 0] * dq[:, 1] + dq[:, 1] ** 2
        coupled = {
            "beta": n[0] * ddq[:, 1],
            "gamma": n[0] * (c * accelerations - s * velocity_products),
        }
    else:
        coupled = {"beta": n[1] * ddq[:, 0], "gamma": n[1] * (c * ddq[:, 0] + s * dq[:, 0] ** 2)}
    gravity_columns = {}
    if gravity:
        gravity_columns["gravity_torque_2"] = n[i] * np.cos(q[:, 0] + q[:, 1])
        if i == 0:
            gravity_columns["gravity_torque_1"] = n[0] * np.cos(q[:, 0])
    return inertia | coupled | friction | gravity_columns


def estimate_torque_ratio(regressions: list[TorqueRegression]) -> tuple[float, float] | None:
    """Ratio of the torque-constant errors of joints 1 and 2, from the symmetry of M(q).

    beta, gamma and G2 occur in the equations of both joints. If the torque constant of joint i is
    wrong by a factor f_i, the equation of joint i gives estimates x_i that are f_i times the true
    values. The ratio f_1 / f_2 minimises over r

        (x1 - r x2)' (C1 + r^2 C2)^-1 (x1 - r x2)

    Returns the ratio and its standard deviation. The standard deviation is at least
    abs(r - 1) sqrt(s / (cost(1) - cost(r))), the likelihood-ratio value for a ratio of 1, where s
    is the cost per degree of freedom, at least 1. Returns None for one joint, or if the motion
    does not determine the ratio.
    """
    if (
        len(regressions) < 2
        or regressions[0].shared != regressions[1].shared
        or not regressions[0].shared
    ):
        return None
    first, second = regressions

    def costs_of(ratios: FloatArray) -> FloatArray:
        error = first.coupling - ratios[:, None] * second.coupling
        squares = ratios[:, None, None] ** 2
        covariance = first.coupling_covariance + squares * second.coupling_covariance
        return np.asarray(
            (error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(axis=1)
        )

    grid = np.exp(np.linspace(-_MAX_LOG_RATIO, _MAX_LOG_RATIO, _RATIO_GRID_SIZE))
    costs = costs_of(grid)
    best = int(np.argmin(costs))
    if best in (0, len(grid) - 1) or costs[best] + 4.0 > min(costs[0], costs[-1]):
        return None
    # The parabola through the three lowest points gives the minimum and the standard deviation:
    # the distance at which the cost increases by 1.
    step = float(np.log(grid[1] / grid[0]))
    left, middle, right = (float(c) for c in costs[best - 1 : best + 2])
    curvature = max((left - 2.0 * middle + right) / step**2, 1e-12)
    ratio = float(grid[best]) * float(np.exp(0.5 * (left - right) / (step * curvature)))
    excess = max(1.0, middle / max(1, len(first.shared) - 1))
    std = ratio * float(np.sqrt(2.0 / curvature * excess))
    increase = float(costs_of(np.ones(1))[0]) - middle
    if increase > 1.0:  # The cost is not parabolic far from its minimum.
        std = max(std, abs(ratio - 1.0) * float(np.sqrt(excess / increase)))
    return ratio, std
