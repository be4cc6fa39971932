"""Link motion of planar arms and of chains, and its derivatives."""

from typing import Any

import numpy as np
import pytest

from serial_chains import Joint, chain, random_joints
from strainwave.domain import Joint as Drive
from strainwave.domain.arm.kinds.planar import planar_two_link, single_joint
from strainwave.domain.keys import Key
from strainwave.dynamics.arm import Arm

GRAVITY, LENGTH = 9.81, 0.35
DRIVE = Drive("linear", 0.01)


def test_planar_arms_are_chains() -> None:
    def turning(x: float) -> Joint:
        return ("revolute", [x, 0.0, 0.0], [0.0] * 3, [0.0, 0.0, 1.0])

    motion = np.random.default_rng(1).uniform(-2.0, 2.0, (3, 10, 2))
    for gravity in (0.0, GRAVITY):
        for arm, places in [
            (Arm.of(planar_two_link((DRIVE, DRIVE), LENGTH, gravity)), [0.0, LENGTH]),
            (Arm.of(single_joint(DRIVE, gravity)), [0.0]),
        ]:
            same = chain([turning(x) for x in places], gravity=[0.0, -gravity, 0.0])
            parts = np.ascontiguousarray(motion[:, :, : len(places)])
            np.testing.assert_array_equal(arm.link_motion(*parts), same.link_motion(*parts))
    slide = Arm.of(single_joint(Drive("linear", 0.01, "prismatic")))
    expected = np.zeros((10, 1, 9))
    expected[:, 0, 6] = motion[2, :, 0]
    np.testing.assert_array_equal(slide.link_motion(*motion[:, :, :1]), expected)


def test_a_link_of_a_vertical_arm() -> None:
    q, dq, ddq = np.array([[0.4]]), np.array([[1.5]]), np.array([[-2.0]])
    motion = Arm.of(single_joint(DRIVE, GRAVITY)).link_motion(q, dq, ddq)
    expected = [0.0, 0.0, 1.5, 0.0, 0.0, -2.0, GRAVITY * np.sin(0.4), GRAVITY * np.cos(0.4), 0.0]
    np.testing.assert_allclose(motion[0, 0], expected, atol=1e-15)


@pytest.mark.parametrize("types", ["r", "p", "rp", "prr", "rrprprr"])
def test_derivatives_match_differences(types: str) -> None:
    n, samples, h = len(types), 5, 1e-6
    rng = np.random.default_rng(n)
    arm = chain(random_joints(rng, n, types))
    motion = rng.uniform(-2.0, 2.0, (3, samples, n))
    derivatives = arm.link_motion_derivatives(*motion)
    assert len(derivatives) == 3
    for kind, derivative in enumerate(derivatives):
        assert derivative.shape == (samples, n, 9, n)
        for j in range(n):
            step = np.zeros_like(motion)
            step[kind, :, j] = h
            rise = arm.link_motion(*(motion + step)) - arm.link_motion(*(motion - step))
            # rounding of numbers of about 100, over the step, and the step's square
            np.testing.assert_allclose(derivative[..., j], rise / (2 * h), atol=1e-7, rtol=1e-8)


def test_a_single_joint_is_a_chain() -> None:
    """Simulation, sensors and derivatives agree with those of the equivalent chain."""
    place: Joint = ("revolute", [0.0] * 3, [0.0] * 3, [0.0, 0.0, 1.0])
    arm = Arm.of(single_joint(DRIVE, GRAVITY)).core
    same = chain([place], gravity=[0.0, -GRAVITY, 0.0])
    inertia, moment = 0.6, 1.2
    body = [4.0, moment, 0.0, 0.0, 0.3, 0.0, inertia, 0.0, 0.0, inertia]
    drive = [1.5e-4, 2e-4, 0.06, 0.01, 0.5, 2e4, 10.0, 3e-4]
    names: list[Key] = [("motor_inertia", 1), ("motor_coulomb_friction", 1), ("gear_stiffness", 1)]
    signals = ["specific_force_x", "specific_force_y", "angular_acceleration_z"]
    signals += ["rate_product_zz", "angular_rate_z"]
    experiment: dict[str, Any] = {
        "voltage": np.random.default_rng(3).choice([-0.3, 0.3], (50, 1)),
        "motor_angle": [30.0],
        "step": 1.25e-4,
        "steps_per_tick": 8,
        "steps_per_sample": 8,
        "samples": 50,
        "record": ["motor_angle", "torsion", "gear_torque", "accelerometer", "gyro", *signals],
    }
    planar: list[Key] = [("link_inertia", 1), ("gravity_torque_1", None)]
    spatial: list[Key] = [("link_inertia_zz", 1), ("link_first_moment_x", 1)]
    one, other = (
        core.sensitivities(
            np.array([*base, *drive]), core.experiment(**experiment), [*of_link, *names]
        )
        for core, base, of_link in (
            (arm, [inertia, GRAVITY * moment], planar),
            (same, body, spatial),
        )
    )
    for name, (values, tangents) in one.items():
        expected, by_chain = other[name]
        tangents[..., 1] *= GRAVITY
        # rounding, amplified in some 400 steps
        np.testing.assert_allclose(values, expected, atol=1e-10 * abs(expected).max())
        size = abs(by_chain).max(axis=(0, 1))
        np.testing.assert_allclose(tangents / size, by_chain / size, atol=1e-8)
