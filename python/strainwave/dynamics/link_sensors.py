"""Model of a link sensor over time: its delay, its scale and the resonance of its mount.

Resonance of a link sensor's mount, (S31).

    H(s) = w^2 / (s^2 + 2 zeta w s + w^2)

The frequency response is applied to the spectrum of the samples, which is exact if the samples
resolve the motion. A recursive filter would assume straight lines between samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from strainwave.domain import ComplexArray, FloatArray
from strainwave.domain.arm.link_sensors import ConstantKind, SensorAxis
from strainwave.domain.keys import Key
from strainwave.numerics.filters import fast_length

_DECAY_TIME_CONSTANTS = 7.0  # the response has then decayed to 1/1000
_MAX_PADDING = 10.0  # [s] after a record


@dataclass(frozen=True, slots=True)
class MountResonance:
    """Natural frequency and damping ratio of a sensor's mount."""

    frequency: float  # [Hz], above zero
    damping: float  # above zero

    def response(self, hz: FloatArray) -> ComplexArray:
        """H at frequencies [Hz]: (n_frequencies,)."""
        w, s = math.tau * self.frequency, 2j * np.pi * hz
        return np.asarray(w**2 / (s**2 + 2.0 * self.damping * w * s + w**2))

    def response_slopes(self, hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Derivatives of H with respect to frequency [1/Hz] and damping ratio.

        d ln H / d ln w = 2 - (2 zeta s / w + 2) H,   d ln H / d zeta = -2 (s / w) H
        """
        ratio, H = 1j * hz / self.frequency, self.response(hz)
        by_frequency = (2.0 - 2.0 * (self.damping * ratio + 1.0) * H) * H / self.frequency
        return np.asarray(by_frequency), np.asarray(-2.0 * ratio * H**2)

    def read(self, motion: FloatArray, sample_time: float) -> FloatArray:
        """Sensor reading of a motion (n_samples, ...) that is at rest before its first sample."""
        (reading,) = self._filtered(motion, sample_time, lambda hz: (self.response(hz),))
        return np.asarray(reading + motion[:1])

    def slopes(self, motion: FloatArray, sample_time: float) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the reading with respect to frequency [1/Hz] and damping ratio."""
        by_frequency, by_damping = self._filtered(motion, sample_time, self.response_slopes)
        return by_frequency, by_damping

    def _filtered(
        self,
        motion: FloatArray,
        sample_time: float,
        responses: Callable[[FloatArray], tuple[ComplexArray, ...]],
    ) -> list[FloatArray]:
        """Change since the first sample after each response: (n_samples, ...) each.

        A discrete spectrum implies a periodic signal. The motion is therefore extended by a return
        to its start and a pause in which the response decays.
        """
        decay = _DECAY_TIME_CONSTANTS / (math.tau * self.frequency * self.damping)
        n, padding = len(motion), math.ceil(min(decay, _MAX_PADDING) / sample_time)
        shape = (-1, *(1 for _ in motion.shape[1:]))
        change = motion - motion[:1]
        back = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, padding + 1) / padding).reshape(shape)
        size = fast_length(n + 2 * padding)
        spectrum = np.fft.rfft(np.concatenate([change, change[-1:] * back]), size, axis=0)
        factors = responses(np.asarray(np.fft.rfftfreq(size, sample_time)))
        return [np.fft.irfft(spectrum * H.reshape(shape), size, axis=0)[:n] for H in factors]


MAX_SENSOR_DELAY = 5e-3
"""Largest delay [s] of a sensor: logger, bus and internal filter."""

MAX_SCALE_ERROR = 0.1
"""Largest relative scale error: data sheets state 1 to 3 %, a distance adds a few per cent."""

_INTERPOLATION_TAPS = 16  # samples on each side of an interpolated sample
_KAISER_BETA = 9.0  # of the interpolation window
_DIFFERENCE_REACH = 10  # rows on each side of a difference


def mount_resonance(axis: SensorAxis, values: Mapping[Key, float]) -> MountResonance | None:
    """Resonance of the mount of a sensor; None if the mount is rigid."""
    names = axis.mount
    if names is None or names[0] not in values:
        return None
    return MountResonance(*(values[name] for name in names))


def differentiate_rows(rows: FloatArray, row_time: float) -> FloatArray:
    """Time derivative of oversampled rows (n_rows,) by central differences of twentieth order.

    At the low-pass's cut-off, four rows per period, the derivative is 0.04 % too small. A delay is
    nearly collinear with a torque hold, so that an error of some per cent stops a search.
    `row_time` [s].
    """
    around = np.pad(rows, _DIFFERENCE_REACH, mode="edge")
    return np.convolve(around, _difference_weights() / row_time, mode="valid")


@cache
def _difference_weights() -> FloatArray:
    """Weights of central differences: (-1)^(k + 1) (n!)^2 / (k (n - k)! (n + k)!) at k rows."""
    n, later = _DIFFERENCE_REACH, range(1, _DIFFERENCE_REACH + 1)
    weights = [(-1) ** (k + 1) * math.comb(2 * n, n - k) / (k * math.comb(2 * n, n)) for k in later]
    return np.array([*weights[::-1], 0.0, *(-weight for weight in weights)])


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
    samples: FloatArray, sample_time: float, axis: SensorAxis, values: Mapping[Key, float]
) -> FloatArray:
    """Reading of a sensor with its mount resonance, delay and scale.

    `values` without constants of the sensor describe an ideal sensor.
    """
    mount = mount_resonance(axis, values)
    if mount is not None:
        samples = mount.read(samples, sample_time)
    shifted = shift_samples(samples, -axis.delay(values) / sample_time)
    return np.asarray(axis.value(ConstantKind.SCALE, values) * shifted)
