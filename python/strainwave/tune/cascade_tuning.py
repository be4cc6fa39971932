"""Gains of PI velocity loops and position loops: the largest bandwidth that keeps the margins.

Joint by joint, with the loops of the other joints closed, gains are raised until the first plant
violates a margin. The search uses a few plants; all plants are then checked, and the worst is added
to the search until all keep their margins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate, repeat, takewhile
from operator import mul

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, IntArray
from strainwave.errors import InvalidInput
from strainwave.numerics.parallel import run_parallel
from strainwave.tune.closed_loop import (
    Biquad,
    Clock,
    ClosedLoop,
    Gains,
    SampledPlants,
    SampledResponses,
    Steps,
    close,
    frequency_grid,
    low_pass,
    notch,
    sample,
)
from strainwave.tune.margins import (
    LoopBand,
    Margins,
    Requirements,
    join,
    margins_of,
    open_loops,
)
from strainwave.tune.plants import Plants, Resonances

MAX_RIPPLE_SHARE = 0.05
"""Largest share of the voltage limit by which one count of the encoder changes the voltage."""

_LOWEST_BANDWIDTH = 2.0  # [rad/s] of a velocity loop
_START_BANDWIDTH = 0.1  # of a velocity loop, over period and delay
_COARSE_STEP, _FINE_STEP = 1.3, 1.03  # ratios of gains in the search
_INTEGRAL_RATIO = 5.0  # bandwidth of the velocity loop over the corner of its integral part
_POSITION_RATIOS = (2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0)  # the same over the position gain
_START_POSITION_RATIO = 5.0
_LOW_PASS_RATIOS = (5.0, 10.0)  # corner of a low-pass over the bandwidth
_HIGHEST_SHARE = 0.8  # of half the sampling rate, of a filter
_NOTCH_WIDTHS, _NOTCH_DEPTH = (0.2, 0.5), 0.2
_MIN_GAIN = 1.1  # ratio of gains by which a filter must raise the bandwidth to be used
_MAX_OVERSHOOT = 0.05  # of the link after a step of the position
_N_SEARCH_DRAWS = 8
_N_SWEEPS = 2  # over the joints; a third changes gains by less than a step
_MAX_ADDED = 12  # rounds in which the worst plants join the search
_ENTRIES = 400_000  # of responses that one thread judges at a time: 40 MB
_N_CLOSED = 10  # plants whose loops are closed at a time: unstable ones often are for the first

FilterMaker = Callable[[float], tuple[Biquad, ...]]
"""Filters of a loop by its bandwidth [rad/s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Loops:
    """Sampled plants, and their responses at the frequencies at which their loops are judged.

    Responses of all plants may exceed the memory: they are computed in parts, when they are used.
    """

    plants: Plants
    clock: Clock
    resonances: Resonances  # with free motors
    sampled: SampledPlants
    responses: SampledResponses

    @classmethod
    def of(cls, plants: Plants, clock: Clock) -> Loops:
        """The loops of plants under a clock."""
        resonances = plants.resonances()
        responses = SampledResponses.of(plants, frequency_grid(resonances, clock), clock)
        return cls(plants, clock, resonances, sample(plants, clock), responses)

    @property
    def omega(self) -> FloatArray:
        """Frequencies [rad/s]."""
        return self.responses.omega

    @property
    def z(self) -> ComplexArray:
        """Points of the unit circle."""
        return np.asarray(np.exp(1j * self.omega * self.clock.period))

    def controllers(self, gains: Sequence[Gains]) -> ComplexArray:
        """Responses (n_joints, n_omega) from motor angles to minus voltages."""
        return np.stack([each.response(self.z) for each in gains])

    def judge(self, controllers: ComplexArray) -> list[tuple[Margins, LoopBand]]:
        """Margins and band of every joint's loop over all plants, the other loops closed.

        `controllers` are those of the method of that name.
        """
        n_parts = -(-len(self.plants) * self.responses.n_entries // _ENTRIES)

        def judge_part(part: IntArray) -> list[tuple[Margins, LoopBand]]:
            # bands begin with the estimates
            loops = self.open_loops(self.responses.symmetric(np.append(0, part)), controllers)
            return [
                (margins_of(each[1:], self.omega), LoopBand.of(each, self.omega)) for each in loops
            ]

        places = np.array_split(np.arange(len(self.plants)), n_parts)
        parts = run_parallel([partial(judge_part, part) for part in places])
        margins_and_bands = (zip(*pairs, strict=True) for pairs in zip(*parts, strict=True))
        bands = ("gain_db", "phase_deg", "distance")
        return [(join(m), join(b, "frequency_hz", bands)) for m, b in margins_and_bands]

    def open_loops(self, symmetric: ComplexArray, controllers: ComplexArray) -> ComplexArray:
        """Loops (n_joints, n_plants, n_omega) of plants, the other loops closed."""
        return open_loops(symmetric, self.responses.drive * controllers)


def tune_cascades(
    loops: Loops,
    required: Requirements,
    *,
    resolutions: FloatArray,
    limits: FloatArray,
) -> tuple[list[tuple[Gains, str]], list[tuple[Margins, LoopBand]]]:
    """Gains of all joints with what prevents higher gains, and what `Loops.judge` says of them.

    Higher gains are prevented by "margins" or the "encoder".

    `resolutions` (n_joints,) are counts of the motor encoders [rad], `limits` (n_joints,) are the
    largest inputs. Raises InvalidInput if no gains of a joint keep the margins.
    """
    plants, period = loops.plants, loops.clock.period
    inertias = np.median(plants.rigid_inertias(), axis=0) / plants.torque_per_volt
    with np.errstate(divide="ignore"):
        max_kp = MAX_RIPPLE_SHARE * limits * period / resolutions
    search = np.flatnonzero(plants.draw <= _N_SEARCH_DRAWS)
    tuners = [
        _Tuner(loops, required, i, float(inertia), float(largest))
        for i, (inertia, largest) in enumerate(zip(inertias, max_kp, strict=True))
    ]
    start = _START_BANDWIDTH / (period + loops.clock.delay)
    gains = [tuner.gains(start) for tuner in tuners]
    for _ in range(_N_SWEEPS):
        for i, tuner in enumerate(tuners):
            gains[i] = tuner.raise_gains(gains, search)
    for _ in range(_MAX_ADDED + 1):
        if failed := [i for i, tuner in enumerate(tuners) if not tuner.bandwidth]:
            break
        judged = loops.judge(loops.controllers(gains))
        failed = [i for i, (each, _) in enumerate(judged) if each.share(required).min() < 1.0]
        if not failed:
            return [(gains[i], tuner.limit) for i, tuner in enumerate(tuners)], judged
        worst = [int(np.argmin(judged[i][0].share(required))) for i in failed]
        search = np.union1d(search, worst)
        for i in failed:
            gains[i] = tuners[i].raise_gains(gains, search)
    joint, inertia = failed[0] + 1, plants.rigid_inertias()[:, failed[0]]
    raise InvalidInput(
        f"no gains of joint {joint} stabilise all plants with a gain margin of "
        f"{required.gain_db:g} dB, a phase margin of {required.phase_deg:g} degrees and a modulus "
        f"margin of {required.modulus:g}: the inertia at motor {joint} is {inertia.min():.3g} to "
        f"{inertia.max():.3g} kg m^2 over postures, payloads and drawn parameters",
        where="the servo design",
        remedy="--draws 0 designs for the estimates alone; or identify with narrower intervals, "
        "require smaller margins or fewer payloads, or shorten period and delay",
    )


@dataclass(slots=True)
class _Tuner:
    """Search for the gains of one joint."""

    loops: Loops
    required: Requirements
    joint: int  # from 0
    inertia: float  # [V s^2/rad] at the motor, without torsion
    max_kp: float  # [V s/rad], by the encoder
    limit: str = "margins"
    bandwidth: float = 0.0  # [rad/s] that the last search reached; zero: none keeps the margins

    def gains(self, bandwidth: float, filters: tuple[Biquad, ...] = ()) -> Gains:
        """Gains of a velocity bandwidth [rad/s]."""
        kp = bandwidth * self.inertia
        return Gains(
            kp=kp,
            ki=kp * bandwidth / _INTEGRAL_RATIO,
            position_gain=bandwidth / _START_POSITION_RATIO,
            period=self.loops.clock.period,
            filters=filters,
        )

    def raise_gains(self, gains: Sequence[Gains], search: IntArray) -> Gains:
        """The largest gains at which the searched plants keep their margins."""
        loops, joint = self.loops, self.joint
        controllers = loops.controllers(gains)
        every_loop = loops.open_loops(loops.responses.symmetric(search), controllers)
        plant = every_loop[joint] / controllers[joint]
        sampled = [
            loops.sampled.part(part)
            for part in np.array_split(search, -(-len(search) // _N_CLOSED))
        ]
        laws = [each.law() for each in gains]

        def closed(candidate: Gains) -> Iterator[ClosedLoop]:
            trial = [*laws[:joint], candidate.law(), *laws[joint + 1 :]]
            return (close(part, trial, (joint,)) for part in sampled)

        def margins(candidate: Gains) -> Margins:
            return margins_of(plant * candidate.response(loops.z), loops.omega)

        def keeps(candidate: Gains) -> bool:  # its margins, and all plants are stable
            return bool(margins(candidate).share(self.required).min() >= 1.0) and all(
                loop.are_stable(1.0).all() for loop in closed(candidate)
            )

        of_stable: IntArray | None = None

        def keeps_by_nyquist(candidate: Gains) -> bool:  # much faster, once a stable loop is known
            nonlocal of_stable
            trial = margins(candidate)
            if trial.share(self.required).min() < 1.0:
                return False
            if of_stable is None:
                if not keeps(candidate):
                    return False
                of_stable = trial.encirclements
            return bool((trial.encirclements == of_stable).all())

        def overshoot(candidate: Gains) -> float:
            steps = (Steps.of(loop, [candidate])[0] for loop in closed(candidate))
            return max(float(each.overshoot.max()) for each in steps)

        best, self.bandwidth, self.limit = gains[joint], 0.0, "margins"
        encoder = self.max_kp / self.inertia
        highest = min(encoder, 0.5 * loops.clock.nyquist)
        ratios = accumulate(repeat(_COARSE_STEP), mul, initial=_LOWEST_BANDWIDTH)
        trials = list(takewhile(lambda each: each <= highest, ratios))
        for make in self._filters(search):

            def at(bandwidth: float, make: FilterMaker = make) -> Gains:
                return self.gains(bandwidth, make(bandwidth))

            needed = self.bandwidth * _MIN_GAIN  # which few filters reach
            slower = [each for each in trials if each <= needed]
            is_kept = not slower or keeps_by_nyquist(at(slower[-1]))
            if not is_kept and any(keeps_by_nyquist(at(each)) for each in slower[-2::-1]):
                continue
            # from a trial with margins, the search ends at least as high as from the first trial
            begin = max(len(slower) - 1, 0) if is_kept else 0
            reached = _largest(lambda each: keeps_by_nyquist(at(each)), trials[begin:], highest)
            if begin and reached > needed:
                reached = _largest(lambda each: keeps_by_nyquist(at(each)), trials, highest)
            if reached > needed and not keeps(at(reached)):
                reached = _largest(lambda each: keeps(at(each)), trials, highest)
            if reached > needed:
                self.bandwidth, best = reached, at(reached)
                self.limit = "encoder" if reached * _COARSE_STEP**0.25 > encoder else "margins"
        if not self.bandwidth:
            return best
        # the largest position gain with margins and little overshoot of the link
        for ratio in _POSITION_RATIOS:
            candidate = replace(best, position_gain=self.bandwidth / ratio)
            if keeps(candidate) and overshoot(candidate) <= _MAX_OVERSHOOT:
                break
        return candidate

    def _filters(self, search: IntArray) -> Iterator[FilterMaker]:
        """No filter, a low-pass, and a notch over the spread of each resonance."""
        yield lambda _: ()
        period, highest = self.loops.clock.period, _HIGHEST_SHARE * self.loops.clock.nyquist

        def low_pass_over(ratio: float, bandwidth: float) -> tuple[Biquad, ...]:
            return (low_pass(min(ratio * bandwidth, highest) / (2.0 * np.pi), period),)

        def notch_of(frequency_hz: float, width: float, _: float) -> tuple[Biquad, ...]:
            return (notch(frequency_hz, width, _NOTCH_DEPTH, period),)

        yield from (partial(low_pass_over, ratio) for ratio in _LOW_PASS_RATIOS)
        for omega, _ in self.loops.resonances:
            low, high = float(omega[search].min()), float(omega[search].max())
            if high < highest:
                frequency_hz = float(np.sqrt(low * high)) / (2.0 * np.pi)
                yield from (
                    partial(notch_of, frequency_hz, max(width, high / low - 1.0))
                    for width in _NOTCH_WIDTHS
                )


def _largest(keeps: Callable[[float], bool], trials: Sequence[float], highest: float) -> float:
    """The largest bandwidth [rad/s] that keeps the margins, refined up to the highest; zero: none.

    It follows the first trials that keep them: arms that stand upright need some gain to be stable.
    """
    reached, step = 0.0, float(np.sqrt(_COARSE_STEP))
    for bandwidth in trials:
        if keeps(bandwidth):
            reached = bandwidth
        elif reached:
            break
    while reached and step > _FINE_STEP:
        if reached * step <= highest and keeps(reached * step):
            reached *= step
        step = float(np.sqrt(step))
    return reached
