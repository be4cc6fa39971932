"""Observers on simulated arms with curved gears, gravity, friction, counts and real sensors."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from servo_arms import identified, rig, vertical_rig
from strainwave.domain import FloatArray
from strainwave.domain.arm.description import Imu
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.dynamics.simulation import Drive, simulate_arms
from strainwave.errors import InvalidInput
from strainwave.export import IdentifiedArm
from strainwave.export.randomisation import drawn_values
from strainwave.io.joint_covariance import IdentifiedNoise
from strainwave.tune import design as design_module
from strainwave.tune.closed_loop import Clock, Gains
from strainwave.tune.design import ServoOptions, design_servo
from strainwave.tune.link_measurements import with_places
from strainwave.tune.observer import Observer, design_observers
from strainwave.tune.plants import Condition
from strainwave.tune.report.page import render
from strainwave.tune.verification import (
    EstimationError,
    PlannedInputs,
    Simulated,
    estimation_errors,
    read_runs,
    shortest_plan,
)
from strainwave.virtual import scara

CLOCK = Clock(1e-3, 0.0)
GAINS = [Gains(0.3, 5.0, 12.0, 1e-3), Gains(0.3, 5.0, 12.0, 1e-3)]
LIMITS = np.full(2, 10.0)  # [V]
IMU = Imu((0.2, 0.05, 0.0), (0.3, -0.2, 0.8), 400.0, 400.0)


def with_encoders(arm: IdentifiedArm, imu: Imu | None = None) -> IdentifiedArm:
    """The arm with motor encoders of 8192 counts, and an IMU in place of its accelerometers."""
    joints = tuple(replace(one, encoder_counts=8192) for one in arm.study.arm.joints)
    if imu is not None:
        joints = tuple(replace(one, imu=imu, accelerometer_distance=None) for one in joints)
    return replace(arm, study=replace(arm.study, arm=arm.study.arm.with_joints(joints)))


def curved_rig() -> IdentifiedArm:
    study = scara.STIFF.study(Path("nowhere"), "three-slope")
    return identified(study, scara.STIFF.parameters(3, "three-slope"))


ARMS = {"curved": curved_rig, "vertical": vertical_rig, "linear": rig}


def move(arm: IdentifiedArm, size: float = 0.05) -> tuple[Drive, FloatArray]:
    """A planned move of both joints, and its link angles."""
    begin = np.array([0.2, 0.9])
    plan = shortest_plan(arm, begin, begin + size, CLOCK.period, LIMITS)
    drive = Simulated.of(arm, LIMITS).follow(GAINS, plan)
    return drive, plan.extended(len(drive.reference)).link_angle


def observers(arm: IdentifiedArm, *, sensors: bool = True) -> tuple[Observer, ...]:
    condition = Condition(np.array([0.2, 0.9]))
    return design_observers(arm, condition, CLOCK, IdentifiedNoise(), uses_link_sensors=sensors)


@cache
def errors(name: str, *, has_imu: bool = False) -> tuple[EstimationError, ...]:
    arm = with_encoders(ARMS[name](), IMU if has_imu else None)
    draws = drawn_values(arm, None, 4, np.random.default_rng(5))
    both = observers(arm), observers(arm, sensors=False)
    simulated = Simulated.of(arm, LIMITS)
    return estimation_errors(simulated, *both, draws, *move(arm), np.random.default_rng(6))


@pytest.mark.parametrize("name", ARMS)
def test_observers_are_far_better_than_the_motor_alone(name: str) -> None:
    """The worst of five plants whose parameters differ by 3 % each from those of the observer."""
    for one in errors(name):
        assert one.by_observer < 0.2 * one.by_motor
        assert one.by_encoder < 0.35 * one.by_motor
        # gravity that is wrong by 3 % accelerates the estimated link at the begin of a record
        share = 1.0 if name == "vertical" else 0.3
        assert one.velocity_by_observer < share * one.velocity_by_motor


@pytest.mark.parametrize("name", ARMS)
def test_the_interaction_torque_makes_the_estimate_better(name: str) -> None:
    for one in errors(name):
        assert one.by_observer < 0.5 * one.without_interaction


@pytest.mark.parametrize("imu", [None, IMU])
@pytest.mark.parametrize("name", ["vertical", "linear"])
def test_the_known_part_is_that_of_other_joints_and_gravity(name: str, imu: Imu | None) -> None:
    """Without it, a reading of an ideal sensor is that of the motion of its own joint."""
    arm = with_encoders(ARMS[name](), imu)
    drive, planned = move(arm)
    one = observers(arm)[1]
    sensors = tuple(replace(each, std=0.0) for each in one.measurements if each.axes)
    assert {each.quantity for each in sensors} >= {"link_acceleration"}
    ideal = with_places(arm).with_joints(
        tuple(
            replace(
                joint,
                accelerometer_hz=None,
                gyro_hz=None,
                imu=imu and replace(imu, accelerometer_hz=None, gyro_hz=None),
            )
            for joint in arm.study.arm.joints
        )
    )
    names = [q for each in sensors for axis in each.axes for q in axis.quantities]
    own: list[Quantity] = ["voltage", "link_angle", "link_velocity", "link_acceleration"]
    runs = simulate_arms(
        ideal, [arm.values], drive, sample_time=CLOCK.period, samples=len(planned),
        record=list(dict.fromkeys([*own, *names])),
    )  # fmt: skip
    readings = read_runs(runs, sensors, 1, np.random.default_rng(0))[0]
    inputs = PlannedInputs.of(arm, runs["link_angle"][0], CLOCK.period)
    known = inputs.known_readings(replace(one, measurements=sensors))
    middle = slice(5, len(planned) // 2)
    for k, each in enumerate(sensors):
        expected = each.factor * runs[each.quantity][0, :, 1]
        got = (readings - known)[:, k]
        scale = np.abs(readings[middle, k] - readings[0, k]).max()
        # planned rates are central differences at 1 ms
        np.testing.assert_allclose(got[middle], expected[middle], rtol=0.0, atol=0.05 * scale)
        without = np.abs(readings[middle, k] - expected[middle]).max()
        assert without > 0.2 * scale  # the known part is not negligible


def test_an_imu_is_as_good_as_an_accelerometer() -> None:
    for one in errors("linear", has_imu=True):
        assert one.by_observer < 0.2 * one.by_motor


def test_an_arm_at_rest_is_estimated_from_the_first_sample() -> None:
    """Gravity twists the gears: the motor alone is wrong at rest, the observer is not."""
    for one in errors("vertical"):
        first = np.abs(one.errors[:5]).max(axis=0)
        assert first[1] < 0.1 * first[0]


def test_a_design_without_a_move_states_why_observers_are_unchecked() -> None:
    error = InvalidInput("a move takes more than 1 s", remedy="choose a smaller move")
    with patch.object(design_module, "errors_in_a_move", side_effect=error):
        result = design_servo(rig(8192), None, ServoOptions(postures=((0.0, 0.0),), draws=1))
    assert result.observers
    assert result.moves
    assert not result.estimation
    assert result.unchecked == "a move takes more than 1 s"
    assert "not compared in a move: a move takes more than 1 s." in render(result)


def test_a_design_without_plans_states_why_no_moves_are_compared() -> None:
    error = InvalidInput("a move takes more than 1 s", remedy="choose a smaller move")
    with patch.object(design_module, "plan_moves", side_effect=error):
        result = design_servo(rig(8192), None, ServoOptions(postures=((0.0, 0.0),), draws=1))
    assert result.modes_hz.any()
    assert not result.moves
    assert not result.estimation
    assert result.refusal == result.unchecked == "a move takes more than 1 s"
