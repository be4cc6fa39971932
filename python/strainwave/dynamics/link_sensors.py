"""Model of a link sensor: a delay and a scale for all records, a bias and a drift for each.

    y(t) = s x(t - D) + bias + r (t - t_m)

x is the motion after the sensor's low-pass, as the study describes it, and after the resonance of
its mount, if it has one. t_m is the middle of the record. Joints count from 1; keys are (name,
joint). A `quantity` is the measured quantity, or the name of an IMU's sensor or axis.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.keys import Key
from strainwave.domain.parameter_table import base_name, of_record
from strainwave.dynamics.mount_resonance import MountResonance
from strainwave.dynamics.mounting import ACCELEROMETER_TILT, is_mounting

MAX_SENSOR_DELAY = 5e-3
"""Largest delay [s] of a sensor: logger, bus and internal filter."""

MAX_SCALE_ERROR = 0.1
"""Largest relative scale error: data sheets state 1 to 3 %, a distance adds a few per cent."""

_SENSORS: Mapping[str, str] = {
    "accelerometer": "accelerometer",
    "gyro": "gyro",
    "link_angle": "link_encoder",
    "imu_accelerometer": "imu_accelerometer",
    "imu_gyro": "imu_gyro",
}
_ENCODERS = ("link_encoder",)  # the line count gives the scale
_MULTI_AXIS_SENSORS = ("imu_accelerometer", "imu_gyro")  # scale and drift belong to each axis
_AXES = ("imu_ax", "imu_ay", "imu_az", "imu_gx", "imu_gy", "imu_gz")
_MOUNT_CONSTANTS = ("mount_frequency", "mount_damping")
_MOUNT_NAMES = {
    f"{sensor}_{constant}"
    for sensor in _SENSORS.values()
    if sensor not in _ENCODERS
    for constant in _MOUNT_CONSTANTS
}
_INTERPOLATION_TAPS = 16  # samples on each side of an interpolated sample
_KAISER_BETA = 9.0  # of the interpolation window
_DIFFERENCES = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)  # central, eighth order


def delay_of(quantity: str, joint: int) -> Key | None:
    """Delay of the sensor that measures a quantity; None if no sensor does."""
    sensor = _SENSORS.get(quantity)
    return None if sensor is None else (f"{sensor}_delay", joint)


def scale_of(quantity: str, joint: int) -> Key | None:
    """Scale of the sensor or axis that measures a quantity; None if it has none."""
    sensor = quantity if quantity in _AXES else _SENSORS.get(quantity)
    none = sensor is None or sensor in (*_ENCODERS, *_MULTI_AXIS_SENSORS)
    return None if none else (f"{sensor}_scale", joint)


def bandwidth_of(quantity: str, joint: int) -> Key | None:
    """Bandwidth of the sensor that measures a quantity; None if it has none."""
    sensor = _SENSORS.get(quantity)
    return None if sensor is None or sensor in _ENCODERS else (f"{sensor}_bandwidth", joint)


def mount_of(quantity: str, joint: int) -> tuple[Key, Key] | None:
    """Natural frequency and damping ratio of the sensor's mount; None if it has none."""
    sensor = _SENSORS.get(quantity)
    if sensor is None or sensor in _ENCODERS:
        return None
    frequency, damping = (f"{sensor}_{constant}" for constant in _MOUNT_CONSTANTS)
    return (frequency, joint), (damping, joint)


def mount_resonance(
    quantity: str, joint: int, values: Mapping[Key, float]
) -> MountResonance | None:
    """Mount resonance of the sensor that measures a quantity; None if the mount is rigid."""
    names = mount_of(quantity, joint)
    if names is None or names[0] not in values:
        return None
    return MountResonance(*(values[name] for name in names))


def is_of_mount(key: Key) -> bool:
    """Whether a key is the natural frequency or the damping ratio of a sensor's mount."""
    return key[0].endswith(_MOUNT_CONSTANTS) and is_optional(key)


def drift_of(quantity: str, joint: int, record: str) -> Key | None:
    """Drift in one record of the sensor or axis that measures a quantity; None if it has none."""
    sensor = quantity if quantity in _AXES else _SENSORS.get(quantity)
    none = sensor is None or sensor in (*_ENCODERS, *_MULTI_AXIS_SENSORS)
    return None if none else (of_record(f"{sensor}_drift", record), joint)


def is_drift(key: Key) -> bool:
    """Whether a key is a sensor's drift in one record."""
    return base_name(key[0]).endswith("_drift") and is_optional(key)


def is_sensor_constant(key: Key) -> bool:
    """Whether a parameter belongs to a link sensor, not to the arm."""
    return is_mounting(key) or is_optional(key)


def is_optional(key: Key) -> bool:
    """Whether a key is a sensor constant that a fit includes only if the data support it."""
    sensor, _, constant = base_name(key[0]).rpartition("_")
    if sensor in _SENSORS.values() and constant in ("delay", "scale", "bandwidth", "drift"):
        return True
    is_of_axis = sensor in _AXES and constant in ("scale", "drift")
    return is_of_axis or key[0] == ACCELEROMETER_TILT or key[0] in _MOUNT_NAMES


def is_bandwidth(key: Key) -> bool:
    """Whether a key is a sensor's bandwidth."""
    return key[0].endswith("_bandwidth") and is_optional(key)


def nominal(key: Key) -> float:
    """Value of an optional sensor constant for an ideal sensor.

    Delay, tilt and drift are zero, the scale is one, bandwidth and mount frequency are infinite.
    """
    if key[0].endswith("_scale"):
        return 1.0
    is_frequency = is_bandwidth(key) or key[0].endswith(_MOUNT_CONSTANTS[0])
    return np.inf if is_frequency else 0.0


def list_sensor_constants(channels: Iterable[tuple[str, int]]) -> Iterator[Key]:
    """Delays and scales of the sensors of some channels, without duplicates."""
    keys: dict[Key, None] = {}
    for quantity, joint in channels:
        for key in (delay_of(quantity, joint), scale_of(quantity, joint)):
            if key is not None:
                keys[key] = None
    yield from keys


def differentiate_rows(rows: FloatArray, row_time: float) -> FloatArray:
    """Time derivative of oversampled rows (n_rows,) by central differences of eighth order.

    At the low-pass's cut-off, four rows per period, the derivative is 4 % too small. `row_time`
    [s].
    """
    reach = len(_DIFFERENCES)
    around = np.pad(rows, reach, mode="edge")
    n, difference = len(rows), np.zeros(len(rows))
    for k, weight in enumerate(_DIFFERENCES, start=1):
        ahead, behind = around[reach + k : reach + k + n], around[reach - k : reach - k + n]
        difference += weight * (ahead - behind)
    return np.asarray(difference / row_time)


def shift_samples(samples: FloatArray, ahead: float) -> FloatArray:
    """Samples at shifted times, y_k = x(k + ahead), by windowed sinc interpolation.

    The signal continues with its first and last value beyond its ends. `ahead` is in samples.
    """
    if not ahead:
        return samples
    whole = int(np.floor(ahead))
    taps = _INTERPOLATION_TAPS
    offset = np.arange(-taps, taps + 1, dtype=np.float64) - (ahead - whole)
    window = np.i0(_KAISER_BETA * np.sqrt(np.clip(1.0 - (offset / (taps + 1.0)) ** 2, 0.0, None)))
    weights = np.sinc(offset) * window
    weights /= weights.sum()
    around = np.pad(samples, taps + abs(whole), mode="edge")
    first = abs(whole) + whole
    section = around[first : first + len(samples) + 2 * taps]
    return np.asarray(np.convolve(section, weights[::-1], mode="valid"))


def apply_sensor_model(
    samples: FloatArray, sample_time: float, joint: int, values: Mapping[Key, float]
) -> FloatArray:
    """Reading of an accelerometer with its mount resonance, delay and scale.

    `values` without constants of the sensor describe an ideal sensor.
    """
    delay = values.get(("accelerometer_delay", joint), 0.0)
    scale = values.get(("accelerometer_scale", joint), 1.0)
    mount = mount_resonance("accelerometer", joint, values)
    if mount is not None:
        samples = mount.read(samples, sample_time)
    return np.asarray(scale * shift_samples(samples, -delay / sample_time))
