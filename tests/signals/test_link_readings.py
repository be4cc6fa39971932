"""Readings of link sensors against the closed forms (8), (9) and planar chains of three links."""

from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import Control, Experiment, FloatArray, Joint, Log, Study
from strainwave.domain.arm.description import ArmDescription, Origin
from strainwave.domain.arm.kinds.planar import in_plane_gravity, planar_two_link, single_joint
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import (
    JointMotion,
    acceleration_gain,
    angle_derivatives,
    channel_weights,
    read_gravity,
    read_link,
    reading_parts,
)
from strainwave.input_check.evidence import collect_evidence
from strainwave.input_check.sensors import regress_readings
from strainwave.signals.link_motion import prepare_link_signals
from strainwave.signals.link_readings import LinkReading

LENGTH, DISTANCES = 0.35, (0.3, 0.25, 0.2)
ROUNDING = 1e-13  # of sums of numbers of about ten


def ideal_reading(arm: Arm, motion: JointMotion, i: int, kind: str) -> FloatArray:
    weights = channel_weights(arm.joints[i], kind)
    assert weights is not None
    return np.asarray(read_link(arm, motion, i) @ weights)


def parts_of(arm: Arm, motion: JointMotion, i: int) -> dict[str, FloatArray]:
    return reading_parts(arm, motion, "a", i) or {}


def drive(i: int) -> Joint:
    return Joint("linear", 0.01, accelerometer_distance=DISTANCES[i])


def random_motion(n_joints: int) -> JointMotion:
    return JointMotion(*np.random.default_rng(n_joints).uniform(-2.0, 2.0, (3, 20, n_joints)))


def chain(n_joints: int, gravity: float) -> Arm:
    """A planar arm of equal links as a chain."""
    joints = [
        replace(drive(i), origin=Origin((LENGTH if i else 0.0, 0.0, 0.0))) for i in range(n_joints)
    ]
    return Arm.of(ArmDescription("serial", tuple(joints), in_plane_gravity(gravity)))


def closed_form(motion: JointMotion, i: int, gravity: float) -> FloatArray:
    """Specific force of a point at the accelerometer's distance on link i, along the tangent."""
    angle, rate, turning = (
        x.cumsum(axis=1)[:, : i + 1] for x in (motion.angle, motion.velocity, motion.acceleration)
    )
    lengths = np.array([LENGTH] * i + [DISTANCES[i]])
    force = (lengths * (1j * turning - rate**2) * np.exp(1j * angle)).sum(axis=1) + 1j * gravity
    return np.asarray((force * np.exp(-1j * angle[:, i])).imag)


@pytest.mark.parametrize("gravity", [0.0, 9.81])
def test_planar_arms_read_8_and_9(gravity: float) -> None:
    motion = random_motion(2)
    q, dq, ddq = motion.angle, motion.velocity, motion.acceleration
    arm = Arm.of(planar_two_link([drive(0), drive(1)], LENGTH, gravity))
    first, second = (parts_of(arm, motion, i) for i in (0, 1))
    carried = LENGTH * (ddq[:, 0] * np.cos(q[:, 1]) + dq[:, 0] ** 2 * np.sin(q[:, 1]))
    expected = DISTANCES[1] * ddq.sum(axis=1)
    np.testing.assert_allclose(first["own-joint"], DISTANCES[0] * ddq[:, 0], atol=ROUNDING)
    np.testing.assert_array_equal(first["origin-motion"], 0.0)
    np.testing.assert_allclose(first["gravity"], gravity * np.cos(q[:, 0]), atol=ROUNDING)
    np.testing.assert_allclose(second["own-joint"], expected, atol=ROUNDING)
    np.testing.assert_allclose(second["origin-motion"], carried, atol=ROUNDING)
    np.testing.assert_allclose(second["gravity"], gravity * np.cos(q.sum(axis=1)), atol=ROUNDING)
    np.testing.assert_allclose(ideal_reading(arm, motion, 1, "gyro"), dq.sum(axis=1), atol=ROUNDING)
    gains = LinkReading(2, "accelerometer", gain=DISTANCES[1]).preceding_gains(arm, q)
    expected = DISTANCES[1] + LENGTH * np.cos(q[:, 1])
    np.testing.assert_allclose(gains[:, 0], expected, atol=ROUNDING)
    gains = LinkReading(2, "gyro").preceding_gains(arm, q)
    np.testing.assert_allclose(gains, 1.0, atol=ROUNDING)


def test_a_slide_reads_its_acceleration() -> None:
    arm, motion = Arm.of(single_joint(Joint("linear", 0.01, "prismatic"))), random_motion(1)
    reading = parts_of(arm, motion, 0)
    np.testing.assert_array_equal(reading["own-joint"], motion.acceleration[:, 0])
    np.testing.assert_array_equal(reading["gravity"], 0.0)


@pytest.mark.parametrize("gravity", [0.0, 9.81])
@pytest.mark.parametrize("n_joints", [1, 2, 3])
def test_planar_chains_of_any_length(n_joints: int, gravity: float) -> None:
    arm, motion = chain(n_joints, gravity), random_motion(n_joints)
    for i in range(n_joints):
        expected = closed_form(motion, i, gravity)
        reading = parts_of(arm, motion, i)
        np.testing.assert_allclose(sum(reading.values()), expected, atol=ROUNDING)
        np.testing.assert_allclose(ideal_reading(arm, motion, i, "a"), expected, atol=ROUNDING)
        np.testing.assert_allclose(
            ideal_reading(arm, motion, i, "gyro"),
            motion.velocity[:, : i + 1].sum(axis=1),
            atol=ROUNDING,
        )
        any_gravity = read_gravity(arm, motion.angle, i, np.array([[0.0, -gravity, 0.0]]))
        np.testing.assert_allclose(any_gravity[:, 0], reading["gravity"], atol=ROUNDING)
        gains = np.zeros_like(motion.angle)
        accelerometer = LinkReading(i + 1, "accelerometer", gain=DISTANCES[i])
        gains[:, :i] = accelerometer.preceding_gains(arm, motion.angle)
        gains[:, i] = acceleration_gain(arm.joints[i])
        still = replace(motion, acceleration=np.zeros_like(motion.angle))
        rest = closed_form(still, i, gravity)
        np.testing.assert_allclose(
            rest + (gains * motion.acceleration).sum(axis=1), expected, atol=ROUNDING
        )
        for j in range(n_joints):
            step = 1e-6 * (np.arange(n_joints) == j)
            high, low = (
                closed_form(replace(motion, angle=motion.angle + s), i, gravity)
                for s in (step, -step)
            )
            slope = angle_derivatives(arm, motion, i)[:, j]
            # rounding of numbers of about ten, over the step
            np.testing.assert_allclose(slope, (high - low) / 2e-6, atol=1e-8)


def slow_log(arm: Arm, gravity: float, amplitude: float = 0.4) -> tuple[Log, JointMotion]:
    """Ideal readings of a chain whose links follow their motors, and the motion."""
    n = arm.n_joints
    t: FloatArray = 2e-3 * np.arange(20_000, dtype=np.float64)
    angle, velocity, acceleration = (np.zeros((len(t), n)) for _ in range(3))
    for w in (1.1, 2.3, 3.7):  # [rad/s]
        phase = np.multiply.outer(w * t, 1.0 + 0.17 * np.arange(n)) + np.arange(n)
        rate = w * (1.0 + 0.17 * np.arange(n))
        angle += amplitude * np.sin(phase)
        velocity += amplitude * rate * np.cos(phase)
        acceleration -= amplitude * rate**2 * np.sin(phase)
    motion = JointMotion(angle, velocity, acceleration)
    control: list[Control] = ["open"] * n
    experiment = Experiment("motion", "", "motion", tuple(control))
    noise = np.random.default_rng(0).normal(0.0, 1e-6, (len(t), n))
    channels = {}
    for i in range(n):
        channels[f"theta_m{i + 1}"] = angle[:, i] / arm.joints[i].gear_ratio + noise[:, i]
        channels[f"a{i + 1}"] = closed_form(motion, i, gravity)
        channels[f"torque{i + 1}"] = np.sin(t + i)
    return Log(experiment, t, 2e-3, channels), motion


@pytest.mark.parametrize("gravity", [0.0, 9.81])
def test_accelerometers_of_three_links_give_their_motion(gravity: float) -> None:
    arm = chain(3, gravity)
    log, motion = slow_log(arm, gravity)
    signals = prepare_link_signals(log, arm)
    inner = slice(2000, -2000)
    # fusion with the motors below 0.1 Hz, differentiated from angles with noise
    scale = motion.acceleration.std()
    error = (signals.link_acceleration - motion.acceleration)[inner]
    assert np.abs(error).max() < 0.01 * scale
    assert np.abs((signals.link_velocity - motion.velocity)[inner]).max() < 0.01 * scale


@pytest.mark.parametrize("gravity", [0.0, 9.81])
def test_the_input_check_predicts_accelerometers_of_three_links(gravity: float) -> None:
    arm = chain(3, gravity)
    log, _ = slow_log(arm, gravity, 0.1)
    study = Study(arm=arm, experiments=(log.experiment,))
    readings = [x for _, each in regress_readings(collect_evidence([log], study)) for x in each]
    assert [reading.channel for reading in readings] == ["a1", "a2", "a3"]
    for reading in readings:
        # products of filtered angles are not the filtered products
        assert reading.values["scale"][0] == pytest.approx(1.0, abs=0.01)
        assert reading.explained > 0.999
        for part in {"own-joint", "origin-motion", "gravity"} & set(reading.values):
            assert reading.values[part][0] == pytest.approx(1.0, abs=0.03)
        assert ("rotation-ratio" in reading.values) == (reading.channel != "a1")
        if "rotation-ratio" in reading.values:
            ratio, std = reading.values["rotation-ratio"]
            assert ratio == pytest.approx(1.0, abs=3.0 * std)
        if "tilt" in reading.values:
            assert gravity == 0.0
            assert reading.values["tilt"][0] < 1e-3
