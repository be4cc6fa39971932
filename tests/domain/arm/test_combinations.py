"""Viscous friction of links that several motors turn, in the unknowns of rigid motion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from strainwave.domain import ArmDescription, FloatArray, Joint, Origin
from strainwave.domain.arm.combinations import FRICTION_COLUMNS, value_of
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm

RATIOS = (0.01, -0.02, 0.0125)
DIFFERENTIAL = ((1.0, 0.0, 0.0), (0.0, 0.5, 0.5), (0.0, 0.5, -0.5))


def chain(coupling: tuple[tuple[float, ...], ...] | None) -> Arm:
    turned = Origin((0.0, 0.0, 0.3), (1.5, 0.0, 0.0))
    joints = tuple(Joint("rigid", ratio, origin=turned) for ratio in RATIOS)
    return Arm.of(ArmDescription("serial", joints, (0.0, 0.0, -9.81), coupling=coupling))


def viscous_torque(arm: Arm, motor: FloatArray, link: FloatArray) -> FloatArray:
    """Torques per motor velocity of the unknowns of rigid motion, (n_joints, n_joints)."""
    frictions: Values = {("motor_viscous_friction", i + 1): value for i, value in enumerate(motor)}
    frictions |= {("link_viscous_friction", i + 1): value for i, value in enumerate(link)}
    columns = arm.rigid_columns[arm.n_body :]
    at_joints = columns[: FRICTION_COLUMNS * arm.n_joints : FRICTION_COLUMNS]
    diagonal = [value_of(column.parts, frictions) for column in at_joints]
    shared = columns[len(columns) - arm.n_shared :]
    values = np.array([value_of(column.parts, frictions) for column in shared])
    of_links = arm.shared_friction_regressor(np.eye(arm.n_joints)) @ values
    return np.asarray(np.diag(diagonal) + of_links)


@given(
    arrays(float, (3, 3), elements=st.sampled_from([-1.0, 0.0, 0.3, 0.5])),
    arrays(float, (2, 3), elements=st.floats(0.0, 1.0)),
)
def test_the_unknowns_give_the_viscous_torque(further: FloatArray, friction: FloatArray) -> None:
    """D_M + T' D_L T of any coupling, in as many unknowns as this matrix has dimensions."""
    coupling = np.eye(3) + np.tril(further, -1)
    arm = chain(tuple(map(tuple, coupling.tolist())))
    T = arm.transmission
    expected = np.diag(1e-4 * friction[0]) + T.T @ np.diag(friction[1]) @ T
    actual = viscous_torque(arm, 1e-4 * friction[0], friction[1])
    np.testing.assert_allclose(actual, expected, atol=1e-12)
    independent = [np.outer(row, row) for row in coupling * RATIOS]
    units = [1e-4 * np.diag(unit) for unit in np.eye(3)]
    rank = np.linalg.matrix_rank(np.array([*units, *independent]).reshape(6, 9), tol=1e-9)
    assert 3 + arm.n_shared == rank


def test_a_differential_wrist_has_grouped_friction() -> None:
    arm = chain(DIFFERENTIAL)
    names = [column.name for column in arm.rigid_columns if "viscous" in column.name]
    assert names == [
        "total_viscous_friction",
        "grouped_total_viscous_friction",
        "grouped_total_viscous_friction",
        "grouped_link_viscous_friction",
    ]
    motor, link = np.array([1e-4, 2e-4, 3e-4]), np.array([0.5, 0.8, 0.3])
    T = arm.transmission
    expected = np.diag(motor) + T.T @ np.diag(link) @ T
    np.testing.assert_allclose(viscous_torque(arm, motor, link), expected, atol=1e-12)


@pytest.mark.parametrize("coupling", [None, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))])
def test_links_of_one_motor_have_no_friction_of_their_own(
    coupling: tuple[tuple[float, ...], ...] | None,
) -> None:
    assert chain(coupling).n_shared == 0
