"""Model of a link sensor, and its derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.domain.keys import Values
from strainwave.domain.link_sensors import optional_constants
from strainwave.domain.parameter_table import base_name
from strainwave.dynamics.link_sensors import (
    apply_sensor_model,
    bandwidth_of,
    delay_of,
    differentiate_rows,
    drift_of,
    is_drift,
    is_optional,
    is_sensor_constant,
    list_sensor_constants,
    mount_of,
    nominal,
    scale_of,
    shift_samples,
)
from strainwave.dynamics.mounting import ACCELEROMETER_DISTANCE, ACCELEROMETER_TILT

T = 1e-3
TIME = T * np.arange(2000)
INNER = slice(40, -40)


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
    for hz, limit in ((10.0, 1e-6), (62.5, 1e-3), (125.0, 0.05)):
        w = 2.0 * np.pi * hz
        slope = differentiate_rows(np.sin(w * t), row_time)
        assert np.max(np.abs(slope - w * np.cos(w * t))[8:-8]) < limit * w


def test_delay_and_scale_change_the_reading() -> None:
    x = np.sin(2.0 * np.pi * 20.0 * TIME)
    values: Values = {("accelerometer_delay", 2): 1.5e-3, ("accelerometer_scale", 2): 1.04}
    expected = 1.04 * np.sin(2.0 * np.pi * 20.0 * (TIME - 1.5e-3))
    assert apply_sensor_model(x, T, 2, values)[INNER] == pytest.approx(expected[INNER], abs=1e-4)
    assert np.array_equal(apply_sensor_model(x, T, 1, values), x)  # constants of another joint


def test_names_of_sensor_constants() -> None:
    every = [(name, 1) for name in ("accelerometer", "gyro", "link_angle")]
    every += [("imu_accelerometer", 1), ("imu_gyro", 1)]
    names = {name for name, _ in list_sensor_constants(every)} | {ACCELEROMETER_TILT}
    names |= {key[0] for each in every if (key := bandwidth_of(*each)) is not None}
    names |= {key[0] for each in every for key in mount_of(*each) or ()}
    of_axes = [scale_of(f"imu_{axis}", 1) for axis in ("ax", "ay", "az", "gx", "gy", "gz")]
    names |= {key[0] for key in of_axes if key is not None}
    axes = [(f"imu_{axis}", 1) for axis in ("ax", "ay", "az", "gx", "gy", "gz")]
    drifts = [drift_of(*each, "prbs") for each in (*every, *axes)]
    assert all(key[0].endswith("_drift[prbs]") and is_drift(key) for key in drifts if key)
    names |= {base_name(key[0]) for key in drifts if key is not None}
    assert names <= set(optional_constants())
    assert all(is_optional((name, 1)) and is_sensor_constant((name, 1)) for name in names)
    assert not is_optional((ACCELEROMETER_DISTANCE, 1))
    assert is_sensor_constant((ACCELEROMETER_DISTANCE, 1))
    keys = list(
        list_sensor_constants([("motor_angle", 1), ("accelerometer", 1), ("link_angle", 2)])
    )
    assert keys == [
        ("accelerometer_delay", 1),
        ("accelerometer_scale", 1),
        ("link_encoder_delay", 2),
    ]
    assert all(is_sensor_constant(key) for key in keys)
    assert not is_sensor_constant(("gear_damping", 1))
    assert delay_of("motor_angle", 1) is None
    assert scale_of("link_angle", 1) is None
    assert [nominal(key) for key in keys] == [0.0, 1.0, 0.0]
