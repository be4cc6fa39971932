"""Choice of input shapers for modes that vary over draws, postures and payloads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from heapq import nsmallest
from itertools import islice, product

import numpy as np
from scipy.optimize import minimize_scalar

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.tune.shapers import (
    MIN_TOLERANCE,
    TOLERANT,
    Impulses,
    Shaper,
    ShaperKind,
    design_shaper,
    has_design,
)

COVERAGE = 0.95
"""Share of a mode's frequencies that its interval covers."""

_MAX_TOLERANCE = 0.5  # of an extra-insensitive shaper, which hardly attenuates beyond
_N_FREQUENCIES = 101  # of an interval; a shaper has at most three zeros in it
_N_SEARCHED = 300  # frequencies of an interval in the search of a shaper
_N_RANKED = 35  # candidates: all for two modes
_N_STARTS = 17  # of a search over frequencies or tolerances, which has few minima


@dataclass(frozen=True, slots=True, eq=False)
class RankedShaper:
    """Shapers that together form one candidate."""

    shapers: tuple[Shaper, ...]  # at most one per mode
    impulses: Impulses  # on the clock of the servo
    vibration: float  # the largest share of residual vibration over the modes' intervals
    is_sufficient: bool  # whether the vibration is within the requirement

    @property
    def title(self) -> str:
        """Kinds and design frequencies."""
        parts = [f"{one.kind} at {one.omega / (2.0 * np.pi):.4g} Hz" for one in self.shapers]
        return " and ".join(parts)

    @property
    def samples(self) -> list[int]:
        """Periods of the servo from the first impulse to each that is not zero."""
        return list(np.flatnonzero(self.impulses.amplitudes).tolist())

    @property
    def times(self) -> list[float]:
        """Times [s] of these impulses."""
        return list(self.impulses.times[self.samples].tolist())

    @property
    def amplitudes(self) -> list[float]:
        """Amplitudes of these impulses, sum 1."""
        return list(self.impulses.amplitudes[self.samples].tolist())


@dataclass(frozen=True, slots=True, eq=False)
class _Interval:
    """Frequencies that a mode may have, and damping ratios at them."""

    omega: FloatArray  # ascending
    damping: FloatArray

    @property
    def searched(self) -> _Interval:
        """Frequencies for the search of a shaper, evenly spread over the draws."""
        chosen = np.unique(np.linspace(0, len(self.omega) - 1, _N_SEARCHED).round().astype(int))
        return _Interval(self.omega[chosen], self.damping[chosen])

    @staticmethod
    def of(omega: FloatArray, damping: FloatArray) -> _Interval:
        """The central `COVERAGE` of drawn modes, and frequencies between the draws."""
        tail = 0.5 * (1.0 - COVERAGE)
        low, high = np.quantile(omega, [tail, 1.0 - tail])
        order = np.argsort(omega)
        inside = omega[(omega >= low) & (omega <= high)]
        grid = np.unique(np.concatenate([inside, np.linspace(low, high, _N_FREQUENCIES)]))
        return _Interval(grid, np.interp(grid, omega[order], damping[order]))

    @property
    def middle_damping(self) -> float:
        """Damping ratio for which shapers are designed."""
        return 0.5 * float(self.damping.min() + self.damping.max())


def rank_shapers(
    omega: FloatArray, damping: FloatArray, period: float, required: float = 0.05
) -> list[RankedShaper]:
    """Shapers for drawn modes on a clock of a `period` [s], the best first.

    `omega` [rad/s] and `damping` are (n_draws,) of one mode or (n_modes, n_draws). First are those
    that keep the residual vibration within the share `required` over the central 95 % of every
    mode's frequencies, the shortest first; then the others, those with the least vibration first.
    The design frequency of a shaper, and the tolerance of an extra-insensitive one, are those for
    which the largest vibration over the interval of its mode is least.

    Several modes have the convolution of their shapers; a mode may have none if the shapers of the
    others suffice. Raises `InvalidInput` if a mode does not oscillate, or too fast for the clock.
    """
    omega, damping = np.atleast_2d(omega), np.atleast_2d(damping)
    _check_modes(omega, damping)
    intervals = [_Interval.of(*mode) for mode in zip(omega, damping, strict=True)]
    for interval in intervals:
        _check_period(period, interval)
    choices = [_choices(one, intervals, period) for one in intervals]
    combinations = islice(product(*choices), 1, None)  # the first has no shaper
    return nsmallest(
        _N_RANKED,
        (_combined(parts, period, required) for parts in combinations),
        key=lambda r: (max(r.vibration, required), r.impulses.duration, r.vibration),
    )


def _check_modes(omega: FloatArray, damping: FloatArray) -> None:
    """Raise `InvalidInput` unless all modes oscillate."""
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


def _check_period(period: float, mode: _Interval) -> None:
    """Raise `InvalidInput` unless the clock samples a mode at least twice per oscillation."""
    fastest = float(np.max(mode.omega * np.sqrt(1.0 - mode.damping**2)))
    if fastest * period >= np.pi:
        raise InvalidInput(
            f"a mode vibrates at {fastest / (2.0 * np.pi):.4g} Hz, but half of the sampling rate "
            f"is {0.5 / period:.4g} Hz",
            remedy="leave that mode out, or shape the reference at a higher rate",
        )


@dataclass(frozen=True, slots=True, eq=False)
class _ShaperChoice:
    """A shaper for one mode, or none."""

    shaper: Shaper | None
    weights: FloatArray  # (n_samples,)
    vibration: FloatArray  # of all modes, over their intervals


def _choices(mode: _Interval, modes: list[_Interval], period: float) -> list[_ShaperChoice]:
    omega = np.concatenate([one.omega for one in modes])
    damping = np.concatenate([one.damping for one in modes])
    choices = [_ShaperChoice(None, np.ones(1), np.ones(len(omega)))]
    for kind in ShaperKind:
        if has_design(kind, mode.middle_damping, MIN_TOLERANCE):
            shaper = _least_vibration(kind, mode.searched, period)
            sampled = shaper.sample(period)
            vibration = sampled.residual_vibration(omega, damping)
            choices.append(_ShaperChoice(shaper, sampled.amplitudes, vibration))
    return choices


def _least_vibration(kind: ShaperKind, mode: _Interval, period: float) -> Shaper:
    """Shaper whose frequency, and tolerance if it has one, give the least vibration at worst."""
    low, high = float(mode.omega[0]), float(mode.omega[-1])

    def worst(omega: float, tolerance: float) -> float:
        sampled = design_shaper(kind, omega, mode.middle_damping, tolerance).sample(period)
        return float(sampled.residual_vibration(mode.omega, mode.damping).max())

    def best(tolerance: float) -> tuple[float, float]:
        return _minimum(lambda omega: worst(omega, tolerance), low, high)

    def worst_of_best(log_ratio: float) -> float:
        tolerance = MIN_TOLERANCE * float(np.exp(log_ratio))
        exists = has_design(kind, mode.middle_damping, tolerance)
        return best(tolerance)[1] if exists else 1.0

    tolerance = MIN_TOLERANCE
    if kind in TOLERANT:
        widest = float(np.log(_MAX_TOLERANCE / MIN_TOLERANCE))
        tolerance *= float(np.exp(_minimum(worst_of_best, 0.0, widest)[0]))
    return design_shaper(kind, best(tolerance)[0], mode.middle_damping, tolerance)


def _minimum(cost: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Argument and value of the least cost: of a grid, then refined between its neighbours."""
    grid = np.unique(np.linspace(low, high, _N_STARTS)).tolist()
    costs = [cost(x) for x in grid]
    best = int(np.argmin(costs))
    begin, end = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    least = grid[best], costs[best]
    if begin == end:
        return least
    search = minimize_scalar(cost, bounds=(begin, end), method="bounded")
    return min(least, (float(search.x), float(search.fun)), key=lambda pair: pair[1])


def _combined(parts: tuple[_ShaperChoice, ...], period: float, required: float) -> RankedShaper:
    """Convolution of the shapers; its vibration is the product of theirs."""
    weights = reduce(np.convolve, (part.weights for part in parts))
    vibration = float(reduce(np.multiply, (part.vibration for part in parts)).max())
    return RankedShaper(
        shapers=tuple(part.shaper for part in parts if part.shaper is not None),
        impulses=Impulses(weights, period * np.arange(len(weights), dtype=float)),
        vibration=vibration,
        is_sufficient=vibration <= required,
    )
