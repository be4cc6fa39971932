"""Readings of an IMU as an accelerometer or a gyro."""

from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import ArmDescription, Experiment, FloatArray, Imu, Joint, Lag, Log, Origin
from strainwave.domain.arm.kinds.planar import single_joint
from strainwave.domain.arm.link_sensors.imu import ImuAccelerometers
from strainwave.domain.arm.link_sensors.link_space import link_space
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import JointMotion, link_quantities
from strainwave.signals.link_readings import combine_axes


def test_an_imu_with_gyros_only_becomes_a_gyro() -> None:
    arm = Arm.of(single_joint(Joint("linear", 0.01, imu=Imu(gyro_hz=100.0))))
    t: FloatArray = 1e-3 * np.arange(20_000, dtype=np.float64)
    rate = np.cos(2.0 * t)
    direction = np.array([0.36, 0.48, 0.8])  # of the joint's axis in the frame of the IMU
    channels = {f"g{axis}1": c * rate for axis, c in zip("xyz", direction, strict=True)}
    channels["theta_m1"] = 50.0 * np.sin(2.0 * t)
    log = Log(Experiment("motion", "", "motion", ("open",)), t, 1e-3, channels)
    reading = combine_axes([log], arm, [log])[1]
    assert reading is not None
    assert reading.source == "gyro"
    assert reading.lags == (Lag(2, 100.0),)
    # the motors give the directions through differences of fourth order
    np.testing.assert_allclose(reading.samples(log, arm), rate, atol=1e-4)


@pytest.mark.parametrize("imu", [Imu((0.2, 0.05, 0.03), (0.4, 0.0, 0.3)), Imu()])
def test_an_imu_on_a_sliding_link_becomes_an_accelerometer(imu: Imu) -> None:
    """Along the slide and at the origin of the link, on an arm that turns about its base."""
    turning = Joint("linear", 0.01)
    placed = Origin((0.1, 0.0, 0.2), (-1.5, 0.0, 0.2))
    slide = Joint("linear", 0.003, "prismatic", origin=placed, axis=(0.0, 0.6, 0.8))
    joints = turning, replace(slide, imu=imu)
    arm = Arm.of(ArmDescription("serial", joints, (0.0, 0.0, -9.81)))
    known = replace(slide, imu=Imu((0.2, 0.05, 0.03), (0.4, 0.0, 0.3)))
    T = 1e-3
    t: FloatArray = T * np.arange(20_000, dtype=np.float64)
    motors = np.column_stack([90.0 * np.sin(1.7 * t) + 40.0 * np.sin(4.1 * t), 60.0 * np.cos(t)])
    motion = JointMotion.of_motors(motors, arm, T)
    axes = ImuAccelerometers.of_joint(known)
    assert axes is not None
    channels = {f"theta_m{i + 1}": motors[:, i] for i in range(2)}
    for axis in axes.axes(2, link_space(arm, 2)):
        (parts,) = link_quantities([axis], arm, motion)
        channels[axis.channel] = parts @ axis.sensor.weights(axis, {})
    log = Log(Experiment("motion", "", "motion", ("open",) * 2), t, T, channels)
    reading = combine_axes([log], arm, [log])[2]
    assert reading is not None
    expected = reading.predict(arm, motion)[2000:-2000]
    # a bias is estimated later; the motion of the motors is low-passed
    error = reading.samples(log, arm)[2000:-2000] - expected
    assert np.std(error) < 0.01 * np.std(expected)
