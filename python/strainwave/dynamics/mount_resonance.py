"""A link sensor on a soft mount, which reads a motion as its mount passes it on, (S31).

    H(s) = w^2 / (s^2 + 2 zeta w s + w^2)

Samples pass it by its frequency response, exactly where they hold all of a motion: a recursive
filter at their rate would assume straight lines between them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from strainwave.domain import ComplexArray, FloatArray

_FORGOTTEN = 7.0  # time constants of the decay after which a thousandth is left
_LONGEST = 10.0  # [s] of what is added behind a record for that


@dataclass(frozen=True, slots=True)
class MountResonance:
    """Natural frequency and damping ratio of a sensor on its mount."""

    frequency: float  # [Hz], above zero
    damping: float  # above zero

    def response(self, hz: FloatArray) -> ComplexArray:
        """H at some frequencies [Hz], (n_frequencies,)."""
        w, s = math.tau * self.frequency, 2j * np.pi * hz
        return np.asarray(w**2 / (s**2 + 2.0 * self.damping * w * s + w**2))

    def response_slopes(self, hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Derivatives of H by frequency [1/Hz] and by damping, (n_frequencies,) each.

        d ln H / d ln w = 2 - (2 zeta s / w + 2) H and d ln H / d zeta = -2 (s / w) H.
        """
        ratio, H = 1j * hz / self.frequency, self.response(hz)
        by_frequency = (2.0 - 2.0 * (self.damping * ratio + 1.0) * H) * H / self.frequency
        return np.asarray(by_frequency), np.asarray(-2.0 * ratio * H**2)

    def read(self, motion: FloatArray, sample_time: float) -> FloatArray:
        """What the sensor reads of a motion that stands still before its first sample.

        `motion` (n_samples, ...). `sample_time` [s]. Returns (n_samples, ...).
        """
        (passed,) = self._passed(motion, sample_time, lambda hz: (self.response(hz),))
        return np.asarray(passed + motion[:1])

    def slopes(self, motion: FloatArray, sample_time: float) -> tuple[FloatArray, FloatArray]:
        """Derivatives of what it reads by frequency [1/Hz] and by damping.

        `motion` (n_samples, ...). `sample_time` [s]. Returns (n_samples, ...).
        """
        by_frequency, by_damping = self._passed(motion, sample_time, self.response_slopes)
        return by_frequency, by_damping

    def _passed(
        self,
        motion: FloatArray,
        sample_time: float,
        responses: Callable[[FloatArray], tuple[ComplexArray, ...]],
    ) -> list[FloatArray]:
        """What responses make of the change since the first sample, (n_samples, ...) each.

        A spectrum is of a periodic signal: behind its end the motion goes back to where it began,
        and rests for as long as the mount takes to forget the record.
        """
        from scipy.fft import next_fast_len

        lasts = min(_FORGOTTEN / (math.tau * self.frequency * self.damping), _LONGEST)
        n, more = len(motion), math.ceil(lasts / sample_time)
        along = (-1, *(1 for _ in motion.shape[1:]))
        change = motion - motion[:1]
        back = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, more + 1) / more).reshape(along)
        size = next_fast_len(n + 2 * more, real=True)
        spectrum = np.fft.rfft(np.concatenate([change, change[-1:] * back]), size, axis=0)
        found = responses(np.asarray(np.fft.rfftfreq(size, sample_time)))
        return [np.fft.irfft(spectrum * H.reshape(along), size, axis=0)[:n] for H in found]
