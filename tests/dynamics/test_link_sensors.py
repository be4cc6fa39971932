"""Link sensors: constants, compared channels, model over time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import Imu, Joint
from strainwave.domain.arm.kinds import planar_two_link, single_joint
from strainwave.domain.arm.link_sensors import (
    ConstantKind,
    LinkSensor,
    all_types,
    compared_axes,
    constant_of,
    installed_axes,
    low_passes,
    nominal,
    optional_constants,
    sensor_constants,
    with_bandwidths,
    with_estimates,
)
from strainwave.domain.arm.link_sensors.single_axis import MotorEncoder
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import apply_sensor_model, differentiate_rows, shift_samples
from strainwave.signals.hygiene.defects import count_of

T = 1e-3
TIME = T * np.arange(2000)
INNER = slice(40, -40)
JOINT = Joint("linear", 0.01, accelerometer_distance=0.3)
ARM = planar_two_link((JOINT, JOINT), 0.35)
ANYWHERE = Joint("linear", 0.01)
PRISMATIC = Joint("linear", 0.01, motion="prismatic")


@pytest.mark.parametrize("ahead", [-7.3, -1.0, -0.25, 0.5, 3.0, 12.8])
def test_shifted_samples_match_the_shifted_signal(ahead: float) -> None:
    """Up to a quarter of the sampling rate, within the ripple of the window."""
    for hz in (3.0, 60.0, 250.0):
        x = np.sin(2.0 * np.pi * hz * TIME + 0.4)
        expected = np.sin(2.0 * np.pi * hz * (TIME + ahead * T) + 0.4)
        assert shift_samples(x, ahead)[INNER] == pytest.approx(expected[INNER], abs=1e-4)


def test_a_constant_and_a_zero_shift_do_not_change() -> None:
    assert shift_samples(np.full(50, 3.0), 2.4) == pytest.approx(3.0, abs=1e-14)
    x = np.random.default_rng(0).normal(size=50)
    assert np.array_equal(shift_samples(x, 0.0), x)
    assert len(shift_samples(x, -3.7)) == 50


def test_the_derivative_of_rows_at_four_samples_per_period() -> None:
    row_time = 2e-3
    t = row_time * np.arange(500)
    for hz, limit in ((10.0, 1e-9), (62.5, 1e-6), (125.0, 1e-3)):
        w = 2.0 * np.pi * hz
        slope = differentiate_rows(np.sin(w * t), row_time)
        assert np.max(np.abs(slope - w * np.cos(w * t))[10:-10]) < limit * w


def test_delay_and_scale_change_the_reading() -> None:
    x = np.sin(2.0 * np.pi * 20.0 * TIME)
    values: Values = {("accelerometer_delay", 2): 1.5e-3, ("accelerometer_scale", 2): 1.04}
    expected = 1.04 * np.sin(2.0 * np.pi * 20.0 * (TIME - 1.5e-3))
    (first,), (second,) = (compared_axes(ARM, i, [f"a{i}"]) for i in (1, 2))
    reading = apply_sensor_model(x, T, second, values)
    assert reading[INNER] == pytest.approx(expected[INNER], abs=1e-4)
    assert np.array_equal(apply_sensor_model(x, T, first, values), x)  # of another joint


def test_constants_and_their_keys() -> None:
    kinds: list[type[LinkSensor]] = [MotorEncoder, *all_types()]
    names = [constant.name for kind in kinds for constant in kind.constants()]
    assert sorted(names) == sorted(sensor_constants())  # no name twice
    assert constant_of(("gear_damping", 1)) is None
    (axis,) = compared_axes(ARM, 2, ["a2", "gyro2", "theta_l2"])
    assert axis.key(ConstantKind.DELAY) == ("accelerometer_delay", 2)
    drift = axis.key(ConstantKind.DRIFT, "prbs")
    assert drift == ("accelerometer_drift[prbs]", 2)
    constant = constant_of(drift)
    assert constant is not None
    assert (constant.kind, constant.unit) == (ConstantKind.DRIFT, "m/s^3")
    assert {axis.key(kind) for kind in (ConstantKind.SHARE, ConstantKind.POSITION_X)} == {None}
    assert {name: nominal((name, 1)) for name in optional_constants()} == {
        name: 1.0
        if constant.kind is ConstantKind.SCALE
        else np.inf
        if constant.kind in (ConstantKind.BANDWIDTH, ConstantKind.MOUNT_FREQUENCY)
        else 0.0
        for name, constant in sensor_constants().items()
        if constant.is_optional
    }


@pytest.mark.parametrize(
    ("joint", "logged", "compared"),
    [
        (JOINT, "a theta_l gyro", "a"),
        (JOINT, "deflection theta_l gyro", "theta_l"),
        (JOINT, "gyro tau_l", "gyro tau_l"),
        (JOINT, "a ax ay gz", "a ax ay gz"),
        (ANYWHERE, "a gyro", "gyro a"),
        (ANYWHERE, "a theta_l ax gz", "theta_l ax gz"),
        (PRISMATIC, "a ax", "a"),
        (replace(JOINT, spring="rigid"), "tau_l", ""),
    ],
)
def test_what_a_fit_compares(joint: Joint, logged: str, compared: str) -> None:
    axes = compared_axes(single_joint(joint), 1, [f"{kind}1" for kind in logged.split()])
    assert {axis.channel for axis in axes} == {f"{kind}1" for kind in compared.split()}


def test_a_link_encoder_has_the_resolution_of_its_counts() -> None:
    arm = single_joint(replace(JOINT, link_encoder_counts=1000.0, encoder_counts=500.0))
    (axis,) = compared_axes(arm, 1, ["theta_l1"])
    assert axis.sensor.resolution == pytest.approx(2e-3 * np.pi)
    assert count_of("theta_l1", Arm.of(arm)) == axis.sensor.resolution
    assert count_of("theta_m1", Arm.of(arm)) == pytest.approx(4e-3 * np.pi)
    assert count_of("a1", Arm.of(arm)) == 0.0


def test_a_link_has_the_sensors_of_its_table_and_of_the_channels() -> None:
    arm = single_joint(replace(JOINT, gyro_hz=5.0, imu=Imu()))
    installed = installed_axes(arm, 1, ["a1", "theta_l1", "tau_l1"])
    kinds = ("a", "theta_l", "gyro", "ax", "ay", "az", "gx", "gy", "gz", "tau_l")
    assert [axis.channel for axis in installed] == [f"{kind}1" for kind in kinds]
    assert not installed_axes(single_joint(ANYWHERE), 1, ["a1", "gyro1"])


def test_a_torsion_sensor_reads_minus_the_torsion() -> None:
    (axis,) = installed_axes(ARM, 2, ["deflection2"])[1:]
    assert axis.quantities == ("torsion",)
    torsion = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert axis.reading({"torsion": torsion}, {}).tolist() == [-2.0, -4.0]


def test_bandwidths_reach_the_low_passes_of_the_core() -> None:
    hz: Values = {("accelerometer_bandwidth", 1): 80.0, ("imu_gyro_bandwidth", 1): 40.0}
    known = low_passes(with_bandwidths(JOINT, 1, hz))
    assert known == {"accelerometer_hz": 80.0, "gyro_hz": None}
    unknown = low_passes(with_bandwidths(ANYWHERE, 1, hz))
    assert unknown == {"imu_accelerometer_hz": 80.0, "gyro_hz": None}
    with_imu = low_passes(with_bandwidths(replace(JOINT, imu=Imu()), 1, hz))
    assert with_imu == known | {"imu_accelerometer_hz": None, "imu_gyro_hz": 40.0}
    assert low_passes(with_bandwidths(JOINT, 2, hz)) == low_passes(JOINT)


def test_an_estimated_distance_makes_the_place_known() -> None:
    joint = with_estimates(ANYWHERE, 1, {("accelerometer_distance", 1): 0.2})
    assert joint == replace(ANYWHERE, accelerometer_distance=0.2)
    assert [axis.quantities for axis in compared_axes(single_joint(joint), 1, ["a1"])] == [
        ("accelerometer",)
    ]
