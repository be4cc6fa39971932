"""Observers: against the recursion of a Kalman filter, and on simulated moves."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import exports
from servo_arms import correct, predict, rig
from strainwave.domain.arm.description import Imu
from strainwave.export import IdentifiedArm
from strainwave.io.joint_covariance import IdentifiedNoise
from strainwave.io.results import noise_of
from strainwave.tune.closed_loop import Clock
from strainwave.tune.design import ServoDesign, ServoOptions, design_servo
from strainwave.tune.observer import Observer, design_observers
from strainwave.tune.plants import Condition

CLOCK = Clock(1e-3, 4e-4)
NOISE = IdentifiedNoise(
    {"omega_m1": 1e-4, "omega_m2": 2e-4, "a1": 0.02, "a2": 0.03}, {1: 1e-3, 2: 1e-3}, 5.0
)


def observers(arm: IdentifiedArm | None = None, *, sensors: bool = True) -> tuple[Observer, ...]:
    condition = Condition(np.zeros(2))
    return design_observers(arm or rig(), condition, CLOCK, NOISE, uses_link_sensors=sensors)


@cache
def designed() -> ServoDesign:
    return design_servo(rig(8192), None, ServoOptions(postures=((0.0, 0.0),), draws=2))


def test_a_filter_is_stable_and_reads_what_was_logged() -> None:
    for number, one in enumerate(observers(), start=1):
        closed = one.A @ (np.eye(len(one.A)) - one.L @ one.C)  # of the error of the prediction
        assert np.abs(np.linalg.eigvals(closed)).max() < 1.0
        assert [each.name for each in one.measurements] == ["motor encoder", "accelerometer"]
        assert one.measurements[0].std == NOISE.samples[f"omega_m{number}"]
        assert all(each.source == "identified" for each in one.measurements)
        assert [text.partition(":")[0] for text in one.unused] == ["gyro"]  # of 5 Hz


def test_the_system_is_the_recursion_of_correction_and_prediction() -> None:
    rng = np.random.default_rng(4)
    for one in observers():
        system, x = one.system, rng.normal(size=len(one.A))
        z = x.copy()
        for _ in range(20):
            readings, torque, voltage = rng.normal(size=len(one.C)), rng.normal(), rng.normal()
            estimate = correct(one, x, readings, torque)
            inputs = np.array([voltage, torque, *readings])
            np.testing.assert_allclose(system.C @ z + system.D @ inputs, estimate[2:4], rtol=1e-9)
            x, z = predict(one, estimate, voltage, torque), system.A @ z + system.B @ inputs
            np.testing.assert_allclose(z, x, rtol=1e-9)


def test_link_angles_are_far_better_than_the_motor_alone() -> None:
    for one in designed().estimation:
        assert one.by_observer < 0.1 * one.by_motor
        assert one.by_observer < 0.5 * one.without_interaction
        assert one.velocity_by_observer < 0.3 * one.velocity_by_motor


def test_a_slow_gyro_is_named_and_not_used() -> None:
    noise = replace(NOISE, samples={**NOISE.samples, "gyro1": 1e-3})
    arm = rig()
    for hz, is_used in ((5.0, False), (500.0, True)):
        study = replace(arm.study, arm=arm.study.arm.with_joint(1, gyro_hz=hz))
        changed = replace(arm, study=study)
        first, _ = design_observers(changed, Condition(np.zeros(2)), CLOCK, noise)
        assert ("gyro" in [one.name for one in first.measurements]) == is_used
        assert (f"bandwidth of {hz:g} Hz" in " ".join(first.unused)) != is_used


def test_an_imu_gives_the_rate_about_the_joint_axis() -> None:
    """Turned by a quarter about x, its y axis is along the joint axis."""
    arm = rig()
    imu = Imu((0.1, 0.0, 0.0), (np.pi / 2.0, 0.0, 0.0), 300.0, 300.0)
    joint = replace(arm.study.arm.joints[0], imu=imu, accelerometer_distance=None)
    joints = (joint, arm.study.arm.joints[1])
    changed = replace(arm, study=replace(arm.study, arm=arm.study.arm.with_joints(joints)))
    noise = replace(NOISE, samples={"gx1": 1e-3, "gy1": 2e-3, "gz1": 3e-3})
    first, _ = design_observers(changed, Condition(np.zeros(2)), CLOCK, noise)
    gyro = next(one for one in first.measurements if "gyro" in one.name)
    assert (gyro.name, gyro.quantity) == ("IMU's gyros", "link_velocity")
    assert gyro.channels == ("gy1",)
    np.testing.assert_allclose(gyro.weights, [1.0], atol=1e-12)
    assert gyro.std == pytest.approx(2e-3)


def test_a_second_encoder_is_used() -> None:
    arm = rig()
    study = replace(arm.study, arm=arm.study.arm.with_joint(1, link_encoder_counts=2**17))
    first, second = design_observers(
        replace(arm, study=study), Condition(np.zeros(2)), CLOCK, NOISE
    )
    encoder = next(one for one in first.measurements if one.name == "link encoder")
    assert encoder.std == pytest.approx(2.0 * np.pi / 2**17 / np.sqrt(12.0))
    # the gain of the motor encoder falls as the second encoder determines the link
    assert np.abs(first.L[2, 0]) < np.abs(observers()[0].L[2, 0])
    assert len(second.measurements) == 2


def test_the_noise_of_a_result_is_the_median_over_records() -> None:
    residuals = [{"channel": "a1", "sample_noise": x} for x in (1.0, 3.0, 2.0)]
    document = {
        "stages": {
            "tuned": {"criticism": {"residuals": residuals}},
            "rigid": {"torque_errors": [{"joint": 2, "value": 0.5}], "bandwidth_hz": 4.0},
        }
    }
    assert noise_of(document) == IdentifiedNoise({"a1": 2.0}, {2: 0.5}, 4.0)
    assert noise_of({"stages": {"tuned": None}}) == IdentifiedNoise()


def test_joints_that_several_motors_move_have_no_observer(tmp_path: Path) -> None:
    coupling = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -0.6, 1.0))
    observed = []
    for matrix in (None, coupling, exports.COUPLING):
        study, values = exports.chain(tmp_path, coupling=matrix)
        arm = exports.arm_of(study, values)
        found = design_observers(arm, Condition(np.zeros(3)), CLOCK, IdentifiedNoise())
        observed.append([one.joint for one in found])
    assert observed == [[1, 2, 3], [1], []]
