"""Plain weighted least squares of a serial chain with rigid joints and Pinocchio's regressor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from strainwave.domain import FloatArray, Signals
from strainwave.domain.arm.combinations import FRICTION_COLUMNS
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import low_pass

MIN_LINK_VELOCITY = 0.02  # [rad/s] below it the sign of friction is uncertain
ROWS_PER_SECOND = 50.0
N_REWEIGHTINGS = 2  # weights by the residuals of each joint


def fit_plain(
    arm: Arm, records: Sequence[Signals], cutoff_hz: float, *, filters_sign: bool = False
) -> FloatArray:
    """Base parameters and friction in the order of `Arm.rigid_columns`.

    `filters_sign`: The regressor of Coulomb friction is the low-passed sliding direction, as the
    torque is low-passed. The usual regressor is the sign of the low-passed velocity.
    """
    parts = [_equations(arm, record, cutoff_hz, filters_sign) for record in records]
    X, y = (np.concatenate(columns) for columns in list(zip(*parts, strict=True))[:2])
    joint = np.concatenate([part[2] for part in parts])
    root = np.ones(len(y))
    x = _solve(X, y, root)
    for _ in range(N_REWEIGHTINGS):
        residual = y - X @ x
        root = 1.0 / np.array([residual[joint == i].std() for i in range(arm.n_joints)])[joint]
        x = _solve(X, y, root)
    return x


def _solve(X: FloatArray, y: FloatArray, root: FloatArray) -> FloatArray:
    rows = X * root[:, None]
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0.0] = 1.0
    return np.asarray(np.linalg.lstsq(rows / scale, y * root, rcond=1e-8)[0] / scale)


def _equations(
    arm: Arm, record: Signals, cutoff_hz: float, filters_sign: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows, torques and joints (from 0) of the samples at which joints move."""
    T = record.sample_time
    at = np.arange(0, len(record.time), max(1, round(1.0 / (ROWS_PER_SECOND * T))))
    angle, velocity, acceleration, torque, direction = (
        low_pass(x, cutoff_hz, T)[at]
        for x in (
            record.motor_angle,
            record.motor_velocity,
            record.motor_acceleration,
            record.motor_torque,
            record.direction,
        )
    )
    sign = direction if filters_sign else np.sign(velocity)
    of_base, n_links = arm.base.particular(), len(arm.base.links)
    body = _regressor(arm, *map(arm.links_of, (angle, velocity, acceleration)))
    at_links = np.swapaxes(body @ of_base[:n_links], 1, 2)
    at_motors = np.swapaxes(arm.motors_of(at_links), 1, 2)
    at_motors = at_motors + acceleration[:, :, None] * of_base[n_links:]
    X, y, joints = [], [], []
    for i in range(arm.n_joints):
        rows = np.zeros((len(at), len(arm.rigid_columns)))
        rows[:, : arm.n_body] = at_motors[:, i]
        first = arm.n_body + FRICTION_COLUMNS * i
        rows[:, first : first + FRICTION_COLUMNS] = np.column_stack(
            [velocity[:, i], sign[:, i], np.ones(len(at))]
        )
        moves = np.abs(velocity[:, i] * arm.gear_ratios[i]) > MIN_LINK_VELOCITY
        X.append(rows[moves])
        y.append(torque[moves, i])
        joints.append(np.full(np.count_nonzero(moves), i))
    return np.concatenate(X), np.concatenate(y), np.concatenate(joints)


def _regressor(
    arm: Arm, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Torques of the links per standard parameter: (n_rows, n_joints, 10 n_joints)."""
    import pinocchio as pin

    model = _model(arm)
    data = model.createData()
    rows = zip(angle, velocity, acceleration, strict=True)
    tables = [pin.computeJointTorqueRegressor(model, data, *row) for row in rows]
    return np.array(tables).reshape(len(tables), arm.n_joints, -1)  # of one joint, vectors


def _model(arm: Arm) -> Any:
    import pinocchio as pin

    model, parent = pin.Model(), 0
    model.gravity.linear = np.array(arm.gravity if arm.gravity is not None else (0.0, 0.0, 0.0))
    for number, joint in enumerate(arm.joints, start=1):
        unit = np.array(joint.axis) / np.linalg.norm(joint.axis)
        is_revolute = joint.motion == "revolute"
        of_type = (
            pin.JointModelRevoluteUnaligned if is_revolute else pin.JointModelPrismaticUnaligned
        )
        turned = pin.rpy.rpyToMatrix(*joint.origin.rpy)
        placement = pin.SE3(turned, np.array(joint.origin.xyz))
        parent = model.addJoint(parent, of_type(unit), placement, f"joint{number}")
    return model
