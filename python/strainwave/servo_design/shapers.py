"""Input shapers: impulses that, convolved with a reference, leave a mode of the arm at rest.

A mode of frequency omega and damping ratio zeta, excited by impulses A_i at times t_i, vibrates
after the last impulse t_n with the share

    V = |sum_i A_i exp(p omega (t_i - t_n))|,   p = zeta + j sqrt(1 - zeta^2)

of the vibration after one impulse (Singer and Seering, J. Dyn. Sys. Meas. Control 112, 1990).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.servo_design.extra_insensitive import design_zeros_and_maxima

MIN_TOLERANCE = 1e-3
"""Smallest vibration that an extra-insensitive shaper may tolerate: below, it is a ZVD shaper."""

_SAME_TIME = 1e-9  # of a period, within which an impulse lies on a sample


class ShaperKind(StrEnum):
    """Conditions that determine a shaper."""

    ZV = "ZV"  # no vibration at the design mode
    MZV = "MZV"  # the same by three impulses within three quarters of a period
    ZVD = "ZVD"  # no vibration, and no change of it with the frequency
    EI = "EI"  # tolerated vibration at the design mode, none at a frequency on either side
    TWO_HUMP_EI = "two-hump EI"  # none at the design mode, tolerated maxima and zeros around it


@dataclass(frozen=True, slots=True, eq=False)
class Impulses:
    """Impulses that are applied to a reference."""

    amplitudes: FloatArray  # (n,), sum 1
    times: FloatArray  # (n,) [s], ascending from 0

    def residual_vibration(self, omega: FloatArray, damping: FloatArray) -> FloatArray:
        """Vibration after the last impulse as a share of that after an unshaped step.

        Frequencies [rad/s] and damping ratios have one shape, that of the shares. The unshaped
        step counts at its beginning. Raises `InvalidInput` unless the modes oscillate.
        """
        omega, damping = check_modes(omega, damping)
        active = self.amplitudes != 0.0
        before_end = self.times[active] - self.times[-1]
        rate = omega * (damping + 1j * np.sqrt(1.0 - damping**2))
        return np.asarray(np.abs(np.exp(rate[..., None] * before_end) @ self.amplitudes[active]))

    @property
    def duration(self) -> float:
        """Time from the first to the last impulse [s], by which every move is longer."""
        return float(self.times[-1])


@dataclass(frozen=True, slots=True, eq=False)
class Shaper:
    """A shaper and the mode for which it is designed."""

    kind: ShaperKind
    omega: float  # [rad/s]
    damping: float
    impulses: Impulses

    def sample(self, period: float) -> Impulses:
        """The shaper on the clock of a servo: an impulse per period [s], many of them zero.

        Two neighbouring samples replace an impulse such that the design mode responds equally: its
        phase and amplitude determine both of them, and they are positive. The vibration of that
        mode thus changes only by the factor that restores the sum, and zeros remain zeros. A split
        that keeps sum and first moment leaves a vibration of up to (omega period)^2 / 8.
        Raises `InvalidInput` if the mode vibrates faster than half of the sampling rate.
        """
        check_period(period, np.array(self.omega), np.array(self.damping))
        step = self.omega * period
        decay, turn = self.damping * step, np.sqrt(1.0 - self.damping**2) * step
        ticks = self.impulses.times / period
        first = np.floor(ticks + _SAME_TIME).astype(int)
        share = np.maximum(ticks - first, 0.0)
        share[share < _SAME_TIME] = 0.0
        ahead = np.exp(decay * share) * np.sin(turn * (1.0 - share)) / np.sin(turn)
        behind = np.exp(decay * (share - 1.0)) * np.sin(turn * share) / np.sin(turn)
        weights = np.zeros(first[-1] + (2 if share[-1] else 1))
        np.add.at(weights, first, self.impulses.amplitudes * ahead)
        split = share > 0.0
        np.add.at(weights, first[split] + 1, (self.impulses.amplitudes * behind)[split])
        return Impulses(weights / weights.sum(), period * np.arange(len(weights), dtype=float))


def design_shaper(
    kind: ShaperKind, omega: float, damping: float, tolerance: float = 0.05
) -> Shaper:
    """Shaper for a mode of frequency `omega` [rad/s] and a damping ratio.

    `tolerance` is the vibration that extra-insensitive shapers permit around the design mode.
    Raises `InvalidInput` if the mode does not oscillate, or if it decays too fast for this kind.
    """
    check_modes(np.array(omega), np.array(damping))
    if not MIN_TOLERANCE <= tolerance < 1.0:
        raise InvalidInput(
            f"the tolerated vibration {tolerance:g} is outside {MIN_TOLERANCE:g} to 1",
            remedy="give a share such as 0.05",
        )
    impulses = _unit_impulses(kind, damping, tolerance)
    if impulses is None:
        raise InvalidInput(
            f"no {kind} shaper for a vibration of {tolerance:g} exists at a damping ratio of "
            f"{damping:g}: the mode decays too fast",
            remedy="choose a ZV, MZV or ZVD shaper, or a smaller tolerance",
        )
    scaled = Impulses(impulses.amplitudes, impulses.times / omega)
    return Shaper(kind, omega, damping, scaled)


def has_design(kind: ShaperKind, damping: float, tolerance: float) -> bool:
    """Whether a kind exists at a damping ratio: extra-insensitive shapers need a slow decay."""
    return _unit_impulses(kind, damping, tolerance) is not None


def check_modes(omega: FloatArray, damping: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frequencies and damping ratios as arrays of one shape, if all modes oscillate."""
    omega, damping = np.asarray(omega, dtype=float), np.asarray(damping, dtype=float)
    if omega.shape != damping.shape:
        raise InvalidInput(
            f"frequencies have the shape {omega.shape}, damping ratios {damping.shape}",
            remedy="give one damping ratio per frequency",
        )
    wrong = ~(np.isfinite(omega) & (omega > 0.0))
    if wrong.any():
        raise InvalidInput(
            f"the frequency {omega[wrong][0]:g} rad/s of a mode is not positive and finite",
            remedy="give angular frequencies in rad/s",
        )
    wrong = ~((damping >= 0.0) & (damping < 1.0))
    if wrong.any():
        raise InvalidInput(
            f"a mode with the damping ratio {damping[wrong][0]:g} does not oscillate",
            remedy="give damping ratios from 0 up to, but not including, 1",
        )
    return omega, damping


def check_period(period: float, omega: FloatArray, damping: FloatArray) -> None:
    """Raise `InvalidInput` unless the clock samples modes at least twice per oscillation."""
    if not (np.isfinite(period) and period > 0.0):
        raise InvalidInput(f"the sampling period {period:g} s is not positive and finite")
    fastest = float(np.max(omega * np.sqrt(1.0 - damping**2)))
    if fastest * period >= np.pi:
        raise InvalidInput(
            f"a mode vibrates at {fastest / (2.0 * np.pi):.4g} Hz, but half of the sampling rate "
            f"is {0.5 / period:.4g} Hz",
            remedy="leave that mode out, or shape the reference at a higher rate",
        )


# Impulses of equal spacing: half periods between them, and their amplitudes without damping.
_EQUALLY_SPACED = {
    ShaperKind.ZV: (1.0, (1.0, 1.0)),
    ShaperKind.MZV: (0.75, (1.0, np.sqrt(2.0), 1.0)),  # 1 - 2 cos(0.75 pi) z + z^2
    ShaperKind.ZVD: (1.0, (1.0, 2.0, 1.0)),
}
_N_ZEROS = {ShaperKind.EI: 2, ShaperKind.TWO_HUMP_EI: 3}

TOLERANT = frozenset(_N_ZEROS)
"""Kinds that depend on the tolerated vibration."""


@lru_cache(maxsize=256)
def _unit_impulses(kind: ShaperKind, damping: float, tolerance: float) -> Impulses | None:
    """Impulses for a frequency of 1 rad/s, or None if the kind does not exist."""
    if kind in _N_ZEROS:
        design = design_zeros_and_maxima(_N_ZEROS[kind], damping, tolerance)
        return None if design is None else Impulses(design.amplitudes, design.times)
    half_periods, pattern = _EQUALLY_SPACED[kind]
    oscillation = np.sqrt(1.0 - damping**2)
    times = np.pi * half_periods / oscillation * np.arange(len(pattern))
    amplitudes = np.array(pattern) * np.exp(-damping * times)
    return Impulses(amplitudes / amplitudes.sum(), times)
