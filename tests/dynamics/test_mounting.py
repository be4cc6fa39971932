"""Readings of a sensor at any position and attitude, compared with differences of its path."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import FloatArray, Imu, Study
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.domain.arm.link_sensors import SensorAxis, mounted_axes, unknowns_of
from strainwave.domain.arm.link_sensors.imu import ImuAccelerometers
from strainwave.domain.arm.link_sensors.link_space import (
    Quantity,
    accelerometer_weights,
    angles,
    attitude,
    rotation,
)
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import JointMotion, link_quantities
from strainwave.dynamics.simulation import Drive, simulate
from strainwave.signals.mounting_start import estimate_mounting_starts, imu_candidates
from strainwave.virtual import scara
from tuning_runs import shaken

XYZ, RPY = (0.21, -0.06, 0.04), (0.7, -0.4, 2.1)
IMU = Imu(XYZ, RPY)
NAMES = ("ax", "ay", "az", "gx", "gy", "gz")


def rig(gravity: float | None, joint: int, imu: Imu | None = IMU) -> Study:
    """The rig with an ideal IMU on one of its links."""
    study = scara.STIFF.study(Path("nowhere"))
    joints = tuple(
        replace(description, imu=imu if i == joint else None)
        for i, description in enumerate(study.arm.joints, start=1)
    )
    return replace(study, arm=change_arm_keys(study.arm.with_joints(joints), gravity=gravity))


def axes(study: Study, joint: int) -> tuple[SensorAxis, ...]:
    return mounted_axes(study.arm, joint, [f"{name}{joint}" for name in NAMES])


def path_of(angle: FloatArray, study: Study, joint: int) -> tuple[FloatArray, FloatArray]:
    """Position (n, 3) and attitude (n, 3, 3) of the sensor."""
    in_space = angle.cumsum(axis=1)

    def link_attitude(k: int) -> FloatArray:
        zero, one = np.zeros(len(angle)), np.ones(len(angle))
        c, s = np.cos(in_space[:, k]), np.sin(in_space[:, k])
        rows = [[c, -s, zero], [s, c, zero], [zero, zero, one]]
        return np.moveaxis(np.array(rows), 2, 0)

    attitudes = link_attitude(joint - 1)
    position = attitudes @ np.array(XYZ)
    if joint == 2:
        position = position + link_attitude(0) @ np.array(
            [study.arm.joints[1].origin.xyz[0], 0.0, 0.0]
        )
    return position, attitudes @ attitude(RPY)


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("gravity", [None, 9.81])
def test_the_simulated_imu_matches_its_path(gravity: float | None, joint: int) -> None:
    """Second differences of the position in the sensor's frame, and the rate of its attitude."""
    study = rig(gravity, joint)
    values = scara.STIFF.parameters() | {
        ("gravity_torque_1", None): 40.0,
        ("gravity_torque_2", None): 9.0,
    }
    T, n = 2.5e-4, 1200
    rng = np.random.default_rng(1)
    voltage = 4.0 * rng.choice([-1.0, 1.0], size=(n // 40 + 1, 2))
    still = (0.0, 0.0)
    drive = Drive(0.01, voltage, np.zeros_like(voltage), (False, False), (30.0, 60.0), still)
    signals = dict.fromkeys(name for axis in axes(study, joint) for name in axis.quantities)
    record: list[Quantity] = ["link_angle", *signals]
    run = simulate(Arm.of(study.arm), values, drive, sample_time=T, samples=n, record=record)
    position, link_attitude = path_of(run["link_angle"], study, joint)
    second = (position[2:] - 2.0 * position[1:-1] + position[:-2]) / T**2
    force = second + np.array([0.0, gravity or 0.0, 0.0])
    read = np.einsum("ni,nik->nk", force, link_attitude[1:-1])
    spin = np.einsum(
        "nji,njk->nik", link_attitude[1:-1], (link_attitude[2:] - link_attitude[:-2]) / (2.0 * T)
    )
    rate = np.column_stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]])
    for axis in axes(study, joint):
        parts = np.column_stack([run[name][:, joint - 1] for name in axis.quantities])
        simulated = (parts @ axis.weights({}))[1:-1]
        expected = (read if isinstance(axis.sensor, ImuAccelerometers) else rate)[:, axis.number]
        off = np.sqrt(np.mean((simulated - expected) ** 2) / np.mean(expected**2))
        # differences omit T^2/12 times the fourth derivative and smooth voltage steps
        assert off < 2e-3, axis


@pytest.mark.parametrize("gravity", [None, 9.81])
def test_the_kinematics_match_the_core(gravity: float | None) -> None:
    study = rig(gravity, 2)
    values = scara.STIFF.parameters() | {
        ("gravity_torque_1", None): 40.0,
        ("gravity_torque_2", None): 9.0,
    }
    sensor_axes = [axes(study, 2)[0], axes(study, 2)[-1]]
    voltage = np.full((40, 2), 5.0)
    still = (0.0, 0.0)
    drive = Drive(0.01, voltage, np.zeros_like(voltage), (False, False), (10.0, -90.0), still)
    motion: list[Quantity] = ["link_angle", "link_velocity", "link_acceleration"]
    run = simulate(
        Arm.of(study.arm),
        values,
        drive,
        sample_time=1e-3,
        samples=300,
        record=[*motion, *(name for axis in sensor_axes for name in axis.quantities)],
    )
    q, dq, ddq = (run[name] for name in motion)
    for axis in sensor_axes:
        (basis,) = link_quantities([axis], Arm.of(study.arm), JointMotion(q, dq, ddq))
        for k, name in enumerate(axis.quantities):
            np.testing.assert_allclose(basis[:, k], run[name][:, axis.joint - 1], atol=1e-9)


def test_the_reading_of_a_spatial_motion() -> None:
    rng = np.random.default_rng(11)
    for _ in range(10):
        c, r, f, dw, w = rng.normal(size=(5, 3))
        signals = [*f, *dw, *(w * w), w[0] * w[1], w[0] * w[2], w[1] * w[2]]
        expected = c @ (f + np.cross(dw, r) + np.cross(w, np.cross(w, r)))
        reading = accelerometer_weights(c.tolist(), r.tolist()) @ np.array(signals)
        assert reading == pytest.approx(expected, abs=1e-12)


def test_attitude_and_angles_are_inverse() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        rpy = rng.uniform(-1.5, 1.5, 3)
        matrix = attitude(rpy.tolist())
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(angles(matrix), rpy, atol=1e-12)
    quarter = attitude((0.0, 0.0, np.pi / 2.0))
    np.testing.assert_allclose(
        quarter[:, 0], [0.0, 1.0, 0.0], atol=1e-15
    )  # x of the sensor along y of the link


@pytest.mark.parametrize("gravity", [None, 9.81])
@pytest.mark.parametrize("joint", [1, 2])
def test_slopes_match_differences_of_the_factors(gravity: float | None, joint: int) -> None:
    rng = np.random.default_rng(5)
    for imu in (Imu(), Imu(xyz=XYZ), Imu(rpy=RPY)):
        study = rig(gravity, joint, imu)
        imu_axes = axes(study, joint)
        keys = unknowns_of(imu_axes)
        values = {key: float(rng.uniform(0.1, 0.5)) for key in keys}
        for axis in imu_axes:
            derivatives = axis.slopes(values, keys)
            for k, key in enumerate(keys):
                moved = {**values, key: values[key] + 1e-4}
                step = axis.weights(moved) - axis.weights(values)
                np.testing.assert_allclose(derivatives[:, k], step / 1e-4, atol=1e-3)


def test_distances_from_short_records_have_the_right_size() -> None:
    study, _, logs = shaken(order=10)
    joints = tuple(replace(joint, accelerometer_distance=None) for joint in study.arm.joints)
    starts = estimate_mounting_starts(
        logs, Arm.of(replace(study, arm=replace(study.arm, joints=joints)).arm)
    )
    assert starts == {
        ("accelerometer_distance", 1): pytest.approx(0.33, rel=0.4),
        ("accelerometer_distance", 2): pytest.approx(0.27, rel=0.4),
    }
    assert estimate_mounting_starts(logs, Arm.of(study.arm)) == {}


def test_unknowns_of_an_imu() -> None:
    """On a fixed axis a distance and, under gravity, a bearing; otherwise a position."""
    full = ["imu_turn_x", "imu_turn_y", "imu_turn_z"]
    expected = {
        (1, None): ["imu_distance", *full],
        (1, 9.81): ["imu_distance", "imu_bearing", *full],
        (2, None): ["imu_x", "imu_y", *full],
    }
    for (joint, gravity), names in expected.items():
        study = rig(gravity, joint, Imu())
        assert unknowns_of(axes(study, joint)) == [(name, joint) for name in names]
        one = mounted_axes(study.arm, joint, [f"ay{joint}", f"gz{joint}"])
        alone = [*names[:-3], "imu_turn_z", "imu_gz_share"]
        assert unknowns_of(one) == [(name, joint) for name in alone]
        assert not unknowns_of(axes(rig(gravity, joint), joint))
    link_attitude = rig(None, 1, Imu(rpy=RPY))
    assert unknowns_of(axes(link_attitude, 1)) == [
        ("imu_x", 1),
        ("imu_y", 1),
    ]


def test_rotation_vectors() -> None:
    rng = np.random.default_rng(7)
    for _ in range(10):
        vector = rng.normal(size=3)
        matrix = rotation(vector)
        np.testing.assert_allclose(matrix @ vector, vector, atol=1e-13)
        np.testing.assert_allclose(np.trace(matrix), 1.0 + 2.0 * np.cos(np.linalg.norm(vector)))
    np.testing.assert_allclose(rotation(np.array([0.0, 0.0, 0.3])), attitude((0.0, 0.0, 0.3)))


@pytest.mark.parametrize("gravity", [None, 9.81])
@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("count", [2, 3])
def test_the_search_recovers_a_random_mounting(
    gravity: float | None, joint: int, count: int
) -> None:
    """Ideal readings of a wide motion; two accelerometers come with gyros."""
    rng = np.random.default_rng([joint, count])
    names = [*(("ax", "ay", "az")[:count]), "gx", "gy", "gz"]
    t = np.linspace(0.0, 6.0, 600)[:, None]
    phase, w = rng.uniform(0.0, 6.0, 2), np.array([2.0, 3.1])
    q, dq, ddq = np.sin(w * t + phase), w * np.cos(w * t + phase), -(w**2) * np.sin(w * t + phase)
    rpy = rng.uniform(-3.0, 3.0, 3)
    xyz = (rng.uniform(0.05, 0.3), rng.uniform(-0.1, 0.1), 0.02)
    true = rig(gravity, joint, Imu(xyz, tuple(rpy.tolist())))
    unknown = rig(gravity, joint, Imu())
    channels = [f"{name}{joint}" for name in names]
    imu_axes, true_axes = (mounted_axes(rig.arm, joint, channels) for rig in (unknown, true))
    tables = []
    for axis in true_axes:
        (parts,) = link_quantities([axis], Arm.of(true.arm), JointMotion(q, dq, ddq))
        rows = np.column_stack([parts, parts @ axis.weights({})])
        tables.append(rows - rows.mean(axis=0))
    starts = imu_candidates(imu_axes, tables)[0]
    for axis, true_axis, table in zip(imu_axes, true_axes, tables, strict=True):
        counts, expected = axis.weights(starts), true_axis.weights({})
        is_excited = np.linalg.norm(table[:, :-1], axis=0) > 1e-9
        np.testing.assert_allclose(counts[is_excited], expected[is_excited], atol=1e-5)
