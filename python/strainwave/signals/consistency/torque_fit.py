"""Fit of one arm to the low-frequency torques of all joints: a test of axes, frames and gravity.

Behind rigid gears, the torques of all joints are linear in the same parameters of the links,

    tau_i = Y_i(q, dq, ddq) pi + m_Mi ddtheta_Mi + d_i dtheta_Mi + f_i sgn(dtheta_Mi) + o_i,

for any values of the parameters. A wrong axis, frame, ratio or gravity changes Y. The share of a
torque that the fit does not explain is then larger than with the correct chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.numerics.linalg import singular_values
from strainwave.signals.consistency.evidence import Evidence, is_slow
from strainwave.signals.consistency.motors import compute_motor_torque, sliding_rows
from strainwave.signals.consistency.regression import ROWS_PER_INDEPENDENT_ROW
from strainwave.signals.consistency.sensors import motion_of

# Every row in `_ROW_STRIDE` is used; 5 of 20 rows per period of the bandwidth frequency remain.
_ROW_STRIDE = 4
# The same for the low-pass of the columns.
_FILTER_STRIDE = 2
# Relative singular value below which a combination of parameters is not excited.
_MIN_SINGULAR_VALUE = 1e-6
# Iterations of the weights, which are the residuals of the joints.
_N_ITERATIONS = 3
# Smallest unexplained share, so that noise-free torques can be compared.
_MIN_UNEXPLAINED = 1e-9


MIN_FIT_RATIO = 1.25
"""Ratio of unexplained variances above which another geometry contradicts the stated one.

Other geometries reduced that of a measured arm with the right description by up to 1.11."""


@dataclass(frozen=True, slots=True)
class TorqueSystem:
    """Equations of all joints without the parts that a joint's own motor and friction explain."""

    columns: FloatArray  # (n_rows, n_links) torque per parameter of the links
    torque: FloatArray  # (n_rows,) [N m] at the motors
    joint: FloatArray  # (n_rows,) of each row, from 1
    total: Mapping[int, float]  # joint -> sum of squares of the torque about its mean
    n_rows: Mapping[int, float]  # joint -> independent rows beyond its own parameters


@dataclass(frozen=True, slots=True)
class TorqueFit:
    """Fit of all torques with one set of link parameters."""

    links: FloatArray  # (n_links,) parameters of the links, of least norm
    basis: FloatArray  # (n_rows, n_excited) orthonormal, of the weighted columns
    weight: FloatArray  # (n_rows,) 1 / residual standard deviation of the row's joint
    residual: FloatArray  # (n_rows,) weighted
    unexplained: Mapping[int, float]  # joint -> share of the variance of its torque
    n_rows: Mapping[int, float]  # joint -> independent rows beyond the parameters

    @property
    def cost(self) -> float:
        """Negative log likelihood: sum of the logarithms of the unexplained shares."""
        return sum(0.5 * self.n_rows[i] * float(np.log(u)) for i, u in self.unexplained.items())

    @property
    def n_all(self) -> float:
        """Independent rows of all joints."""
        return sum(self.n_rows.values())

    def project(self, torques: FloatArray) -> FloatArray:
        """Weighted torques (n_rows, n) without the parts that the links explain."""
        weighted = self.weight[:, None] * torques
        return weighted - self.basis @ (self.basis.T @ weighted)


def fit_ratio(cost: float, other_cost: float, n_rows: float) -> float:
    """Ratio of the unexplained variances of two fits, from their costs."""
    return float(np.exp(2.0 * (cost - other_cost) / n_rows))


def fit_torques(system: TorqueSystem) -> TorqueFit:
    """Least squares, weighted by the residuals of the joints."""
    std = {i: float(np.sqrt(total / system.n_rows[i])) for i, total in system.total.items()}
    of_joint = {i: system.joint == i for i in std}
    for _ in range(_N_ITERATIONS):
        weight = np.zeros(len(system.torque))
        for i, rows in of_joint.items():
            weight[rows] = 1.0 / std[i]
        basis, links = _solve(weight[:, None] * system.columns, weight * system.torque)
        residual = weight * (system.torque - system.columns @ links)
        n_shared = basis.shape[1] / len(std)
        n_rows = {i: max(n - n_shared, 1.0) for i, n in system.n_rows.items()}
        shares = {
            i: max(
                float(np.sum((std[i] * residual[rows]) ** 2)) / system.total[i], _MIN_UNEXPLAINED
            )
            for i, rows in of_joint.items()
        }
        std = {i: float(np.sqrt(shares[i] * system.total[i] / n_rows[i])) for i in std}
    return TorqueFit(links, basis, weight, residual, shares, n_rows)


def _solve(columns: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Basis of the excited columns, and the solution of least norm in units of the columns."""
    size = np.linalg.norm(columns, axis=0)
    used = size > _MIN_SINGULAR_VALUE * size.max()
    scaled = columns[:, used] / size[used]
    left, values, right = singular_values(scaled)
    excited = values > _MIN_SINGULAR_VALUE * values[0]
    basis, solution = left[:, excited], np.zeros(len(size))
    inner = right[excited].T @ ((basis.T @ target) / values[excited])
    solution[used] = inner / size[used]
    return basis, solution


def torque_system(evidence: Evidence) -> TorqueSystem | None:
    """Equations of the slow records; None if there are none, or no torque varies."""
    arm, blocks = evidence.arm, []
    totals: dict[int, float] = {}
    n_rows: dict[int, float] = {}
    for record in (r for r in evidence.records if is_slow(r.experiment)):
        joints = [
            i for i in range(arm.n_joints) if {f"u{i + 1}", f"torque{i + 1}"} & set(record.channels)
        ]
        motion = motion_of(record, arm)
        states = motion.angle, motion.velocity, motion.acceleration
        of_links = arm.base_regressor(*(x[::_FILTER_STRIDE] for x in states))
        of_motors = np.swapaxes(arm.motors_of(np.swapaxes(of_links, 1, 2)), 1, 2)
        # The torques of a smooth motion have harmonics, which the filter removed from the log.
        flat, T = of_motors.reshape(len(of_motors), -1), record.sample_time * _FILTER_STRIDE
        flat = low_pass(flat, record.bandwidth_hz, T)[:: _ROW_STRIDE // _FILTER_STRIDE]
        of_motors = flat.reshape(-1, *of_motors.shape[1:])
        for i in joints:
            rows = sliding_rows(record, i)[::_ROW_STRIDE]
            rate = differentiate(record.channels[f"theta_m{i + 1}"], record.sample_time)
            slope = differentiate(rate, record.sample_time)
            own = np.column_stack([slope, rate, record.direction[:, i]])[::_ROW_STRIDE][rows]
            own = own - own.mean(axis=0)
            norms = np.linalg.norm(own, axis=0)
            torque = compute_motor_torque(record, arm, i)[::_ROW_STRIDE][rows]
            torque = torque - torque.mean()
            if norms.min() == 0.0 or not np.any(torque):
                continue
            basis = np.linalg.qr(own / norms)[0]
            columns = of_motors[rows, i] - of_motors[rows, i].mean(axis=0)
            block = np.column_stack([columns, torque])
            block -= basis @ (basis.T @ block)
            blocks.append((block, np.full(len(block), i + 1)))
            totals[i + 1] = totals.get(i + 1, 0.0) + float(torque @ torque)
            independent = len(torque) * _ROW_STRIDE / ROWS_PER_INDEPENDENT_ROW - own.shape[1] - 1
            n_rows[i + 1] = n_rows.get(i + 1, 0.0) + max(independent, 1.0)
    if not blocks:
        return None
    equations = np.concatenate([block for block, _ in blocks])
    joint = np.concatenate([joint for _, joint in blocks])
    return TorqueSystem(equations[:, :-1], equations[:, -1], joint, totals, n_rows)
