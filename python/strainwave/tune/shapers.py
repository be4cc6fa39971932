"""Input shapers: impulses that, convolved with a reference, leave a mode of the arm at rest.

Shapers are ranked for modes that vary over draws, postures and payloads.

A mode of frequency omega and damping ratio zeta, excited by impulses A_i at times t_i, vibrates
after the last impulse t_n with the share

    V = |sum_i A_i exp(p omega (t_i - t_n))|,   p = zeta + j sqrt(1 - zeta^2)

of the vibration after one impulse (Singer and Seering, J. Dyn. Sys. Meas. Control 112, 1990).

Extra-insensitive input shapers by their definition, for modes with damping.

Over the frequency of a mode of given damping ratio, the residual vibration of such a shaper is
alternately zero and a maximum of the tolerated height: twice zero for the EI shaper, whose maximum
is at the design frequency, and three times for the two-hump EI shaper.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, lru_cache, reduce
from heapq import nsmallest
from itertools import islice, pairwise, product

import numpy as np
from scipy.optimize import minimize_scalar, root

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput

_DAMPING_STEP = 0.02  # of the continuation; of 0.05 it fails where a zero is already far away
_MAX_RESIDUAL = 1e-9  # of the equations of a design, which are of order one


@dataclass(frozen=True, slots=True, eq=False)
class ZerosAndMaxima:
    """Impulses, and frequencies at which their vibration is alternately zero and largest.

    The frequency in the middle is 1 rad/s.
    """

    amplitudes: FloatArray  # (n_zeros + 1,)
    times: FloatArray  # (n_zeros + 1,)
    omega: FloatArray  # (2 n_zeros - 1,)

    def unknowns(self) -> FloatArray:
        """Amplitudes and times after the first impulse, frequencies but for the middle."""
        others = np.delete(self.omega, len(self.omega) // 2)
        return np.concatenate([self.amplitudes[1:], self.times[1:], others])

    @staticmethod
    def of(unknowns: FloatArray, n_zeros: int) -> ZerosAndMaxima:
        """The inverse of `unknowns`."""
        amplitudes, times = np.zeros((2, n_zeros + 1))
        amplitudes[1:], times[1:] = unknowns[:n_zeros], unknowns[n_zeros : 2 * n_zeros]
        amplitudes[0] = 1.0 - amplitudes.sum()
        omega = np.ones(2 * n_zeros - 1)
        omega[: n_zeros - 1] = unknowns[2 * n_zeros : 3 * n_zeros - 1]
        omega[n_zeros:] = unknowns[3 * n_zeros - 1 :]
        return ZerosAndMaxima(amplitudes, times, omega)

    def equations(self, damping: float, tolerance: float) -> FloatArray:
        """Zero where the zeros and the maxima of the tolerated height are those of a mode."""
        before_end = self.times - self.times[-1]
        p = damping + 1j * np.sqrt(1.0 - damping**2)
        terms = np.exp(p * np.outer(self.omega, before_end)) * self.amplitudes
        values, slopes = terms.sum(axis=1), terms @ (p * before_end)
        zeros, maxima = values[::2], values[1::2] / tolerance
        height = np.abs(maxima) ** 2 - 1.0
        slope = (maxima.conj() * slopes[1::2]).real / tolerance
        return np.concatenate([zeros.real, zeros.imag, height, slope])

    def damped(self, before: float, after: float) -> ZerosAndMaxima:
        """Approximation for another damping: the impulses of a mode that decays differently."""
        oscillations = [np.sqrt(1.0 - damping**2) for damping in (before, after)]
        decay = after / oscillations[1] - before / oscillations[0]
        amplitudes = self.amplitudes * np.exp(-decay * np.pi * np.arange(len(self.amplitudes)))
        times = self.times * oscillations[0] / oscillations[1]
        return ZerosAndMaxima(amplitudes / amplitudes.sum(), times, self.omega)

    def is_regular(self) -> bool:
        """Whether impulses are positive, and times and frequencies ascend."""
        ascending = (np.diff(self.times) > 0.0).all() and (np.diff(self.omega) > 0.0).all()
        return bool(ascending and (self.amplitudes > 0.0).all())


def design_zeros_and_maxima(
    n_zeros: int, damping: float, tolerance: float
) -> ZerosAndMaxima | None:
    """Shaper with alternate zeros and maxima of the tolerated height around 1 rad/s, if any.

    They follow from the undamped shaper by continuation in the damping ratio (Singhose, Seering
    and Singer, J. Mech. Des. 116, 1994, state the conditions). With growing damping the highest
    zero moves to infinity, beyond which there is no such shaper.
    """
    shaper = _chebyshev(n_zeros, tolerance)
    steps = np.linspace(0.0, damping, int(np.ceil(damping / _DAMPING_STEP)) + 1)
    for before, after in pairwise(steps.tolist()):

        def equations(unknowns: FloatArray, at: float = after) -> FloatArray:
            return ZerosAndMaxima.of(unknowns, n_zeros).equations(at, tolerance)

        with np.errstate(over="ignore", invalid="ignore"):  # on the way to a zero at infinity
            solution = root(equations, shaper.damped(before, after).unknowns(), tol=1e-12)
        shaper = ZerosAndMaxima.of(solution.x, n_zeros)
        if not (np.abs(solution.fun).max() < _MAX_RESIDUAL and shaper.is_regular()):
            return None
    return shaper


def _chebyshev(n_zeros: int, tolerance: float) -> ZerosAndMaxima:
    """Shaper without damping: V = tolerance |T_n(x cos(omega t / 2))|, T_n(x) = 1 / tolerance.

    Chebyshev polynomials have the widest interval with maxima of the tolerated height.
    """
    x = np.cosh(np.arccosh(1.0 / tolerance) / n_zeros)
    angles = np.arange(1, 2 * n_zeros) * np.pi / (2.0 * n_zeros)
    omega = 2.0 / np.pi * np.arccos(np.cos(angles) / x)
    amplitudes = np.poly(np.exp(1j * np.pi * omega[::2])).real
    times = np.pi * np.arange(n_zeros + 1, dtype=float)
    return ZerosAndMaxima(amplitudes / amplitudes.sum(), times, omega)


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
        step counts at its beginning.
        """
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
        that keeps sum and first moment leaves a vibration of up to (omega period)^2 / 8. The mode
        vibrates slower than half of the sampling rate.
        """
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
    """Shaper for a mode of frequency `omega` [rad/s] and a damping ratio from 0 to less than 1.

    `tolerance` is the vibration that extra-insensitive shapers permit around the design mode, from
    `MIN_TOLERANCE` to less than 1. Raises `InvalidInput` if the mode decays too fast for this kind.
    """
    impulses = _unit_impulses(kind, damping, tolerance)
    if impulses is None:
        raise InvalidInput(
            f"no {kind} shaper for a vibration of {tolerance:g} exists at a damping ratio of "
            f"{damping:g}: the mode decays too fast",
            remedy="choose a ZV, MZV or ZVD shaper, or a smaller tolerance",
        )
    return Shaper(kind, omega, damping, Impulses(impulses.amplitudes, impulses.times / omega))


def has_design(kind: ShaperKind, damping: float, tolerance: float) -> bool:
    """Whether a kind exists at a damping ratio: extra-insensitive shapers need a slow decay."""
    return _unit_impulses(kind, damping, tolerance) is not None


# Impulses of equal spacing: half periods between them, and their amplitudes without damping.
_EQUALLY_SPACED = {
    ShaperKind.ZV: (1.0, (1.0, 1.0)),
    ShaperKind.MZV: (0.75, (1.0, np.sqrt(2.0), 1.0)),  # 1 - 2 cos(0.75 pi) z + z^2
    ShaperKind.ZVD: (1.0, (1.0, 2.0, 1.0)),
}
_N_ZEROS = {ShaperKind.EI: 2, ShaperKind.TWO_HUMP_EI: 3}


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


_Interval = tuple[FloatArray, FloatArray]
"""Frequencies that a mode may have, ascending, and damping ratios at them."""


def _interval_of(omega: FloatArray, damping: FloatArray) -> _Interval:
    """The central `COVERAGE` of drawn modes, and frequencies between the draws."""
    tail = 0.5 * (1.0 - COVERAGE)
    low, high = np.quantile(omega, [tail, 1.0 - tail])
    order = np.argsort(omega)
    inside = omega[(omega >= low) & (omega <= high)]
    grid = np.unique(np.concatenate([inside, np.linspace(low, high, _N_FREQUENCIES)]))
    return grid, np.interp(grid, omega[order], damping[order])


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
    intervals = [_interval_of(*mode) for mode in zip(omega, damping, strict=True)]
    for frequencies, ratios in intervals:
        fastest = float(np.max(frequencies * np.sqrt(1.0 - ratios**2)))
        if fastest * period >= np.pi:
            raise InvalidInput(
                f"a mode vibrates at {fastest / (2.0 * np.pi):.4g} Hz, but half of the sampling "
                f"rate is {0.5 / period:.4g} Hz",
                remedy="leave that mode out, or shape the reference at a higher rate",
            )
    all_modes = [np.concatenate(parts) for parts in zip(*intervals, strict=True)]
    choices = [list(_choices(one, all_modes, period)) for one in intervals]
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


_Choice = tuple[Shaper | None, FloatArray, FloatArray]
"""A shaper for one mode or none, its impulses, and its vibration of all modes."""


def _choices(mode: _Interval, modes: Sequence[FloatArray], period: float) -> Iterator[_Choice]:
    """No shaper, and the best of each kind; `modes` are frequencies and damping of all modes."""
    yield None, np.ones(1), np.ones(len(modes[0]))
    for kind in ShaperKind:
        if has_design(kind, _middle(mode[1]), MIN_TOLERANCE):
            shaper = _least_vibration(kind, mode, period)
            sampled = shaper.sample(period)
            yield shaper, sampled.amplitudes, sampled.residual_vibration(*modes)


def _middle(damping: FloatArray) -> float:
    """Damping ratio for which shapers of an interval are designed."""
    return 0.5 * float(damping.min() + damping.max())


def _least_vibration(kind: ShaperKind, mode: _Interval, period: float) -> Shaper:
    """Shaper whose frequency, and tolerance if it has one, give the least vibration at worst."""
    # evenly spread over the draws
    chosen = np.unique(np.linspace(0, len(mode[0]) - 1, _N_SEARCHED).round().astype(int))
    frequencies, ratios = mode[0][chosen], mode[1][chosen]
    low, high, middle = float(frequencies[0]), float(frequencies[-1]), _middle(ratios)

    rate = frequencies * (ratios + 1j * np.sqrt(1.0 - ratios**2))
    exponential = cache(lambda time: np.exp(rate * time))

    def worst(omega: float, tolerance: float) -> float:
        """The largest `residual_vibration`; many trials have the same exponentials."""
        sampled = design_shaper(kind, omega, middle, tolerance).sample(period)
        active = sampled.amplitudes != 0.0
        before_end = (sampled.times[active] - sampled.times[-1]).tolist()
        exponentials = np.stack([exponential(time) for time in before_end], axis=-1)
        return float(np.abs(exponentials @ sampled.amplitudes[active]).max())

    def best(tolerance: float) -> tuple[float, float]:
        return _minimum(lambda omega: worst(omega, tolerance), low, high)

    def worst_of_best(log_ratio: float) -> float:
        tolerance = MIN_TOLERANCE * float(np.exp(log_ratio))
        exists = has_design(kind, middle, tolerance)
        return best(tolerance)[1] if exists else 1.0

    tolerance = MIN_TOLERANCE
    if kind in _N_ZEROS:  # which depend on the tolerated vibration
        widest = float(np.log(_MAX_TOLERANCE / MIN_TOLERANCE))
        tolerance *= float(np.exp(_minimum(worst_of_best, 0.0, widest)[0]))
    return design_shaper(kind, best(tolerance)[0], middle, tolerance)


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


def _combined(parts: tuple[_Choice, ...], period: float, required: float) -> RankedShaper:
    """Convolution of the shapers; its vibration is the product of theirs."""
    shapers, weights, vibrations = zip(*parts, strict=True)
    combined, vibration = reduce(np.convolve, weights), float(reduce(np.multiply, vibrations).max())
    return RankedShaper(
        shapers=tuple(shaper for shaper in shapers if shaper is not None),
        impulses=Impulses(combined, period * np.arange(len(combined), dtype=float)),
        vibration=vibration,
        is_sufficient=vibration <= required,
    )
