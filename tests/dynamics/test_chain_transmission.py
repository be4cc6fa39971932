"""Transmissions and gear ratios of both signs that describe an arm without a transmission."""

import numpy as np
import pytest

from serial_chains import Array, chain, parameters_of, random_body, random_joints

TYPES = "rrpr"
N = len(TYPES)
RATIOS = np.array([0.01, 0.012, 0.02, 0.015])
MIXED = np.array([[0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1], [0, -1, 0, 0]])
"""Motors in another order, some of which turn in the other direction."""


def drives(spring: str, motors: Array) -> Array:
    """Parameters of motors behind a signed permutation and of gears: a row per joint."""
    size = np.arange(1.0, N + 1.0)
    own = abs(motors) @ size  # friction stops some motors
    offset, settling = 0.004 * (motors @ size), 3e-4 * (own - 1.0)
    # motors behind rigid gears are released one after the other, so that strong friction makes the
    # motion depend on their order
    coulomb = (0.1 if spring == "linear" else 0.02) * own
    motor = [1e-4 * own, 2e-4 * own, coulomb, offset, 0.5 * size]
    gear = [2e4 * size, 10.0 * size, settling] if spring == "linear" else []
    return np.column_stack([*motor, *gear])


def simulate(spring: str, motors: Array, transmission: Array | None, ratios: Array) -> Array:
    """Motion of motors in the order of the joints, and of links; torques of the gears."""
    rng = np.random.default_rng(5)
    joints = random_joints(rng, N, TYPES)
    base = np.concatenate([parameters_of(random_body(rng)) for _ in range(N)])
    torque = rng.choice([-0.6, 0.6], (60, N))
    arm = chain(
        joints,
        springs=[spring] * N,
        gear_ratio=ratios,
        transmission=None if transmission is None else transmission.tolist(),
        current_loop_hz=[1000.0] * N,
    )
    experiment = arm.experiment(
        torque @ motors.T,
        motor_angle=(motors @ rng.uniform(-30.0, 30.0, N)).tolist(),
        step=1.25e-4,
        steps_per_tick=8,
        steps_per_sample=8,
        samples=60,
        record=["motor_angle", "motor_velocity", "link_angle", "link_velocity", "gear_torque"],
    )
    parameters = np.concatenate([base, drives(spring, motors).ravel()])
    (record,) = arm.simulate(parameters[None], [experiment])
    angle, velocity, *others = record.values()
    assert (velocity == 0.0).any()
    return np.array([angle @ motors, velocity @ motors, *others])


@pytest.mark.parametrize("spring", ["linear", "rigid"])
def test_descriptions_of_one_arm_agree(spring: str) -> None:
    same = np.eye(N)
    expected = simulate(spring, same, None, RATIOS)
    size = np.maximum(abs(expected).max(axis=(1, 2), keepdims=True), 1e-3)
    factors = np.array([1.5, -0.7, 2.0, -1.0])
    mirrored = np.diag([1.0, -1.0, -1.0, 1.0])
    for motors, transmission, ratios in [
        (same, same, RATIOS),
        (same, np.diag(factors), RATIOS / factors),
        (mirrored, None, RATIOS @ mirrored),
        (MIXED, MIXED.T, abs(MIXED) @ RATIOS),
    ]:
        actual = simulate(spring, motors, transmission, ratios)
        # rounding, amplified in some 500 steps
        np.testing.assert_allclose(actual / size, expected / size, atol=1e-10)


def test_rigid_motion_agrees_with_inverse_dynamics() -> None:
    """A transmission couples the motors' inertias and their friction."""
    rng = np.random.default_rng(6)
    joints = random_joints(rng, N, TYPES)
    base = np.concatenate([parameters_of(random_body(rng)) for _ in range(N)])
    transmission = np.eye(N) + rng.uniform(-0.3, 0.3, (N, N))
    arm = chain(
        joints,
        springs=["rigid"] * N,
        gear_ratio=RATIOS * [1.0, -1.0, 1.0, -1.0],
        transmission=transmission.tolist(),
    )
    values = np.concatenate([base, drives("rigid", np.eye(N)).ravel()])
    torque = rng.choice([-8.0, 8.0], (40, N))
    motion = ["link_angle", "link_velocity", "link_acceleration"]
    experiment = arm.experiment(
        torque,
        motor_angle=rng.uniform(-10.0, 10.0, N).tolist(),
        step=1.25e-4,
        steps_per_tick=8,
        steps_per_sample=8,
        samples=40,
        record=[*motion, "motor_velocity", "motor_torque"],
    )
    (record,) = arm.simulate(values[None], [experiment])
    computed = arm.inverse_dynamics(values, *(record[name] for name in motion))
    moves = record["motor_velocity"] != 0.0
    assert moves.mean() > 0.9
    np.testing.assert_allclose(computed[moves], record["motor_torque"][moves], atol=1e-9)


def test_motor_torques_of_a_transmission() -> None:
    """The motors carry n C' T of the joints' torques T, and their inertia in C^-1 ddq / n."""
    rng = np.random.default_rng(7)
    joints = random_joints(rng, N, TYPES)
    base = np.concatenate([parameters_of(random_body(rng)) for _ in range(N)])
    transmission = np.eye(N) + rng.uniform(-0.3, 0.3, (N, N))
    ratios = RATIOS * [1.0, -1.0, 1.0, -1.0]
    inertia = np.array([1e-4, 2e-4, 3e-4, 4e-4])
    drive = [np.r_[m, 0.0, 0.0, 0.0, 0.0] for m in inertia]
    arm = chain(
        joints, springs=["rigid"] * N, gear_ratio=ratios, transmission=transmission.tolist()
    )
    motion = rng.uniform(-2.0, 2.0, (3, 5, N))
    computed = arm.inverse_dynamics(np.concatenate([base, *drive]), *motion)
    torques = arm.base_regressor(*motion) @ base
    motors = np.linalg.solve(transmission, motion[2].T).T / ratios
    expected = ratios * (torques @ transmission) + inertia * motors
    np.testing.assert_allclose(computed, expected, rtol=1e-11, atol=1e-12)
