"""Serial chains compared with Pinocchio: regressor, inverse dynamics, inertia, link motion."""

from typing import Any

import numpy as np
import pytest

from serial_chains import (
    GRAVITY,
    MOTOR,
    SAMPLES,
    Joint,
    assert_close,
    chain,
    parameters_of,
    random_body,
    random_joints,
    rotation,
)

pinocchio = pytest.importorskip("pinocchio", reason="the package pin is not installed")


def pinocchio_model(joints: list[Joint], bodies: list[dict[str, Any]]) -> Any:
    """The same chain in Pinocchio."""
    model = pinocchio.Model()
    model.gravity.linear = np.array(GRAVITY)
    parent = 0
    for i, ((kind, position, rpy, axis), body) in enumerate(zip(joints, bodies, strict=True)):
        unit = np.array(axis) / np.linalg.norm(axis)
        of_type = {
            "revolute": pinocchio.JointModelRevoluteUnaligned,
            "prismatic": pinocchio.JointModelPrismaticUnaligned,
        }[kind]
        placement = pinocchio.SE3(rotation(rpy), np.array(position))
        parent = model.addJoint(parent, of_type(unit), placement, f"joint{i}")
        inertia = pinocchio.Inertia(body["mass"], body["centre"], body["inertia"])
        model.appendBodyToJoint(parent, inertia, pinocchio.SE3.Identity())
    return model


@pytest.mark.parametrize("types", ["rpr", "prrp", "rrrrr", "rrprpr", "rrrrrrr", "prrprrr"])
def test_dynamics_and_link_motion(types: str) -> None:
    n = len(types)
    rng = np.random.default_rng([n, 2])
    joints = random_joints(rng, n, types)
    bodies = [random_body(rng) for _ in range(n)]
    arm, model = chain(joints), pinocchio_model(joints, bodies)
    base = np.concatenate([parameters_of(body) for body in bodies])
    parameters = np.concatenate([base, MOTOR * n])
    q, dq, ddq = rng.uniform(-2.0, 2.0, (3, SAMPLES, n))
    regressor = arm.base_regressor(q, dq, ddq)
    inertia, bias = arm.inertia_matrix(base, q), arm.bias_torques(parameters, q, dq)
    motion = arm.link_motion(q, dq, ddq)
    data = model.createData()
    for k in range(SAMPLES):
        expected = pinocchio.computeJointTorqueRegressor(model, data, q[k], dq[k], ddq[k])
        assert_close(regressor[k], expected)
        torque = pinocchio.rnea(model, data, q[k], dq[k], ddq[k])
        assert_close(regressor[k] @ base, torque)
        for i in range(n):
            rate, acceleration = data.v[i + 1], data.a_gf[i + 1]
            force = acceleration.linear + np.cross(rate.angular, rate.linear)
            assert_close(motion[k, i], np.r_[rate.angular, acceleration.angular, force])
        upper = np.triu(pinocchio.crba(model, data, q[k]))
        assert_close(inertia[k], upper + np.triu(upper, 1).T)
        assert_close(bias[k], pinocchio.nonLinearEffects(model, data, q[k], dq[k]))
