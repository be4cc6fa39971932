"""Model of a link sensor over time: its delay, its scale and the resonance of its mount."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors import Axis, ConstantKind
from strainwave.dynamics.mount_resonance import MountResonance

MAX_SENSOR_DELAY = 5e-3
"""Largest delay [s] of a sensor: logger, bus and internal filter."""

MAX_SCALE_ERROR = 0.1
"""Largest relative scale error: data sheets state 1 to 3 %, a distance adds a few per cent."""

_INTERPOLATION_TAPS = 16  # samples on each side of an interpolated sample
_KAISER_BETA = 9.0  # of the interpolation window
_DIFFERENCES = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)  # central, eighth order


def mount_resonance(axis: Axis, values: Mapping[Key, float]) -> MountResonance | None:
    """Resonance of the mount of a sensor; None if the mount is rigid."""
    names = axis.mount
    if names is None or names[0] not in values:
        return None
    return MountResonance(*(values[name] for name in names))


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
    samples: FloatArray, sample_time: float, axis: Axis, values: Mapping[Key, float]
) -> FloatArray:
    """Reading of a sensor with its mount resonance, delay and scale.

    `values` without constants of the sensor describe an ideal sensor.
    """
    mount = mount_resonance(axis, values)
    if mount is not None:
        samples = mount.read(samples, sample_time)
    delay = axis.value(ConstantKind.DELAY, values)
    shifted = shift_samples(samples, -delay / sample_time)
    return np.asarray(axis.value(ConstantKind.SCALE, values) * shifted)
