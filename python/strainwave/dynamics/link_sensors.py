"""What a link sensor does to what it reads: a delay and a scale, one of each for all records.

    y(t) = s x(t - D) + bias + r (t - t_m)

x is the motion behind the sensor's own low-pass, as the study has it, and behind a mount that
rings, if it has one. Bias and drift r are those of one record, whose middle is t_m.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.parameter_table import base_name, of_record
from strainwave.dynamics.mount_resonance import MountResonance
from strainwave.dynamics.mounting import TILT, is_mounting

Key = tuple[str, int | None]

LONGEST_DELAY = 5e-3
"""[s] that a logger, a bus or a filter in a sensor takes."""

LARGEST_SCALE_ERROR = 0.1
"""Of a sensor of the right unit: data sheets promise 1 to 3 %, a distance is known to a few."""

_SENSORS: Mapping[str, str] = {
    "accelerometer": "accelerometer",
    "gyro": "gyro",
    "link_angle": "link_encoder",
    "imu_accelerometer": "imu_accelerometer",
    "imu_gyro": "imu_gyro",
}
_COUNTED = ("link_encoder",)  # an encoder's scale is the number of its lines
_BY_AXIS = ("imu_accelerometer", "imu_gyro")  # have one of each axis
_AXES = ("imu_ax", "imu_ay", "imu_az", "imu_gx", "imu_gy", "imu_gz")
_OF_MOUNTS = ("mount_frequency", "mount_damping")
_NAMES_OF_MOUNTS = {f"{s}_{w}" for s in _SENSORS.values() if s not in _COUNTED for w in _OF_MOUNTS}
_TAPS = 16  # samples to either side that make one between them
_SHAPE = 9.0  # of the Kaiser window over them
_DIFFERENCES = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)  # central, of eighth order


def delay_of(quantity: str, joint: int) -> Key | None:
    """The delay's name of the sensor that reads a quantity, None where none does.

    `quantity`: That is read, or the name of an IMU's sensor. `joint`: From 1. Returns (name,
    joint).
    """
    sensor = _SENSORS.get(quantity)
    return None if sensor is None else (f"{sensor}_delay", joint)


def scale_of(quantity: str, joint: int) -> Key | None:
    """The scale's name of the sensor that reads a quantity, None where it has none.

    `quantity`: That is read, or the name of an IMU's sensor. `joint`: From 1. Returns (name,
    joint).
    """
    sensor = quantity if quantity in _AXES else _SENSORS.get(quantity)
    none = sensor is None or sensor in (*_COUNTED, *_BY_AXIS)
    return None if none else (f"{sensor}_scale", joint)


def bandwidth_of(quantity: str, joint: int) -> Key | None:
    """The bandwidth's name of the sensor that reads a quantity, None where it has none.

    `quantity`: That is read, or the name of an IMU's sensor. `joint`: From 1. Returns (name,
    joint).
    """
    sensor = _SENSORS.get(quantity)
    return None if sensor is None or sensor in _COUNTED else (f"{sensor}_bandwidth", joint)


def mount_of(quantity: str, joint: int) -> tuple[Key, Key] | None:
    """The names of frequency and damping of the mount of the sensor that reads a quantity.

    `quantity`: That is read, or the name of an IMU's sensor. `joint`: From 1. Returns: None where
    it has none.
    """
    sensor = _SENSORS.get(quantity)
    if sensor is None or sensor in _COUNTED:
        return None
    frequency, damping = (f"{sensor}_{what}" for what in _OF_MOUNTS)
    return (frequency, joint), (damping, joint)


def mount_resonance(
    quantity: str, joint: int, values: Mapping[Key, float]
) -> MountResonance | None:
    """How the sensor that reads a quantity rings on its mount; None where it sits firmly.

    `quantity`: That is read, or the name of an IMU's sensor. `joint`: From 1. `values`: (name,
    joint) -> value.
    """
    names = mount_of(quantity, joint)
    if names is None or names[0] not in values:
        return None
    return MountResonance(*(values[name] for name in names))


def is_of_mount(key: Key) -> bool:
    """Whether it is the frequency or the damping of a sensor's mount.

    `key` (name, joint).
    """
    return key[0].endswith(_OF_MOUNTS) and is_optional(key)


def drift_of(quantity: str, joint: int, record: str) -> Key | None:
    """The name of a record's drift of the sensor that reads a quantity, None where it has none.

    `quantity`: That is read, or the name of an IMU's axis. `joint`: From 1. Returns (name, joint).
    """
    sensor = quantity if quantity in _AXES else _SENSORS.get(quantity)
    none = sensor is None or sensor in (*_COUNTED, *_BY_AXIS)
    return None if none else (of_record(f"{sensor}_drift", record), joint)


def is_drift(key: Key) -> bool:
    """Whether it is a sensor's drift in one record.

    `key` (name, joint).
    """
    return base_name(key[0]).endswith("_drift") and is_optional(key)


def is_sensor_constant(key: Key) -> bool:
    """Whether a parameter is a link sensor's, not the arm's.

    `key` (name, joint).
    """
    return is_mounting(key) or is_optional(key)


def is_optional(key: Key) -> bool:
    """Whether it is a sensor constant that is there by evidence only.

    `key` (name, joint).
    """
    sensor, _, what = base_name(key[0]).rpartition("_")
    single = what in ("delay", "scale", "bandwidth", "drift") and sensor in _SENSORS.values()
    single = single or key[0] in _NAMES_OF_MOUNTS
    return key[0] == TILT or single or (what in ("scale", "drift") and sensor in _AXES)


def is_bandwidth(key: Key) -> bool:
    """Whether it is a sensor's bandwidth.

    `key` (name, joint).
    """
    return key[0].endswith("_bandwidth") and is_optional(key)


def nominal(key: Key) -> float:
    """The value of an optional sensor constant where nothing is wrong.

    No delay, no tilt, no drift, a scale of one, a bandwidth and a mount beyond all that moves.

    `key` (name, joint).
    """
    if key[0].endswith("_scale"):
        return 1.0
    beyond = is_bandwidth(key) or key[0].endswith(_OF_MOUNTS[0])
    return np.inf if beyond else 0.0


def constants_of(channels: Iterable[tuple[str, int]]) -> Iterator[Key]:
    """The sensor constants of channels, each once.

    Returns (name, joint).
    """
    seen: set[Key] = set()
    for quantity, joint in channels:
        for key in (delay_of(quantity, joint), scale_of(quantity, joint)):
            if key is not None and key not in seen:
                seen.add(key)
                yield key


def slope_of_rows(rows: FloatArray, row_time: float) -> FloatArray:
    """Time derivative of rows that lie closer than their band needs, by central differences.

    Of eighth order: at the low-pass's cut-off, four rows in a period, 4 % are missing.

    `rows` (n_rows,). `row_time` [s]. Returns (n_rows,).
    """
    reach = len(_DIFFERENCES)
    around = np.pad(rows, reach, mode="edge")
    n, found = len(rows), np.zeros(len(rows))
    for k, weight in enumerate(_DIFFERENCES, start=1):
        ahead, behind = around[reach + k : reach + k + n], around[reach - k : reach - k + n]
        found += weight * (ahead - behind)
    return np.asarray(found / row_time)


def moved(samples: FloatArray, ahead: float) -> FloatArray:
    """Samples a fraction of a step further on: y_k = x(k + ahead), by a windowed sinc.

    Beyond its ends a signal goes on as it ends.

    `samples` (n_samples,). `ahead` [samples]. Returns (n_samples,).
    """
    if not ahead:
        return samples
    whole = int(np.floor(ahead))
    at = np.arange(-_TAPS, _TAPS + 1, dtype=np.float64) - (ahead - whole)
    window = np.i0(_SHAPE * np.sqrt(np.clip(1.0 - (at / (_TAPS + 1.0)) ** 2, 0.0, None)))
    weights = np.sinc(at) * window
    weights /= weights.sum()
    around = np.pad(samples, _TAPS + abs(whole), mode="edge")
    first = abs(whole) + whole
    reach = around[first : first + len(samples) + 2 * _TAPS]
    return np.asarray(np.convolve(reach, weights[::-1], mode="valid"))


def as_read(
    samples: FloatArray, sample_time: float, joint: int, values: Mapping[Key, float]
) -> FloatArray:
    """What an accelerometer with its mount, delay and scale makes of what it should read.

    `samples` (n_samples,). `sample_time` [s]. `joint`: From 1. `values`: (name, joint) -> value;
    without the sensor's constants nothing changes. Returns (n_samples,).
    """
    delay = values.get(("accelerometer_delay", joint), 0.0)
    scale = values.get(("accelerometer_scale", joint), 1.0)
    mount = mount_resonance("accelerometer", joint, values)
    if mount is not None:
        samples = mount.read(samples, sample_time)
    return np.asarray(scale * moved(samples, -delay / sample_time))
