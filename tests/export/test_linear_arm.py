"""The linear model of the whole arm has the derivatives of the exported arm in MuJoCo."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import exports
from strainwave.domain import FloatArray
from strainwave.domain.arm.description import Matrix
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.export.linear_models import coordinates_of, linear_arm, state_space
from strainwave.export.mjcf import to_mjcf
from strainwave.export.source import IdentifiedArm

STEP = 1e-5  # of the differences; their error is of the order of its square


@pytest.fixture(scope="module")
def mujoco() -> ModuleType:
    found: ModuleType = pytest.importorskip(
        "mujoco", reason="MuJoCo is not installed (extra: bench)"
    )
    return found


def at_rest(mujoco: ModuleType, arm: IdentifiedArm) -> tuple[Any, Any, list[int]]:
    """Model and data at zero link angles, held by the motors; the joints of the coordinates."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(arm).data.decode())
    data, description = mujoco.MjData(model), Arm.of(arm.study.arm)
    coordinates, n = coordinates_of(arm.study.arm), description.n_joints
    order = [*range(n, model.nv), *range(n)]  # the file has the links first
    base = np.array([arm.need(*key) for key in description.base_names])
    rest = np.zeros((1, n))
    torque = description.link_torques(base, rest, rest, rest)[0]
    elastic = [number - 1 for number in coordinates.elastic]
    stiffness = np.array([arm.need("gear_stiffness", number) for number in coordinates.elastic])
    motors = coordinates.torsions[:, : len(elastic)]
    data.qpos[n:] = np.linalg.solve(motors, torque[elastic] / stiffness)
    offsets = np.array([arm.values["friction_offset", i + 1] for i in range(n)])
    data.ctrl[:] = (description.motors_of(torque) + offsets) / description.torque_per_volt
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qacc, 0.0, atol=1e-9 * np.abs(torque).max() / 2e-4)
    return model, data, order


def slope(mujoco: ModuleType, model: Any, data: Any, values: FloatArray, at: int) -> FloatArray:
    """Central difference of the accelerations by one state or control."""
    accelerations, start, step = [], values[at], STEP * max(1.0, abs(values[at]))
    for sign in (1.0, -1.0):
        values[at] = start + sign * step
        mujoco.mj_forward(model, data)
        accelerations.append(data.qacc.copy())
    values[at] = start
    return np.asarray((accelerations[0] - accelerations[1]) / (2.0 * step))


@pytest.mark.parametrize("motions", exports.MOTIONS)
@pytest.mark.parametrize(
    ("springs", "coupling"),
    [
        (("linear",) * 3, None),
        (("linear",) * 3, exports.COUPLING),
        (("rigid",) * 3, exports.COUPLING),
        (("linear", "rigid", "linear"), None),
    ],
)
def test_accelerations_have_the_derivatives_of_mujoco(
    mujoco: ModuleType,
    springs: exports.Springs,
    motions: exports.Motions,
    coupling: Matrix | None,
    tmp_path: Path,
) -> None:
    arm = exports.arm_of(*exports.chain(tmp_path, springs, motions, coupling))
    model, data, order = at_rest(mujoco, arm)
    linear, size = linear_arm(arm), len(order)
    for states, values in ((0, data.qpos), (size, data.qvel)):
        found = np.column_stack([slope(mujoco, model, data, values, at)[order] for at in order])
        expected = linear.A[size:, states : states + size]
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    driven = np.column_stack([slope(mujoco, model, data, data.ctrl, at)[order] for at in range(3)])
    np.testing.assert_allclose(0.1 * linear.B[size:], driven, atol=1e-6 * np.abs(driven).max())


def test_states_inputs_and_outputs_are_named(tmp_path: Path) -> None:
    arm = exports.arm_of(*exports.chain(tmp_path, ("linear", "rigid", "linear")))
    linear = linear_arm(arm)
    angles = ("motor_angle_1", "motor_angle_3", "link_angle_1", "link_angle_2", "link_angle_3")
    assert linear.states == (*angles, *(name.replace("angle", "velocity") for name in angles))
    assert linear.inputs == ("motor_torque_1", "motor_torque_2", "motor_torque_3")
    assert linear.outputs[2:4] == ("motor_velocity_3", "link_acceleration_1")
    # motor 2 is behind a rigid gear: its velocity is that of the link over the ratio
    motor = dict(zip(linear.states, linear.C[1].tolist(), strict=True))
    assert {name: weight for name, weight in motor.items() if weight} == {
        "link_velocity_2": pytest.approx(-1.0 / 0.0125)
    }


def test_one_joint_is_its_own_model(tmp_path: Path) -> None:
    """Transfer from torque to motor velocity and link acceleration, without gravity."""
    arm = exports.arm_of(*exports.single(tmp_path, spring="linear"))
    whole, alone = linear_arm(arm), state_space(arm, 1)
    for s in (2.0j, 30.0j, 200.0j):
        found = whole.C @ np.linalg.solve(s * np.eye(4) - whole.A, whole.B) + whole.D
        wanted = alone.C @ np.linalg.solve(s * np.eye(3) - alone.A, alone.B) + alone.D
        np.testing.assert_allclose(found[:, 0], wanted[:, 0], rtol=1e-9)


def test_a_missing_parameter_is_refused(tmp_path: Path) -> None:
    study, values = exports.chain(tmp_path)
    del values["gear_damping", 2]
    with pytest.raises(InvalidInput, match="gear_damping of joint 2 is missing"):
        linear_arm(exports.arm_of(study, values))
