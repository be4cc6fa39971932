"""Resonance of a sensor mount, compared with SciPy's simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim

from strainwave.domain import FloatArray, Joint
from strainwave.domain.arm.kinds import planar_two_link
from strainwave.domain.arm.link_sensors import compared_axes
from strainwave.dynamics.link_sensors import MountResonance, apply_sensor_model, mount_resonance

T = 1e-3
JOINT = Joint("linear", 0.01, accelerometer_distance=0.3)
ARM = planar_two_link((JOINT, JOINT), 0.35)
FINER = 50
TIME: FloatArray = T * np.arange(600, dtype=np.float64)


def motion(t: FloatArray) -> FloatArray:
    """Band-limited motion that starts immediately."""
    rising = 1.0 - np.exp(-((t / 0.01) ** 2))
    return np.asarray(3.0 + rising * (np.sin(210.0 * t) + 0.5 * np.sin(700.0 * t + 1.0)))


@pytest.mark.parametrize(("frequency", "damping"), [(40.0, 0.01), (85.0, 0.05), (200.0, 0.7)])
def test_the_reading_matches_scipy(frequency: float, damping: float) -> None:
    fine: FloatArray = T / FINER * np.arange(FINER * len(TIME), dtype=np.float64)
    w = 2.0 * np.pi * frequency
    system = ([w**2], [1.0, 2.0 * damping * w, w**2])
    expected = 3.0 + lsim(system, motion(fine) - 3.0, fine)[1][::FINER]
    read = MountResonance(frequency, damping).read(motion(TIME), T)
    # samples of a motion of finite length are not exactly band-limited
    assert np.max(np.abs(read - expected)[:-20]) < 2e-3
    assert np.max(np.abs(read - expected)) < 0.05


def test_several_motions_are_filtered_independently() -> None:
    mount = MountResonance(60.0, 0.03)
    both = np.stack([motion(TIME), np.cos(90.0 * TIME)], axis=1)
    read = mount.read(both, T)
    for k in (0, 1):
        np.testing.assert_allclose(read[:, k], mount.read(both[:, k], T), atol=1e-12)


@pytest.mark.parametrize("damping", [0.02, 0.4])
def test_slopes_match_differences(damping: float) -> None:
    x, f = motion(TIME), 70.0
    by_frequency, by_damping = MountResonance(f, damping).slopes(x, T)
    # the padding depends on the mount, which changes the reading by 1/1000 of the vibration
    for slope, step in ((by_frequency, (1e-3, 0.0)), (by_damping, (0.0, 1e-5))):
        ends = [
            MountResonance(f + sign * step[0], damping + sign * step[1]).read(x, T)
            for sign in (1.0, -1.0)
        ]
        numeric = (ends[0] - ends[1]) / (2.0 * sum(step))
        assert np.max(np.abs(slope - numeric)) < 2e-3 * np.max(np.abs(numeric))


def test_a_constant_is_read_unchanged() -> None:
    still = np.full(200, 9.81)
    assert MountResonance(50.0, 0.01).read(still, T) == pytest.approx(still)


def test_the_sensor_model_applies_the_mount() -> None:
    first, second = (compared_axes(ARM, i, [f"a{i}"])[0] for i in (1, 2))
    assert second.mount is not None
    values = dict(zip(second.mount, (55.0, 0.04), strict=True))
    mount = mount_resonance(second, values)
    assert mount == MountResonance(55.0, 0.04)
    assert mount_resonance(first, values) is None
    x = motion(TIME)
    np.testing.assert_array_equal(apply_sensor_model(x, T, second, values), mount.read(x, T))
    np.testing.assert_array_equal(apply_sensor_model(x, T, first, values), x)


def test_encoders_have_no_mount() -> None:
    mounts = [axis.mount for axis in compared_axes(ARM, 1, ["theta_l1", "gx1"])]
    assert mounts == [None, (("imu_gyro_mount_frequency", 1), ("imu_gyro_mount_damping", 1))]
