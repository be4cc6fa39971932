"""Unknown mounting of an IMU on a chain whose links turn about several axes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from strainwave.domain import (
    ArmDescription,
    Experiment,
    FloatArray,
    Imu,
    Joint,
    Log,
    Origin,
    WholeArmOptions,
)
from strainwave.domain.arm.link_sensors import mounted_axes, unknowns_of
from strainwave.domain.arm.link_sensors.imu import IMU_START_ATTITUDE, attitude_of
from strainwave.domain.arm.link_sensors.link_space import attitude, axes_about
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import JointMotion, link_quantities
from strainwave.dynamics.simulation import Drive, simulate
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.parameter_space import (
    ParameterSpace,
    Prior,
    Unknown,
)
from strainwave.identification.whole_arm.records.preparation import dataset_of
from strainwave.identification.whole_arm.search import Fit
from strainwave.identification.whole_arm.selection.mountings import select_mountings
from strainwave.identification.whole_arm.selection.sensor_constants import add_sensor_constants
from strainwave.numerics.filters import low_pass
from strainwave.signals.link_readings import combine_axes
from strainwave.signals.mounting_start import (
    estimate_mounting_starts,
    imu_candidates,
    mirror_mounting,
)

XYZ, RPY = (0.05, -0.03, -0.22), (0.7, -0.4, 2.1)
LINK = 3
NAMES = ("ax", "ay", "az", "gx", "gy", "gz")
SAMPLE_TIME, SAMPLES = 1e-3, 12_000


def hanging_chain(imu: Imu) -> ArmDescription:
    """Three links below each other with axes z, y and x, and an IMU on the last one."""
    joint = Joint("linear", 0.01, torque_per_volt=0.05)
    below = Origin((0.0, 0.0, -0.3))
    joints = (
        replace(joint, axis=(0.0, 0.0, 1.0)),
        replace(joint, axis=(0.0, 1.0, 0.0), origin=below),
        replace(joint, axis=(1.0, 0.0, 0.0), origin=below, imu=imu),
    )
    return ArmDescription("serial", joints, gravity=(0.0, 0.0, -9.81))


def values_of() -> Values:
    """Three equal rods with the same drives and gears."""
    rod: Values = {}
    for i in (1, 2, 3):
        link = {"mass": 3.0, "first_moment_z": -0.45, "inertia_xx": 0.1, "inertia_yy": 0.1}
        rod |= {(f"link_{name}", i): value for name, value in (link | {"inertia_zz": 0.02}).items()}
        rod |= {
            (f"link_{name}", i): 0.0
            for name in (
                "first_moment_x",
                "first_moment_y",
                "inertia_xy",
                "inertia_xz",
                "inertia_yz",
            )
        }
        drive = {"motor_inertia": 5e-5, "motor_viscous_friction": 4e-4, "gear_damping": 5.0}
        drive |= {"motor_coulomb_friction": 0.01, "link_viscous_friction": 0.5}
        drive |= {"gear_stiffness": 8e3, "friction_offset": 0.0}
        rod |= {(name, i): value for name, value in drive.items()}
    return rod


@cache
def record(channels: tuple[str, ...] = NAMES) -> Log:
    """Record of slow swings of all joints with fast steps on top, with noisy biased sensors."""
    arm, rng = Arm.of(hanging_chain(Imu(XYZ, RPY))), np.random.default_rng(4)
    tick, n = 5e-3, int(SAMPLES * SAMPLE_TIME / 5e-3) + 1
    t = tick * np.arange(n)[:, None]
    swings = 3.0 * np.sin(2.0 * np.pi * np.array([0.23, 0.31, 0.41]) * t)
    steps = np.repeat(rng.choice([-2.0, 2.0], (n // 8 + 1, 3)), 8, axis=0)[:n]
    still = (0.0, 0.0, 0.0)
    drive = Drive(tick, swings + steps, np.zeros((n, 3)), (False,) * 3, still, still)
    axes = mounted_axes(arm, LINK, [f"{name}{LINK}" for name in channels])
    quantities = dict.fromkeys(name for axis in axes for name in axis.quantities)
    run = simulate(
        arm,
        values_of(),
        drive,
        sample_time=SAMPLE_TIME,
        samples=SAMPLES,
        record=["voltage", "motor_angle", *quantities],
    )
    readings: dict[str, FloatArray] = {}
    for i in range(3):
        readings |= {f"u{i + 1}": run["voltage"][:, i]}
        noise = 1e-4 * rng.normal(size=SAMPLES)
        readings |= {f"theta_m{i + 1}": run["motor_angle"][:, i] + noise}
    for axis in axes:
        std, bias = (0.02, 0.2) if axis.channel[0] == "a" else (2e-3, 0.01)
        reading = axis.reading(run.quantities, {}) + bias
        readings[axis.channel] = reading + std * rng.normal(size=SAMPLES)
    experiment = Experiment("swings", "", "tuning", ("open",) * 3)
    return Log(experiment, run.time, SAMPLE_TIME, readings)


def errors(values: Values) -> tuple[float, float]:
    """Errors of position [m] and attitude [rad]."""
    position = np.array([values[name, LINK] for name in ("imu_x", "imu_y", "imu_z")])
    turn = attitude(RPY).T @ attitude_of(values, LINK)
    angle = np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))
    return float(np.linalg.norm(position - XYZ)), float(angle)


def test_all_coordinates_are_unknown() -> None:
    arm = hanging_chain(Imu())
    turns = ["imu_turn_x", "imu_turn_y", "imu_turn_z"]
    axes = mounted_axes(arm, LINK, [f"{name}{LINK}" for name in NAMES])
    assert [name for name, _ in unknowns_of(axes)] == ["imu_x", "imu_y", "imu_z", *turns]
    gyros = axes[3:]
    assert [name for name, _ in unknowns_of(gyros)] == turns
    assert [name for name, _ in unknowns_of(gyros[:1])] == turns[1:]
    # the first link turns about the vertical, along which gravity is constant
    first = replace(arm, joints=(arm.joints[LINK - 1], *arm.joints[1:]))
    vertical = first.with_joint(1, axis=(0.0, 0.0, 1.0))
    logged = [f"{name}1" for name in NAMES]
    assert [n for n, _ in unknowns_of(mounted_axes(vertical, 1, logged))] == [
        "imu_distance",
        *turns,
    ]
    assert [n for n, _ in unknowns_of(mounted_axes(first, 1, logged))] == [
        "imu_distance",
        "imu_bearing",
        *turns,
    ]


@pytest.mark.parametrize("channels", [NAMES, NAMES[:3], NAMES[:2]])
def test_the_linear_start_finds_the_mounting(channels: tuple[str, ...]) -> None:
    arm = Arm.of(hanging_chain(Imu()))
    position, angle = errors(estimate_mounting_starts([record(channels)], arm))
    assert position < 0.02
    assert angle < np.radians(2.0)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.3, -0.8, 0.5)])
def test_a_mounting_about_one_axis_of_any_direction(axis: tuple[float, float, float]) -> None:
    """All identifiable factors of ideal readings; the mirror image has those of f_y and alpha."""
    arm = Arm.of(hanging_chain(Imu()).with_joint(1, axis=axis, imu=Imu()))
    t = np.linspace(0.0, 6.0, 600)[:, None]
    motion = JointMotion(
        *(f * np.ones((1, 3)) for f in (np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)))
    )
    unknown = mounted_axes(arm, 1, [f"{name}1" for name in NAMES])
    true = mounted_axes(arm.with_joint(1, imu=Imu(XYZ, RPY)), 1, [axis.channel for axis in unknown])
    tables = []
    for each in true:
        (parts,) = link_quantities([each], arm, motion)
        rows = np.column_stack([parts, parts @ each.weights({})])
        tables.append(rows - rows.mean(axis=0))
    starts = imu_candidates(unknown, tables)[0]
    mirrored = mirror_mounting(starts, unknown[0])
    across = axes_about(axis)[1]
    for each, rows in zip(unknown, tables, strict=True):
        readings = rows[:, :-1] @ each.weights(starts)
        np.testing.assert_allclose(readings, rows[:, -1], atol=1e-5)
        if each.channel[0] == "a":
            forces, other = (each.weights(values)[:3] for values in (starts, mirrored))
            assert across @ forces == pytest.approx(across @ other)


def test_short_searches_refine_the_mounting() -> None:
    """Within 5 mm and 1 degree, although the stiffness is 10 % off."""
    arm, values = Arm.of(hanging_chain(Imu())), values_of()
    starts = estimate_mounting_starts([record()], arm)
    stiffness: list[Key] = [("gear_stiffness", i) for i in (1, 2, 3)]
    unknowns = tuple(
        Unknown(*key, "N m/rad", 0.9 * values[key], 0.9 * values[key], False, 1.0)
        for key in stiffness
    )
    fixed = {key: value for key, value in values.items() if key not in stiffness}
    space = ParameterSpace(unknowns, fixed, Prior.empty(len(unknowns)))
    keys = [key for key in starts if key[0] not in IMU_START_ATTITUDE]
    space = add_sensor_constants(space, keys, starts)
    objective = Objective.of(space, (dataset_of(record(), arm, 40.0),))
    start = Fit.at(objective, np.zeros(len(space.unknowns)))
    position, angle = errors(select_mountings(start, arm, WholeArmOptions()).values)
    assert position < 5e-3
    assert angle < np.radians(1.0)


def test_earlier_steps_read_the_imu_as_an_accelerometer() -> None:
    """The weighted axes of the IMU read as the tangential accelerometer of the joint does."""
    arm, log = Arm.of(hanging_chain(Imu())), record()
    reading = combine_axes([log], arm, [log])[LINK]
    assert reading is not None
    assert reading.gain == pytest.approx(XYZ[1], abs=5e-3)  # distance across the axis, along y
    motors = np.column_stack([log.channels[f"theta_m{i}"] for i in (1, 2, 3)])
    slow = low_pass(motors, 3.0, SAMPLE_TIME)
    motion = JointMotion.of_motors(slow, arm, SAMPLE_TIME)
    expected = reading.predict(arm, motion)[1000:-1000]
    samples = low_pass(reading.samples(log, arm), 3.0, SAMPLE_TIME)[1000:-1000]
    assert np.std(samples - expected) < 0.1 * np.std(expected)
