"""Textbook rigid identification (IDIM-LS) with Pinocchio's regressor."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from strainwave.domain import FloatArray, Log, Study
from strainwave.domain.keys import Values

CUTOFF = 5.0  # [Hz] the best of 5, 10 and 20: above the motion, far below the resonances
MIN_VELOCITY = 5.0  # [rad/s] of a motor; below it the sign of friction is uncertain
DECIMATION = 10  # samples per row
EDGE = 200  # [samples] omitted at both ends


def pinocchio(study: Study, log: Log) -> Values:
    """Base parameters and friction of a two-link arm in the plane by weighted least squares.

    Zero-phase Butterworth low-pass of angle and torque, central differences, every tenth sample,
    none at low speed; the least-norm solution over all standard parameters.
    """
    import pinocchio as pin

    T = log.sample_time
    sos = butter(4, CUTOFF, fs=1.0 / T, output="sos")

    def channel(name: str) -> FloatArray:
        columns = np.column_stack([log.channels[f"{name}{i}"] for i in (1, 2)])
        return np.asarray(sosfiltfilt(sos, columns, axis=0))

    angle = channel("theta_m")
    velocity = np.gradient(angle, T, axis=0)
    acceleration = np.gradient(velocity, T, axis=0)
    e = [joint.torque_per_command for joint in study.arm.joints]
    torque = channel("u") * e
    n = np.array([joint.gear_ratio for joint in study.arm.joints])
    model = _model(study)
    data = model.createData()
    blocks, targets = [], []
    for k in range(EDGE, len(angle) - EDGE, DECIMATION):
        if np.abs(velocity[k]).min() < MIN_VELOCITY:
            continue
        body = pin.computeJointTorqueRegressor(
            model, data, angle[k] * n, velocity[k] * n, acceleration[k] * n
        )
        row = np.zeros((2, 27))
        row[:, :20] = body * n[:, None]  # motor side
        row[1, 20] = acceleration[k, 1]
        for i in (0, 1):
            row[i, 21 + 3 * i : 24 + 3 * i] = velocity[k, i], np.sign(velocity[k, i]), 1.0
        blocks.append(row)
        targets.append(torque[k])
    rows, target = np.array(blocks), np.array(targets)
    x = _solve(rows, target)
    weight = 1.0 / (target - rows @ x).std(axis=0)  # of each joint's rows
    x = _solve(rows * weight[:, None], target * weight)
    l1 = study.arm.joints[1].origin.xyz[0]
    return {  # Izz about the joint's axis is the last of each link's ten, mx the second
        ("rigid_inertia", 1): float(x[9] + l1**2 * x[10]),
        ("beta", None): float(x[19]),
        ("gamma", None): float(l1 * x[11]),
        ("motor_inertia", 2): float(x[20]),
        **{("motor_coulomb_friction", i + 1): float(x[22 + 3 * i]) for i in (0, 1)},
        **{("total_viscous_friction", i + 1): float(x[21 + 3 * i]) for i in (0, 1)},
    }


def _solve(rows: FloatArray, target: FloatArray) -> FloatArray:
    """Least-norm solution of (n, 2, k) rows, whose columns are scaled to one."""
    flat = rows.reshape(-1, rows.shape[-1])
    size = np.linalg.norm(flat, axis=0)
    size[size == 0.0] = 1.0
    return np.asarray(np.linalg.lstsq(flat / size, target.ravel(), rcond=1e-8)[0] / size)


def _model(study: Study) -> Any:
    import pinocchio as pin

    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    offset = np.array([study.arm.joints[1].origin.xyz[0], 0.0, 0.0])
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "joint1")
    model.addJoint(first, pin.JointModelRZ(), pin.SE3(np.eye(3), offset), "joint2")
    return model
