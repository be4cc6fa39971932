"""Base parameters: rank, grouping, and the same torques as the parameters they replace."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from strainwave.domain import ArmDescription, FloatArray, Joint, Motion, Origin
from strainwave.domain.arm.base_parameters import base_parameters, core_arm
from strainwave.domain.arm.kinds import kind_of, planar_two_link, single_joint
from strainwave.domain.keys import Key
from strainwave.dynamics.arm import Arm

PLANAR = planar_two_link([Joint("linear", -0.01), Joint("linear", 0.02)], 0.35, 9.81)
PENDULUM = single_joint(Joint("linear", 0.01), 9.81)


def random_chain(seed: int, n: int) -> ArmDescription:
    """A chain with axes in any direction, prismatic joints, gears of either sign and coupling."""
    rng = np.random.default_rng(seed)

    def joint() -> Joint:
        x, y, z, roll, pitch, yaw, a, b, c = rng.normal(size=9).tolist()
        return Joint(
            "linear",
            float(rng.choice([-0.02, 0.01])),
            "revolute" if rng.uniform() < 0.8 else "prismatic",
            origin=Origin((0.2 * x, 0.2 * y, 0.2 * z), (roll, pitch, yaw)),
            axis=(a, b, c),
        )

    coupling = np.eye(n) + 0.2 * np.tril(rng.normal(size=(n, n)), -1)
    gx, gy, gz = (5.0 * rng.normal(size=3)).tolist()
    return ArmDescription(
        "serial",
        tuple(joint() for _ in range(n)),
        (gx, gy, gz),
        tuple(tuple(row) for row in coupling.tolist()),
    )


def motion(n: int, seed: int = 1) -> tuple[FloatArray, FloatArray, FloatArray]:
    angle, velocity, acceleration = np.random.default_rng(seed).normal(size=(3, 40, n))
    return angle, velocity, acceleration


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 6))
@example(782, 1)  # a motor whose column is 1e10 times that of a moment of inertia
def test_base_parameters_have_the_torques_of_all_parameters(seed: int, n: int) -> None:
    arm = Arm.of(random_chain(seed, n))
    base = arm.base
    standard = np.asarray(np.random.default_rng(seed).normal(size=base.rows.shape[1]))
    n_links = len(base.links)
    angle, velocity, acceleration = motion(n)
    links = arm.base_regressor(angle, velocity, acceleration) @ standard[:n_links]
    expected = arm.motors_of(links)
    expected = expected + standard[n_links:] * arm.motor_accelerations(acceleration)
    torque = arm.rigid_regressor(angle, velocity, acceleration) @ (base.rows @ standard)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(torque, expected, atol=1e-6 * scale)
    for share in (0.0, 0.4):
        product = base.rows @ base.particular(share)
        np.testing.assert_allclose(product, np.eye(len(base.columns)), atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 6))
def test_their_number_is_the_rank_of_the_regressor(seed: int, n: int) -> None:
    arm = Arm.of(random_chain(seed, n))
    phi = arm.rigid_regressor(*motion(n, seed)).reshape(40 * n, -1)
    phi = phi / np.linalg.norm(phi, axis=0)
    assert np.linalg.matrix_rank(phi, tol=1e-7) == phi.shape[1]


@pytest.mark.parametrize("arm", [PLANAR, PENDULUM], ids=["two links", "pendulum"])
def test_named_parameters_are_rows_over_the_standard_parameters(arm: ArmDescription) -> None:
    """The compiled fast path has the regressor of the chain, column by column."""
    chain = core_arm(ArmDescription("serial", arm.joints, arm.gravity), ["rigid"] * arm.n_joints)
    fast = core_arm(arm, ["rigid"] * arm.n_joints)
    standard = {key: float(k + 1) for k, key in enumerate(chain.parameter_names)}
    rows = kind_of(arm).standard_rows(arm)
    q, dq, ddq = motion(arm.n_joints)
    full = chain.base_regressor(q, dq, ddq)
    used = {key for row in rows.values() for key in row}
    names = [tuple(name) for name in chain.parameter_names][: full.shape[2]]
    torque = full @ np.array([standard[key] if key in used else 0.0 for key in names])
    reduced = fast.base_regressor(q, dq, ddq)
    values = [sum(w * standard[k] for k, w in rows[key].items()) for key in rows]
    assert [tuple(name) for name in fast.parameter_names][: len(rows)] == list(rows)
    np.testing.assert_allclose(reduced @ np.array(values), torque, rtol=1e-12, atol=1e-10)


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 10**6), st.integers(2, 6), st.floats(-12.0, -2.0).map(lambda power: 10.0**power)
)
def test_nearly_parallel_axes_have_base_parameters(seed: int, n: int, tilt: float) -> None:
    """The torques of all parameters, to the tolerance at which axes count as parallel."""
    random = np.random.default_rng(seed)

    def joint() -> Joint:
        right = 0.5 * np.pi * random.integers(-1, 3, 3)
        roll, pitch, yaw = (right + tilt * random.integers(-1, 2, 3)).tolist()
        a, b, c = (np.eye(3)[random.integers(3)] + tilt * random.normal(size=3)).tolist()
        x, y, z = (random.choice([0.0, 0.1, 0.3], 3) + tilt * random.normal(size=3)).tolist()
        kind: Motion = "revolute" if random.uniform() < 0.8 else "prismatic"
        origin = Origin((x, y, z), (roll, pitch, yaw))
        return Joint("rigid", 0.01, kind, origin=origin, axis=(a, b, c))

    arm = Arm.of(ArmDescription("serial", tuple(joint() for _ in range(n)), (0.0, tilt, -9.81)))
    base, n_links = arm.base, len(arm.base.links)
    standard = np.asarray(random.normal(size=base.rows.shape[1]))
    standard[n_links:] *= 1e-4
    angle, velocity, acceleration = motion(n)
    links = arm.base_regressor(angle, velocity, acceleration)
    motors = standard[n_links:] * arm.motor_accelerations(acceleration)
    reduced = base.particular() @ (base.rows @ standard)
    motors_reduced = reduced[n_links:] * arm.motor_accelerations(acceleration)
    expected = arm.motors_of(links @ standard[:n_links]) + motors
    torque = arm.motors_of(links @ reduced[:n_links]) + motors_reduced
    np.testing.assert_allclose(torque, expected, atol=1e-4 * np.abs(expected).max())


def test_grouping_of_two_parallel_axes_is_exact() -> None:
    columns = {column.key: column.parts for column in base_parameters(PLANAR).columns}
    names = ("beta", "gamma", "gravity_torque_1", "gravity_torque_2")
    alone: list[Key] = [(name, None) for name in names]
    assert columns == {
        ("rigid_inertia", 1): {("alpha", None): 1.0, ("motor_inertia", 1): 0.01**-2},
        ("motor_inertia", 2): {("motor_inertia", 2): 1.0},
        **{key: {key: 1.0} for key in alone},
    }


def test_groups_of_a_chain_are_those_of_the_literature() -> None:
    """Vertical axis 1, horizontal axis 2: Izz1 + Iyy2 + n^-2 m_M1, and Ixx2 - Iyy2 (Khalil)."""
    up = Origin((0.0, 0.0, 0.3), (np.pi / 2.0, 0.0, 0.0))
    chain = ArmDescription(
        "serial", (Joint("linear", 0.01), Joint("linear", 0.02, origin=up)), (0.0, 0.0, -9.81)
    )
    columns = {column.key: column.parts for column in base_parameters(chain).columns}
    assert columns["grouped_link_inertia_zz", 1] == pytest.approx(
        {("link_inertia_zz", 1): 1.0, ("link_inertia_yy", 2): 1.0, ("motor_inertia", 1): 1e4}
    )
    assert columns["grouped_link_inertia_xx", 2] == pytest.approx(
        {("link_inertia_xx", 2): 1.0, ("link_inertia_yy", 2): -1.0}
    )
    assert columns["grouped_link_inertia_zz", 2] == pytest.approx(
        {("link_inertia_zz", 2): 1.0, ("motor_inertia", 2): 0.02**-2}
    )


@pytest.mark.parametrize("text", ["1.57", "1.571", "1.5707", "1.5708", "1.5707963", "1.570796327"])
def test_rounded_right_angles_have_the_base_parameters_of_exact_ones(text: str) -> None:
    """Axes that are almost parallel would have more: 41 instead of 40 here."""

    def chain(angle: float) -> ArmDescription:
        turns = ((angle * (k % 2), 0.0, -2.0 * np.pi if k == 5 else 0.0) for k in range(6))
        joints = (Joint("rigid", 1.0, origin=Origin((0.05, 0.1, 0.3), turn)) for turn in turns)
        return ArmDescription("serial", tuple(joints), (0.0, 0.0, -9.81))

    exact = chain(0.5 * np.pi)
    assert chain(float(text)) == exact
    assert len(base_parameters(exact).columns) == 40
    assert Origin(rpy=(1.58, 0.02, -0.5)).rpy == (1.58, 0.02, -0.5)
