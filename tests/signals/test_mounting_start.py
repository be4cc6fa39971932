"""Sensors at unknown positions as equivalent accelerometers and gyros."""

import numpy as np

from strainwave.domain import Experiment, FloatArray, Imu, Joint, Log
from strainwave.domain.kinds.single_joint import single_joint
from strainwave.dynamics.arm import Arm
from strainwave.signals.mounting_start import substitute_equivalent_sensors


def test_an_imu_with_gyros_only_becomes_a_gyro() -> None:
    arm = Arm.of(single_joint(Joint("linear", 0.01, imu=Imu(gyro_hz=100.0))))
    t: FloatArray = 1e-3 * np.arange(20_000, dtype=np.float64)
    rate = np.cos(2.0 * t)
    direction = np.array([0.36, 0.48, 0.8])  # of the joint's axis in the frame of the IMU
    channels = {f"g{axis}1": c * rate for axis, c in zip("xyz", direction, strict=True)}
    channels["theta_m1"] = 50.0 * np.sin(2.0 * t)
    log = Log(Experiment("motion", "", "motion", ("open",)), t, 1e-3, channels)
    (changed,), substitute = substitute_equivalent_sensors([log], arm, [log])
    assert substitute.joints[0].gyro_hz == 100.0 / np.sqrt(2.0)
    # the motors give the directions through differences of fourth order
    np.testing.assert_allclose(changed.channels["gyro1"], rate, atol=1e-4)
