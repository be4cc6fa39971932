"""Accelerometers and IMUs of unknown position in the whole-arm fit, on virtual arms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from strainwave.domain import ArmModel, Imu, Joint, Log, Parameter, Study
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.domain.arm.link_sensors.link_space import angles, attitude
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm import fit_whole_arm
from tuning_runs import joint_models, rigid_model, shaken, shaken_study, simulated_logs, truth

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))
PLACES = {("accelerometer_distance", 1): 0.33, ("accelerometer_distance", 2): 0.27}
BANDWIDTHS = {("accelerometer_bandwidth", 1): 300.0, ("accelerometer_bandwidth", 2): 300.0}
GEARS = ("gear_stiffness", "gear_damping", "motor_inertia", "link_inertia")


def late(log: Log, delay: float) -> Log:
    """Log with delayed accelerometers."""
    n = round(delay / log.sample_time)
    if not n:
        return log
    channels = {
        name: np.concatenate([np.full(n, x[0]), x[:-n]]) if name.startswith("a") else x
        for name, x in log.channels.items()
    }
    return replace(log, channels=channels)


def remove_sensor_keys(study: Study, *names: str) -> Study:
    """Study without the given keys of its joints."""
    removed = dict.fromkeys(names)
    joints = tuple(replace(joint, **removed) for joint in study.arm.joints)  # type: ignore[arg-type]
    return replace(study, arm=replace(study.arm, joints=joints))


def from_five_percent(study: Study, known: Values, logs: list[Log]) -> ArmModel:
    """Fit from joint models with errors of 5 %."""
    joints = joint_models(study, known, 0.05, FACTORS)
    return fit_whole_arm(logs, rigid_model(study, known, 0.01, 1.0), joints, Arm.of(study.arm))


@cache
def found(left_out: tuple[str, ...] = (), delay: float = 0.0) -> tuple[ArmModel, Values]:
    """Fit to open-loop records of 0.5 s, one for each joint, without gyros."""
    study, true_values, logs = shaken()
    records = [
        replace(log, channels={k: x for k, x in log.channels.items() if not k.startswith("gyro")})
        for log in logs
    ]
    reduced = remove_sensor_keys(study, *left_out)
    return from_five_percent(
        reduced, true_values, [late(log, delay) for log in records]
    ), true_values


def by_key(model: ArmModel) -> dict[tuple[str, int | None], Parameter]:
    return {(p.name, p.joint): p for p in model.parameters}


def check(model: ArmModel, expected: Mapping[tuple[str, int], float]) -> None:
    """Check that each estimate agrees with the true value within four standard deviations."""
    table = by_key(model)
    for key, true in expected.items():
        value, std = table[key].value, table[key].std
        assert value is not None, key
        assert std is not None, key
        assert abs(value - true) < 4.0 * std, (key, value, std, true)


def check_gears(model: ArmModel, known: Values, times: float) -> None:
    """Check gears against a fit with known sensor positions.

    Standard deviations may be larger by the factor `times`.
    """
    reference = by_key(found()[0])
    for (name, joint), parameter in by_key(model).items():
        if name in GEARS:
            assert parameter.value is not None
            assert parameter.std is not None
            reference_std = reference[name, joint].std or 0.0
            assert parameter.std < times * reference_std, (name, joint)
            assert abs(parameter.value - known[name, joint]) < 4.5 * parameter.std, (name, joint)


@pytest.mark.parametrize("delay", [0.0, 1e-3])
def test_accelerometers_anywhere_on_their_links(delay: float) -> None:
    model, true_values = found(("accelerometer_distance",), delay)
    assert model.status == "converged"
    delays = {("accelerometer_delay", i): delay for i in (1, 2)} if delay else {}
    check(model, PLACES | delays)
    check_gears(model, true_values, 3.0)
    names = {p.name for p in model.parameters}
    assert ("accelerometer_delay" in names) is bool(delay)
    assert not names & {"accelerometer_tilt", "accelerometer_bandwidth", "accelerometer_scale"}


@pytest.mark.parametrize("delay", [0.0, 1e-3])
def test_neither_distance_nor_bandwidth_is_known(delay: float) -> None:
    model, true_values = found(("accelerometer_distance", "accelerometer_hz"), delay)
    assert model.status == "converged"
    delays = {("accelerometer_delay", i): delay for i in (1, 2)} if delay else {}
    check(model, PLACES | BANDWIDTHS | delays)
    check_gears(model, true_values, 4.0)
    for i in (1, 2):
        assert by_key(model)["accelerometer_bandwidth", i].unit == "Hz"


def test_a_tilted_accelerometer_on_a_link_whose_axis_moves() -> None:
    """A tilt of 0.1 rad, simulated by the y axis of a rotated IMU."""
    study, true_values = truth()
    rotated_imu = Imu((0.27, 0.0, 0.0), (0.0, 0.0, 0.1), accelerometer_hz=300.0)
    first, second = study.arm.joints
    imu_study = replace(
        study, arm=replace(study.arm, joints=(first, replace(second, imu=rotated_imu)))
    )
    written, logs = simulated_logs(shaken_study(imu_study, 10.0), true_values, noise=SensorNoise())
    channels = ("u1", "u2", "theta_m1", "theta_m2", "a1")
    records = [
        replace(log, channels={k: log.channels[k] for k in channels} | {"a2": log.channels["ay2"]})
        for log in logs
    ]
    first, second = remove_sensor_keys(written, "imu").arm.joints
    unknown_position = replace(second, accelerometer_distance=None)
    model = from_five_percent(
        replace(written, arm=replace(written.arm, joints=(first, unknown_position))),
        true_values,
        records,
    )
    check(model, {("accelerometer_distance", 2): 0.27, ("accelerometer_tilt", 2): 0.1})
    assert by_key(model)["accelerometer_tilt", 2].unit == "rad"
    check_gears(model, true_values, 4.0)


MOTORS = ("u1", "u2", "theta_m1", "theta_m2")
PLACE = (0.21, -0.06, 0.02)
ATTITUDE = (0.9, -0.5, 2.2)


def glued(
    joint: int,
    axes: tuple[str, ...],
    rpy: tuple[float, float, float] = ATTITUDE,
    *,
    delay: float = 0.0,
    gravity: float | None = None,
) -> tuple[ArmModel, Values]:
    """Fit to open-loop records of 0.5 s, or 1 s under gravity, with an IMU of unknown position on one link."""
    study, true_values = truth()
    if gravity is not None:
        study = replace(study, arm=change_arm_keys(study.arm, gravity=gravity))
        true_values |= {("gravity_torque_1", None): 60.0, ("gravity_torque_2", None): 15.0}
    base_study = remove_sensor_keys(study, "accelerometer_distance", "gyro_hz")

    def carrying(imu: Imu) -> Study:
        joints = (
            replace(plain_joint, imu=imu if i == joint else None)
            for i, plain_joint in _numbered(base_study)
        )
        return replace(base_study, arm=replace(base_study.arm, joints=tuple(joints)))

    true = carrying(Imu(PLACE, rpy, accelerometer_hz=300.0, gyro_hz=100.0))
    short_study = shaken_study(true, 10.0, order=9 if gravity is None else 10)
    written, logs = simulated_logs(short_study, true_values, noise=SensorNoise())
    kept_channels = (*MOTORS, *(f"{axis}{joint}" for axis in axes))
    records = [
        late(replace(log, channels={name: log.channels[name] for name in kept_channels}), delay)
        for log in logs
    ]
    unknown_position = carrying(Imu(accelerometer_hz=300.0, gyro_hz=100.0))
    return from_five_percent(
        replace(written, arm=replace(written.arm, joints=unknown_position.arm.joints)),
        true_values,
        records,
    ), true_values


def _numbered(study: Study) -> list[tuple[int, Joint]]:
    return list(enumerate(study.arm.joints, start=1))


def turned(rpy: tuple[float, float, float], about: float) -> Values:
    """IMU attitude relative to a direction at the angle `about` in the link frame."""
    matrix = attitude((0.0, 0.0, -about)) @ attitude(rpy)
    names = ("imu_roll", "imu_pitch", "imu_yaw")
    return dict(zip(((name, 1) for name in names), angles(matrix).tolist(), strict=True))


def test_one_imu_of_three_axes_on_the_second_link() -> None:
    """Position, attitude and delay of the IMU, and both gears."""
    model, true_values = glued(2, ("ax", "ay", "az"), delay=1e-3)
    assert model.status == "converged"
    place = {("imu_x", 2): PLACE[0], ("imu_y", 2): PLACE[1]}
    rpy = dict(zip((("imu_roll", 2), ("imu_pitch", 2), ("imu_yaw", 2)), ATTITUDE, strict=True))
    check(model, place | rpy | {("imu_accelerometer_delay", 2): 1e-3})
    check_gears(model, true_values, 4.0)
    names = {p.name for p in model.parameters}
    assert not any(name.startswith(("imu_turn", "imu_start")) for name in names)
    assert len(model.covariance) == len(model.parameters)


def test_one_imu_of_three_axes_on_the_first_link() -> None:
    """The first axis is fixed: only the distance and the relative attitude are identifiable."""
    model, true_values = glued(1, ("ax", "ay", "az"))
    direction = float(np.arctan2(PLACE[1], PLACE[0]))
    expected = {("imu_distance", 1): float(np.hypot(PLACE[0], PLACE[1]))}
    check(model, expected | turned(ATTITUDE, direction))  # type: ignore[arg-type]
    check_gears(model, true_values, 4.0)


def test_under_gravity_the_first_links_imu_has_a_place() -> None:
    model, _ = glued(1, ("ax", "ay", "az", "gx", "gy", "gz"), gravity=9.81)
    rpy = dict(zip((("imu_roll", 1), ("imu_pitch", 1), ("imu_yaw", 1)), ATTITUDE, strict=True))
    check(model, {("imu_x", 1): PLACE[0], ("imu_y", 1): PLACE[1]} | rpy)


@pytest.mark.parametrize("joint", [1, 2])
def test_two_axes_in_the_plane_of_motion(joint: int) -> None:
    """The sensor is mounted upside down below the link."""
    rpy = (np.pi, 0.0, 0.8)
    model, true_values = glued(joint, ("ax", "ay"), rpy)
    place: dict[tuple[str, int], float] = {("imu_x", 2): PLACE[0], ("imu_y", 2): PLACE[1]}
    yaw = rpy[2]
    if joint == 1:
        place = {("imu_distance", 1): float(np.hypot(PLACE[0], PLACE[1]))}
        yaw -= float(np.arctan2(PLACE[1], PLACE[0]))
    check(model, place | {("imu_yaw", joint): yaw})
    check_gears(model, true_values, 4.0)
    assert "imu_roll" not in {p.name for p in model.parameters}
