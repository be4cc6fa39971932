"""The exported arm moves in MuJoCo as in the simulation."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import exports
from mujoco_runs import RECORDED, TICK, drive, frictionless, in_mujoco, largest_difference
from strainwave.domain import Imu, Motion, Parameter, Spring
from strainwave.domain.arm.description import Matrix
from strainwave.domain.arm.link_sensors import mounted_axes
from strainwave.domain.arm.link_sensors.imu import IMU_ATTITUDE, IMU_POSITION
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import JointMotion, link_quantities
from strainwave.dynamics.simulation import simulate
from strainwave.errors import InvalidInput
from strainwave.export.mjcf import to_mjcf
from strainwave.export.source import IdentifiedArm


@pytest.fixture(scope="module")
def mujoco() -> ModuleType:
    found: ModuleType = pytest.importorskip(
        "mujoco", reason="MuJoCo is not installed (extra: bench)"
    )
    return found


@pytest.mark.parametrize("gravity", [None, 9.81])
@pytest.mark.parametrize("spring", ["linear", "rigid"])
def test_sensors_equal_the_channels(
    mujoco: ModuleType, spring: Spring, gravity: float | None, tmp_path: Path
) -> None:
    study = exports.two_links(tmp_path, spring, gravity)
    # sensors without lag and rounding; motor channels of a rigid gear are those of the link
    joints = tuple(
        replace(joint, accelerometer_hz=None, gyro_hz=1e6, encoder_counts=None)
        for joint in study.arm.joints
    )
    study = replace(study, arm=replace(study.arm, joints=joints))
    values = frictionless(exports.values_of(study))
    if gravity:  # the same gravity for torques and sensors
        values["gravity_torque_2", None] /= 1.02
    applied = drive(study, 10.0)
    channels: dict[str, tuple[Quantity, int]] = {
        "theta_l": ("link_angle", 0),
        "a": ("accelerometer", 1),
        "gyro": ("gyro", 2),
        "torque": ("motor_torque", 0),
    }
    if spring == "linear":
        channels |= {"theta_m": ("motor_angle", 0), "omega_m": ("motor_velocity", 0)}
    ours = simulate(
        Arm.of(study.arm),
        values,
        applied,
        sample_time=TICK,
        samples=len(applied.voltage),
        record=[quantity for quantity, _ in channels.values()],
    )
    model = mujoco.MjModel.from_xml_string(to_mjcf(exports.arm_of(study, values)).data.decode())
    data = mujoco.MjData(model)
    theirs: dict[str, list[float]] = {f"{name}{i}": [] for name in channels for i in (1, 2)}
    for voltage in applied.voltage:
        data.ctrl[:] = voltage
        mujoco.mj_forward(model, data)
        for name, (_, component) in channels.items():
            for i in (1, 2):
                theirs[f"{name}{i}"].append(data.sensor(f"{name}{i}").data[component])
        mujoco.mj_step(model, data, round(TICK / model.opt.timestep))
    for name, (quantity, _) in channels.items():
        for i in (1, 2):
            wanted = ours[quantity][:, i - 1]
            off = np.linalg.norm(np.array(theirs[f"{name}{i}"]) - wanted)
            # the simulated gyro has a low-pass of 1 MHz: a lag of 0.2 us
            assert off < (1e-4 if name == "gyro" else 2e-7) * np.linalg.norm(wanted), f"{name}{i}"


@pytest.mark.parametrize("gravity", [None, 9.81])
@pytest.mark.parametrize("spring", ["linear", "rigid"])
def test_without_coulomb_friction_the_motion_equals_the_simulation(
    mujoco: ModuleType, spring: Spring, gravity: float | None, tmp_path: Path
) -> None:
    """The same equations by Runge-Kutta of order four, at 0.1 ms and 0.125 ms: a few 1e-8."""
    study = exports.two_links(tmp_path, spring, gravity)
    values = frictionless(exports.values_of(study))
    for joint in (1, 2):
        values["friction_offset", joint] = 0.01
    assert largest_difference(mujoco, study, values, 10.0) < 1e-7


@pytest.mark.parametrize("motion", ["revolute", "prismatic"])
@pytest.mark.parametrize("spring", ["linear", "rigid"])
def test_a_single_joint_moves_as_in_the_simulation(
    mujoco: ModuleType, spring: Spring, motion: Motion, tmp_path: Path
) -> None:
    gravity = 9.81 if motion == "revolute" else None
    study, values = exports.single(tmp_path, motion, spring, gravity)
    assert largest_difference(mujoco, study, values, 3.0) < 1e-9


def test_three_slopes_are_three_parallel_tendons(mujoco: ModuleType, tmp_path: Path) -> None:
    """The amplitude passes both knees, which the simulation rounds over 5e-6 rad."""
    study = exports.two_links(tmp_path, "three-slope")
    values = frictionless(exports.values_of(study))
    applied = drive(study, 10.0)
    ours = simulate(
        Arm.of(study.arm), values, applied, sample_time=TICK, samples=400, record=["gear_torque"]
    )
    for joint in (1, 2):
        assert np.abs(ours["gear_torque"][:, joint - 1]).max() > values["gear_knee_t2", joint]
    assert largest_difference(mujoco, study, values, 10.0) < 2e-5
    middle = replace(
        study,
        arm=replace(study.arm, joints=tuple(replace(j, spring="linear") for j in study.arm.joints)),
    )
    linear = values | {("gear_stiffness", j): values["gear_stiffness_k2", j] for j in (1, 2)}
    (tmp_path / "linear").mkdir()
    middle = replace(middle, path=tmp_path / "linear" / "study.toml")
    wrong = simulate(
        Arm.of(middle.arm), linear, applied, sample_time=TICK, samples=400, record=RECORDED
    )
    theirs = in_mujoco(mujoco, study, values, applied)["motor_velocity"]
    assert np.linalg.norm(theirs - wrong["motor_velocity"]) > 0.01 * np.linalg.norm(theirs)


@pytest.mark.parametrize(("amplitude", "tolerance"), [(10.0, 0.005), (2.0, 0.05)])
@pytest.mark.parametrize("spring", ["linear", "rigid"])
def test_coulomb_friction_approximates_the_simulation(
    mujoco: ModuleType, spring: Spring, amplitude: float, tolerance: float, tmp_path: Path
) -> None:
    """MuJoCo needs two steps to stop a motor, the simulation none."""
    study = exports.two_links(tmp_path, spring)
    assert largest_difference(mujoco, study, exports.values_of(study), amplitude) < tolerance


def test_friction_with_a_settling_time_equals_the_simulation(
    mujoco: ModuleType, tmp_path: Path
) -> None:
    """Same law; MuJoCo resolves its corners to a time step, a tenth of the settling time."""
    study = exports.two_links(tmp_path)
    values = exports.values_of(study)
    for joint in (1, 2):
        values["friction_settling_time", joint] = 1e-3
    assert largest_difference(mujoco, study, values, 2.0) < 2e-3


@pytest.mark.parametrize(("bandwidth", "tolerance"), [(50.0, 1e-4), (1000.0, 1e-3), (5000.0, 4e-3)])
def test_the_current_loop_delays_the_torque(
    mujoco: ModuleType, bandwidth: float, tolerance: float, tmp_path: Path
) -> None:
    """MuJoCo holds the torque over its step of 0.1 ms; faster loops have no lag there."""
    study = exports.two_links(tmp_path)
    lagging = tuple(replace(joint, current_loop_hz=bandwidth) for joint in study.arm.joints)
    values = frictionless(exports.values_of(study))
    assert (
        largest_difference(
            mujoco, replace(study, arm=replace(study.arm, joints=lagging)), values, 10.0
        )
        < tolerance
    )


def test_a_current_loop_faster_than_the_step_is_reported(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    fast = replace(study.arm.joints[0], current_loop_hz=5000.0)
    study = replace(study, arm=replace(study.arm, joints=(fast, study.arm.joints[1])))
    warnings = to_mjcf(exports.arm_of(study, exports.values_of(study))).warnings
    assert [(c.code, c.where) for c in warnings] == [("left-out", "joint 1")]
    assert "5000 Hz" in warnings[0].message


def test_effects_are_noted(tmp_path: Path) -> None:
    """On the terminal, and in comments of the file."""
    study = exports.two_links(tmp_path)
    first = replace(study.arm.joints[0], effects=("hysteresis", "kinematic-error"))
    study = replace(study, arm=replace(study.arm, joints=(first, study.arm.joints[1])))
    export = to_mjcf(exports.arm_of(study, exports.values_of(study)))
    assert export.notes[0].startswith("lost: kinematic-error (joint 1), servo, ")
    for note in export.notes:
        assert f"<!-- {note[:1].upper()}{note[1:]}. -->" in export.data.decode()
    assert not any("motor_inertia" in note or "gear" in note for note in export.notes)


def test_an_inconsistent_gravity_torque_is_reported(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path, gravity=9.81)
    warnings = to_mjcf(exports.arm_of(study, exports.values_of(study))).warnings
    assert [c.code for c in warnings] == ["gravity-torque"]
    assert "+2.0 %" in warnings[0].message


@pytest.mark.parametrize("motions", exports.MOTIONS)
def test_links_of_a_chain_have_its_inertia_and_gravity(
    mujoco: ModuleType, motions: exports.Motions, tmp_path: Path
) -> None:
    study, values = exports.chain(tmp_path, motions=motions)
    model = mujoco.MjModel.from_xml_string(to_mjcf(exports.arm_of(study, values)).data.decode())
    data, arm = mujoco.MjData(model), Arm.of(study.arm)
    base = np.array([values[key] for key in arm.base_names])
    rest, M = np.zeros((1, 3)), np.zeros((6, 6))
    for angle in np.random.default_rng(3).uniform(-2.0, 2.0, (10, 3)):
        data.qpos[:3] = angle
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        np.testing.assert_allclose(M[:3, :3], arm.inertia_matrix(base, angle), atol=1e-12)
        np.testing.assert_allclose(M[3:, 3:], 2e-4 * np.eye(3), atol=1e-18)
        torque = arm.link_torques(base, angle[None], rest, rest)[0]
        np.testing.assert_allclose(data.qfrc_bias, [*torque, 0.0, 0.0, 0.0], atol=1e-11)


@pytest.mark.parametrize("motions", exports.MOTIONS)
@pytest.mark.parametrize(
    ("springs", "coupling"),
    [
        (("linear",) * 3, None),
        (("linear",) * 3, exports.COUPLING),
        (("rigid",) * 3, None),
        (("rigid",) * 3, exports.COUPLING),
        (("linear", "rigid", "rigid"), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -0.6, 1.0))),
    ],
)
def test_a_chain_moves_as_in_the_simulation(
    mujoco: ModuleType,
    springs: exports.Springs,
    motions: exports.Motions,
    coupling: Matrix | None,
    tmp_path: Path,
) -> None:
    """The motors of rigid joints turn with several joints where a transmission couples them."""
    study, values = exports.chain(tmp_path, springs, motions, coupling)
    assert largest_difference(mujoco, study, values, 3.0) < 1e-6


def with_place(arm: IdentifiedArm, place: Iterable[tuple[str, float]]) -> IdentifiedArm:
    """The arm with identified coordinates or angles of the IMU on link 3."""
    found = (Parameter(name, 3, value, None, "", "tuned") for name, value in place)
    return replace(arm, parameters=(*arm.parameters, *found))


_IMU = Imu((0.2, 0.05, -0.03), (0.4, -0.3, 1.1))


@pytest.mark.parametrize("is_estimated", [False, True])
@pytest.mark.parametrize("motions", exports.MOTIONS)
def test_imus_read_as_the_kinematics_of_the_chain(
    mujoco: ModuleType, motions: exports.Motions, is_estimated: bool, tmp_path: Path
) -> None:
    study, values = exports.chain(tmp_path, ("rigid",) * 3, motions)
    known = study.arm.with_joint(3, imu=_IMU)
    study = replace(study, arm=study.arm.with_joint(3, imu=Imu()) if is_estimated else known)
    arm = exports.arm_of(study, values)
    if is_estimated:
        arm = with_place(arm, zip(IMU_POSITION, _IMU.xyz or (), strict=True))
        arm = with_place(arm, zip(IMU_ATTITUDE, _IMU.rpy or (), strict=True))
    model = mujoco.MjModel.from_xml_string(to_mjcf(arm).data.decode())
    data, random = mujoco.MjData(model), np.random.default_rng(4)
    data.qpos[:], data.qvel[:] = random.normal(size=(2, 3))
    data.ctrl[:] = random.normal(size=3)
    mujoco.mj_forward(model, data)
    motion = JointMotion(*(np.array([x]) for x in (data.qpos, data.qvel, data.qacc)))
    for axis in mounted_axes(known, 3, ("ax3", "ay3", "az3", "gx3", "gy3", "gz3")):
        (parts,) = link_quantities([axis], Arm.of(known), motion)
        expected = parts[0] @ axis.sensor.weights(axis, {})
        reading = data.sensor(f"imu_{axis.channel[0]}3").data[axis.number]
        assert reading == pytest.approx(expected, rel=1e-6, abs=1e-6), axis.channel


def test_an_imu_at_an_unknown_place_is_omitted(mujoco: ModuleType, tmp_path: Path) -> None:
    study, values = exports.chain(tmp_path)
    study = replace(study, arm=study.arm.with_joint(3, imu=Imu(rpy=(0.1, 0.0, 0.0))))
    export = to_mjcf(
        with_place(exports.arm_of(study, values), [("imu_x", 0.1), ("imu_y", 0.0)])  # z is unknown
    )
    model = mujoco.MjModel.from_xml_string(export.data.decode())
    assert not any(model.sensor(k).name.startswith("imu") for k in range(model.nsensor))
    assert any("IMU at an unknown place (joint 3)" in note for note in export.notes)


def test_motors_without_estimate_have_the_inertia_of_the_standard_parameters(
    mujoco: ModuleType, tmp_path: Path
) -> None:
    """Behind rigid gears only: an elastic joint needs an estimate."""
    study, values = exports.chain(tmp_path, ("rigid",) * 3)
    arm = exports.arm_of(study, values)
    others = tuple(p for p in arm.parameters if p.key != ("motor_inertia", 1))
    arm = replace(arm, parameters=others, standard=arm.standard | {("motor_inertia", 1): 3e-4})
    model = mujoco.MjModel.from_xml_string(to_mjcf(arm).data.decode())
    np.testing.assert_allclose(model.dof_armature, [3.0, 2e-4 / 0.0125**2, 2e-4 / 0.02**2])
    elastic = exports.arm_of(*exports.chain(tmp_path))
    others = tuple(p for p in elastic.parameters if p.key != ("motor_inertia", 1))
    with pytest.raises(InvalidInput, match="motor_inertia of joint 1 is missing"):
        to_mjcf(replace(elastic, parameters=others))


def test_joints_have_the_names_of_the_study(mujoco: ModuleType, tmp_path: Path) -> None:
    study, values = exports.chain(tmp_path)
    study = replace(study, arm=study.arm.with_joint(2, name="elbow"))
    model = mujoco.MjModel.from_xml_string(to_mjcf(exports.arm_of(study, values)).data.decode())
    assert [model.joint(i).name for i in range(3)] == ["joint1", "elbow", "joint3"]
