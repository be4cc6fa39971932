"""Designs for serial chains: limits of the URDF, distances, trajectories, predicted intervals."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from strainwave import excite as design
from strainwave.domain import ArmDescription, Experiment, JointLimits, Study
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.keys import Values
from strainwave.domain.results.stage_results import ASSUMED_TORQUE_ERROR
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.excite import rigid_motion
from strainwave.excite.files import PRECISION_FILE, write
from strainwave.excite.guessed_arm import (
    GuessedArm,
    run,
    smallest_distance,
    torque_errors_of,
)
from strainwave.excite.motions import motion_records
from strainwave.excite.plan import Limits, limits_of
from strainwave.excite.rigid_motion import (
    Fourier,
    MotionSearch,
    full_regressor,
    standard_deviations,
)
from strainwave.io.study import read_study
from strainwave.virtual.experiments import simulate_study

_LINKS = '<link name="base"/><link name="a"/><link name="b"/><link name="c"/>'


def _joint(name: str, parent: str, child: str, origin: str, axis: str, limit: str) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin {origin}/><axis xyz="{axis}"/><limit {limit}/></joint>'
    )


URDF = f"""<robot name="r">{_LINKS}
{_joint("waist", "base", "a", 'xyz="0 0 0.3"', "0 0 1", 'lower="-2" upper="2" effort="90" velocity="2"')}
{_joint("shoulder", "a", "b", 'xyz="0.05 0 0.1"', "0 1 0", 'lower="-1.5" upper="0.7" effort="90"')}
{_joint("elbow", "b", "c", 'xyz="0.4 0 0"', "0 1 0", 'lower="0.1" upper="2.5" velocity="3"')}
</robot>"""

STUDY = """
[arm]
kind = "serial"
gravity = [0.0, 0.0, -9.81]
urdf = "robots/arm.urdf"

[[joint]]
spring = "rigid"
gear_ratio = 0.01
torque_per_volt = 0.1
encoder_counts = 8192

[[joint]]
spring = "rigid"
gear_ratio = -0.01
torque_per_volt = 0.1
encoder_counts = 8192

[[joint]]
spring = "rigid"
gear_ratio = 0.01
torque_per_volt = 0.05
encoder_counts = 8192

[servo]
kind = "pi-velocity"
period = 0.001
kp = [0.1, 0.1, 0.05]
ki = [0.8, 0.8, 0.4]
position_gain = [5.0, 5.0, 5.0]
limit = 10.0
"""

# mass, first moments, inertias of each link, as in URDF
_BODIES = (
    (5.0, 0.1, 0.0, 0.3, 0.08, 0.0, 0.08, 0.0, 0.0, 0.05),
    (4.0, 0.8, 0.02, 0.05, 0.02, 0.0, 0.24, 0.01, 0.0, 0.23),
    (2.0, 0.3, 0.01, 0.04, 0.02, 0.0, 0.09, 0.0, 0.0, 0.08),
)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rigid_motion, "_N_RANDOM_SERIES", 12)
    monkeypatch.setattr(rigid_motion, "_MAX_ITERATIONS", 5)


@pytest.fixture
def study(tmp_path: Path) -> Study:
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots/arm.urdf").write_text(URDF)
    (tmp_path / "study.toml").write_text(STUDY)
    return read_study(tmp_path / "study.toml", logs_exist=False, experiments_exist=False)


def values_of(study: Study) -> Values:
    """Parameters of the chain."""
    known: Values = {}
    for number, body in enumerate(_BODIES, start=1):
        keys = [key for key in Arm.of(study.arm).base_names if key[1] == number]
        known |= dict(zip(keys, body, strict=True))
        known["motor_inertia", number] = 2e-4
        known["motor_viscous_friction", number] = 3e-4
        known["motor_coulomb_friction", number] = 0.03
    return known


def limits(study: Study, **texts: str | None) -> Limits:
    """Limits of the URDF and of texts."""
    given = {"angle": None, "velocity": "250", "voltage": None, "gear_torque": None} | texts
    return limits_of(study.arm, **given)


def test_the_stricter_of_both_limits_applies(study: Study) -> None:
    of_urdf = limits(study)
    np.testing.assert_allclose(of_urdf.centre, [0.0, -0.4, 1.3])
    np.testing.assert_allclose(of_urdf.angle, [2.0, 1.1, 1.2])
    # 2 and 3 rad/s of the links
    np.testing.assert_allclose(of_urdf.velocity, [200.0, 250.0, 250.0])
    np.testing.assert_allclose(of_urdf.gear_torque, [90.0, 90.0, np.inf])
    # rigid gears transmit what the motors give: 90 N m are 9 V
    np.testing.assert_allclose(of_urdf.voltage, [9.0, 9.0, 10.0])
    narrow = limits(study, angle="1.2", velocity="100", gear_torque="50", distance="0.1")
    np.testing.assert_allclose(narrow.centre, [0.0, -0.25, 0.65])
    np.testing.assert_allclose(narrow.angle, [1.2, 0.95, 0.55])
    np.testing.assert_allclose(narrow.velocity, 100.0)
    np.testing.assert_allclose(narrow.gear_torque, 50.0)
    assert narrow.distance == 0.1


@pytest.mark.usefixtures("quick")
def test_a_designed_motion_satisfies_all_limits(study: Study, tmp_path: Path) -> None:
    values, allowed = values_of(study), limits(study, distance="0.25")
    plan = design.design(study, values, allowed)
    assert [r.experiment.name for r in plan.records] == ["motion", "motion-check"]
    arm, uses = Arm.of(study.arm), []
    for record in plan.records:
        motion = run(GuessedArm(arm, values, allowed), record.drive)
        angle = motion["link_angle"]
        moved = np.abs(angle - allowed.centre).max(axis=0) / allowed.angle
        speed = np.abs(motion["motor_velocity"]).max(axis=0) / allowed.velocity
        volts = np.abs(motion["voltage"]).max(axis=0) / allowed.voltage
        uses.append(np.max([moved, speed, volts]))
        np.testing.assert_allclose(angle[0], allowed.centre, atol=1e-9)
        assert smallest_distance(arm, values, angle, 0.25).min() >= 0.25 * (1.0 - 1e-3)
    assert all(0.5 < use <= 1.0 for use in uses)
    _check_files(plan, arm, values, tmp_path / "designed")


def _check_files(plan: design.Design, arm: Arm, values: Values, folder: Path) -> None:
    write(plan, folder)
    study = read_study(folder / "study.toml", logs_exist=False)
    assert study.arm.joints == plan.study.arm.joints
    record = plan.records[0]
    # JSON is YAML, which `ros2 topic pub` reads
    message = json.loads((folder / "trajectory-motion.json").read_text())
    assert message["joint_names"] == ["waist", "shoulder", "elbow"]
    time = [
        p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"]
        for p in message["points"]
    ]
    positions, velocities, accelerations = (
        np.array([point[name] for point in message["points"]])
        for name in ("positions", "velocities", "accelerations")
    )
    assert time[0] == 0.0
    assert np.all(np.diff(time) > 0.0)
    assert time[-1] == pytest.approx(record.duration, abs=2e-3)
    for at_rest in (velocities[[0, -1]], accelerations[[0, -1]]):
        np.testing.assert_allclose(at_rest, 0.0, atol=1e-9)
    assert record.motor_angle is not None
    ticks = record.drive.tick * np.arange(len(record.motor_angle))
    intended = arm.links_of(record.motor_angle)
    for i in range(3):
        hermite = CubicHermiteSpline(time, positions[:, i], velocities[:, i])
        np.testing.assert_allclose(hermite(ticks), intended[:, i], atol=1e-4)
    predicted = json.loads((folder / PRECISION_FILE).read_text())
    columns = arm.base.columns
    assert len(predicted["base_parameters"]) == len(columns)
    for entry, column in zip(predicted["base_parameters"], columns, strict=True):
        assert entry["value"] == pytest.approx(value_of(column.parts, values), abs=1e-12)
        low, high = entry["ci95"]
        assert low < entry["value"] < high


@pytest.mark.usefixtures("quick")
def test_predicted_intervals_are_those_of_noisy_torques(study: Study) -> None:
    """Least squares of torques with white errors, assumed or measured, scatter as predicted."""
    bare = study.arm.with_joints(replace(j, encoder_counts=None) for j in study.arm.joints)
    arm, values, allowed = Arm.of(bare), values_of(study), limits(study)
    search = MotionSearch(GuessedArm(arm, values, allowed), 8.0)
    series = Fourier(8.0, *np.split(np.random.default_rng(1).normal(size=(17, 3)), [1, 9]))
    motion = series.at(search.time)
    std = standard_deviations(search, motion, 1.0, torque_errors_of(arm, {2: 0.03}))
    torque = arm.inverse_dynamics(search.vector, *motion)
    shares = np.array([ASSUMED_TORQUE_ERROR, 0.03, ASSUMED_TORQUE_ERROR])
    error = shares * np.sqrt(np.mean(torque**2, axis=0))
    # ten independent errors per second of the torque after a low-pass of 5 Hz
    rows = full_regressor(arm, motion) / (error * np.sqrt(len(motion[0]) / 80.0))[:, None]
    rows = rows.reshape(-1, rows.shape[2])
    noise = np.random.default_rng(2).normal(size=(len(rows), 2000))
    estimates = np.linalg.lstsq(rows, noise)[0]
    np.testing.assert_allclose(estimates.std(axis=1), std, rtol=0.1)


def without_servo(study: Study) -> Study:
    """The arm as a robot with joint states: torques at the joints, a controller of its own."""
    joints = (
        replace(j, gear_ratio=1.0, torque_per_volt=None, encoder_counts=None)
        for j in study.arm.joints
    )
    return replace(study, arm=replace(study.arm.with_joints(joints), servo=None))


@pytest.mark.usefixtures("quick")
def test_an_arm_without_servo_gets_a_trajectory_of_angles(study: Study, tmp_path: Path) -> None:
    study, values = without_servo(study), values_of(study)
    values |= {("motor_inertia", i): 2.0 for i in (1, 2, 3)}
    allowed = limits(study, velocity="2.5", gear_torque="80")
    plan = design.design(study, values, allowed, torque_errors={1: 0.05})
    assert [r.experiment.name for r in plan.records] == ["motion", "motion-check"]
    assert not plan.warnings
    record, arm = plan.records[0], Arm.of(study.arm)
    angle = record.motor_angle
    assert angle is not None
    tick = record.drive.tick
    velocity = np.gradient(angle, tick, axis=0)
    acceleration = np.gradient(velocity, tick, axis=0)
    torque = arm.inverse_dynamics(arm.parameter_vector(values), angle, velocity, acceleration)
    predicted = record.predicted
    np.testing.assert_allclose(predicted.gear_torque, np.abs(torque).max(axis=0), rtol=1e-2)
    np.testing.assert_allclose(predicted.velocity, np.abs(velocity).max(axis=0), rtol=1e-4)
    assert 0.5 < predicted.use_of(allowed) <= 1.0
    write(plan, tmp_path / "designed")
    header = (tmp_path / "designed/apply-motion.csv").read_text().partition("\n")[0]
    assert header == "t [s],theta_m1 [rad],theta_m2 [rad],theta_m3 [rad]"
    assert (tmp_path / "designed/trajectory-motion.json").exists()
    errors = json.loads((tmp_path / "designed" / PRECISION_FILE).read_text())["torque_errors"]
    assert [(e["value"], e["source"]) for e in errors] == [
        (0.05, "measured"),
        (0.01, "assumed"),
        (0.01, "assumed"),
    ]
    again = read_study(tmp_path / "designed/study.toml", logs_exist=False)
    with pytest.raises(InvalidInput, match=r"follows angles by a controller.*add the \[servo\]"):
        simulate_study(again, values, tmp_path / "run")


def test_a_trajectory_needs_limits_of_the_torques(study: Study) -> None:
    with pytest.raises(InvalidInput, match=r"--limit-torque: the torque of joint 3 has no limit"):
        limits(without_servo(study))


def far_apart(study: Study) -> None:
    allowed = replace(limits(study), posture=(0.0, -0.4, 2.5), distance=0.35)
    motion_records(
        GuessedArm(Arm.of(study.arm), values_of(study), allowed),
        anti_resonance_hz=None,
        starts=1,
        seed=0,
        torque_errors=np.zeros(3),
    )


def without_limits(study: Study) -> ArmDescription:
    return replace(study.arm, joints=tuple(replace(j, limits=None) for j in study.arm.joints))


def endless(study: Study) -> None:
    limits_of(study.arm, "1", None, None, None)


def with_turns(study: Study) -> ArmDescription:
    """The arm whose second joint may turn by more than half a turn."""
    limits = replace(study.arm.joints[1].limits or JointLimits(), lower=-3.2, upper=3.2)
    return study.arm.with_joint(2, limits=limits)


@pytest.mark.parametrize(
    ("ask", "expected"),
    [
        (far_apart, r"--limit-distance: two links are .* apart in the posture"),
        (endless, r"--limit-velocity: the velocity of joint 2 has no limit.*URDF"),
        (
            lambda study: limits_of(without_limits(study), None, "9", None, None),
            r"--limit-angle: the study and its URDF limit the angle of joint 1, 2, 3 to more",
        ),
        (
            lambda study: limits_of(with_turns(study), None, "9", None, None),
            r"the angle of joint 2 to .*--limit-angle [0-9.]+,1.5,[0-9.]+, or lower and upper",
        ),
        (lambda study: limits(study, angle="0.05"), r"the angle of joint 3 excludes all"),
        (lambda study: limits(study, distance="-1"), "--limit-distance"),
    ],
)
def test_impossible_limits_are_rejected(
    study: Study, ask: Callable[[Study], object], expected: str
) -> None:
    with pytest.raises(InvalidInput, match=expected):
        ask(study)


def test_a_virtual_copy_of_a_study_has_its_urdf(study: Study, tmp_path: Path) -> None:
    record = Experiment("motion", "motion.csv", "motion", ("servo",) * 3)
    simulate_study(replace(study, experiments=(record,)), values_of(study), tmp_path / "run")
    again = read_study(tmp_path / "run/study.toml")
    assert again.arm.joints == study.arm.joints
    assert again.arm.urdf is not None
    assert again.arm.urdf.file == "arm.urdf"
