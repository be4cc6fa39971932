"""Regressors, matrices and maps of an arm agree with the core's inverse dynamics."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import ArmDescription, FloatArray, Joint
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.kinds import change_arm_keys, single_joint
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.virtual import scara

ONE = Arm.of(single_joint(Joint("rigid", 0.02), gravity=9.81))
TWO = Arm.of(change_arm_keys(scara.STIFF.study(Path(), "rigid").arm, gravity=9.81))
ARMS = {"one joint": ONE, "two links": TWO}


def values_of(arm: Arm) -> Values:
    """Parameters without friction."""
    values: Values = dict.fromkeys(arm.parameter_names, 0.0)
    some = {"alpha": 1.6, "beta": 0.6, "gamma": 0.4, "link_inertia": 0.8}
    for name, joint in values:
        if name.startswith("gravity"):
            values[name, joint] = 12.0
        elif name == "motor_inertia":
            values[name, joint] = 2e-4
        else:
            values[name, joint] = some.get(name, 0.0)
    return values


def motion(arm: Arm, seed: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    angle, velocity, acceleration = rng.normal(size=(3, 50, arm.n_joints))
    return angle, velocity, acceleration


def rigid_values(arm: Arm) -> FloatArray:
    """Unknowns of the rigid model without friction."""
    values = values_of(arm)
    return np.array([value_of(c.parts, values) for c in arm.rigid_columns[: arm.n_body]])


@pytest.mark.parametrize("name", ARMS)
def test_regressor_times_parameters_is_the_inverse_dynamics(name: str) -> None:
    arm = ARMS[name]
    torque = arm.inverse_dynamics(arm.parameter_vector(values_of(arm)), *motion(arm))
    by_columns = arm.rigid_regressor(*motion(arm)) @ rigid_values(arm)
    np.testing.assert_allclose(by_columns, torque, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_rigid_torque_does_not_depend_on_the_motor_share(name: str) -> None:
    """With rigid gears an inertia at the motor or at the link causes the same torque."""
    arm = ARMS[name]
    angle, velocity, acceleration = motion(arm)
    n, solution = arm.gear_ratios, rigid_values(arm)
    expected = arm.rigid_regressor(angle, velocity, acceleration) @ solution
    for share in (0.0, 0.3, 1.0):
        base, motors = (
            arm.links_of_rigid(share) @ solution,
            arm.motors_of_rigid(share) @ solution,
        )
        links = arm.link_torques(base, angle, velocity, acceleration)
        np.testing.assert_allclose(n * links + motors * acceleration / n, expected, rtol=1e-10)


def test_inertia_matrices_give_the_torques_of_accelerations() -> None:
    angle, velocity, acceleration = motion(TWO)
    base = TWO.links_of_rigid() @ rigid_values(TWO)
    M = TWO.inertia_matrices(base, angle)
    at_rest = TWO.link_torques(base, angle, velocity, np.zeros_like(acceleration))
    torque = TWO.link_torques(base, angle, velocity, acceleration) - at_rest
    expected = np.einsum("kij,kj->ki", M, acceleration)
    np.testing.assert_allclose(torque, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(M, np.transpose(M, (0, 2, 1)), rtol=1e-12)
    np.testing.assert_array_equal(M[0], TWO.inertia_matrix(base, angle[0]))


def test_link_inertias_are_the_diagonal_of_the_stretched_inertia_matrix() -> None:
    values = values_of(TWO)
    base = np.array([values[key] for key in TWO.base_names])
    expected = [value_of(TWO.link_inertia(i), values) for i in (1, 2)]
    np.testing.assert_allclose(TWO.link_inertias(base), expected, rtol=1e-12)


def test_arms_are_values_with_a_cached_core() -> None:
    description: ArmDescription = scara.STIFF.study(Path()).arm
    arm = Arm.of(description)
    assert arm == Arm.of(description)
    assert arm.core is arm.core
    again = pickle.loads(pickle.dumps(arm))
    assert again == arm
    assert again.parameter_names == arm.parameter_names
    stiff = arm.with_joints(replace(joint, spring="rigid") for joint in arm.joints)
    assert isinstance(stiff, Arm)
    assert [joint.spring for joint in arm.joints] == ["three-slope"] * 2
    assert len(stiff.parameter_names) < len(arm.parameter_names)


def test_derived_arrays_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        TWO.gear_ratios[0] = 1.0
