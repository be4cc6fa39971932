"""Gains of PI velocity loops and position loops: the largest bandwidth that keeps the margins.

Joint by joint, with the loops of the other joints closed, gains are raised until the first plant
violates a margin. The search uses a few plants; all plants are then checked, and the worst is added
to the search until all keep their margins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, IntArray
from strainwave.servo_design.closed_loop import Steps, close, sample
from strainwave.servo_design.control_law import Biquad, Gains, low_pass, notch
from strainwave.servo_design.margins import Margins, Requirements, effective_plants, margins_of
from strainwave.servo_design.plants import Plants
from strainwave.servo_design.sampling import Clock, frequency_grid, sampled_responses

_LOWEST_BANDWIDTH = 2.0  # [rad/s] of a velocity loop
_COARSE_STEP, _FINE_STEP = 1.3, 1.03  # ratios of gains in the search
_INTEGRAL_RATIO = 5.0  # bandwidth of the velocity loop over the corner of its integral part
_POSITION_RATIOS = (2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0)  # the same over the position gain
_START_POSITION_RATIO = 5.0
_LOW_PASS_RATIOS = (5.0, 10.0)  # corner of a low-pass over the bandwidth
_NOTCH_WIDTHS, _NOTCH_DEPTH = (0.2, 0.5), 0.2
_MIN_GAIN = 1.1  # ratio of gains by which a filter must raise the bandwidth to be used
_MAX_RIPPLE_SHARE = 0.02  # of the voltage limit, by one count of the encoder
_MAX_OVERSHOOT = 0.05  # of the link after a step of the position
_N_SEARCH_DRAWS = 8
_N_SWEEPS = 2  # over the joints; a third changes gains by less than a step
_MAX_ADDED = 12  # rounds in which the worst plants join the search


FilterMaker = Callable[[float], tuple[Biquad, ...]]
"""Filters of a loop by its bandwidth [rad/s]."""


@dataclass(frozen=True, slots=True, eq=False)
class TunedJoint:
    """Gains of one joint and the margins of all plants."""

    gains: Gains
    margins: Margins
    limit: str  # what prevents higher gains: "margins" or "encoder"


@dataclass(frozen=True, slots=True, eq=False)
class Loops:
    """Sampled plants at the frequencies at which loops are judged."""

    plants: Plants
    clock: Clock
    omega: FloatArray
    responses: ComplexArray  # (n_plants, n_omega, n_joints, n_joints)

    @classmethod
    def of(cls, plants: Plants, clock: Clock) -> Loops:
        """The responses of plants under a clock."""
        omega = frequency_grid(plants, clock)
        return cls(plants, clock, omega, sampled_responses(plants, omega, clock))

    @property
    def z(self) -> ComplexArray:
        """Points of the unit circle."""
        return np.asarray(np.exp(1j * self.omega * self.clock.period))

    def controllers(self, gains: Sequence[Gains]) -> ComplexArray:
        """Responses (n_omega, n_joints) from motor angles to minus voltages."""
        return np.stack([each.response(self.z) for each in gains], axis=1)

    def margins(self, gains: Sequence[Gains]) -> list[Margins]:
        """Margins of every joint's loop over all plants, the other loops closed."""
        closed = self.controllers(gains)
        return [
            margins_of(effective_plants(self.responses, closed, i) * closed[:, i], self.omega)
            for i in range(len(gains))
        ]


def tune_cascades(
    loops: Loops,
    required: Requirements,
    *,
    resolutions: FloatArray,
    limit: float,
    uses_filters: bool = True,
) -> list[TunedJoint]:
    """Gains of all joints.

    `resolutions` (n_joints,) are counts of the motor encoders [rad], `limit` is the largest voltage.
    Without `uses_filters` the loops have gains only.
    """
    plants, period = loops.plants, loops.clock.period
    inertias = np.median(plants.rigid_inertias(), axis=0) / plants.torque_per_volt
    with np.errstate(divide="ignore"):
        max_kp = _MAX_RIPPLE_SHARE * limit * period / resolutions
    search = np.flatnonzero(plants.draw <= _N_SEARCH_DRAWS)
    tuners = [
        _Tuner(loops, required, i, float(inertia), float(largest), uses_filters)
        for i, (inertia, largest) in enumerate(zip(inertias, max_kp, strict=True))
    ]
    gains = [tuner.gains(_LOWEST_BANDWIDTH, _START_POSITION_RATIO) for tuner in tuners]
    for _ in range(_N_SWEEPS):
        for i, tuner in enumerate(tuners):
            gains[i] = tuner.raise_gains(gains, search)
    for _ in range(_MAX_ADDED):
        margins = loops.margins(gains)
        short = [i for i, each in enumerate(margins) if each.share(required).min() < 1.0]
        if not short:
            break
        search = np.union1d(search, [margins[i].worst(required) for i in short])
        for i in short:
            gains[i] = tuners[i].raise_gains(gains, search)
    return [
        TunedJoint(each, of_joint, tuner.limit)
        for each, of_joint, tuner in zip(gains, margins, tuners, strict=True)
    ]


@dataclass(slots=True)
class _Tuner:
    """Search for the gains of one joint."""

    loops: Loops
    required: Requirements
    joint: int  # from 0
    inertia: float  # [V s^2/rad] at the motor, without torsion
    max_kp: float  # [V s/rad], by the encoder
    uses_filters: bool
    limit: str = "margins"

    def gains(
        self, bandwidth: float, position_ratio: float, filters: tuple[Biquad, ...] = ()
    ) -> Gains:
        """Gains of a velocity bandwidth [rad/s]."""
        kp = bandwidth * self.inertia
        return Gains(
            kp=kp,
            ki=kp * bandwidth / _INTEGRAL_RATIO,
            position_gain=bandwidth / position_ratio,
            period=self.loops.clock.period,
            filters=filters,
        )

    def raise_gains(self, gains: Sequence[Gains], search: IntArray) -> Gains:
        """The largest gains at which the searched plants keep their margins."""
        closed = self.loops.controllers(gains)
        plant = effective_plants(self.loops.responses[search], closed, self.joint)
        best, bandwidth, self.limit = gains[self.joint], 0.0, "margins"
        for make in self._filters(search):
            reached, is_encoder = self._largest_bandwidth(plant, make)
            if reached > bandwidth * (_MIN_GAIN if bandwidth else 1.0):
                bandwidth, self.limit = reached, "encoder" if is_encoder else "margins"
                best = self.gains(reached, _START_POSITION_RATIO, make(reached))
        return self._set_position_gain(best, bandwidth, plant, gains, search)

    def _largest_bandwidth(self, plant: ComplexArray, make: FilterMaker) -> tuple[float, bool]:
        """The largest bandwidth [rad/s] with margins, and whether the encoder limits it."""
        highest = self.max_kp / self.inertia
        bandwidth, step = _LOWEST_BANDWIDTH, _COARSE_STEP
        while step > _FINE_STEP:
            trial = bandwidth * step
            if trial <= min(highest, 0.5 * self.loops.clock.nyquist) and self._keeps(
                plant, self.gains(trial, _START_POSITION_RATIO, make(trial))
            ):
                bandwidth = trial
            else:
                step = np.sqrt(step)
        return bandwidth, bandwidth * _COARSE_STEP**0.25 > highest

    def _keeps(self, plant: ComplexArray, gains: Gains) -> bool:
        """Whether all plants keep their margins."""
        loop = plant * gains.response(self.loops.z)
        return bool(margins_of(loop, self.loops.omega).share(self.required).min() >= 1.0)

    def _filters(self, search: IntArray) -> Iterator[FilterMaker]:
        """No filter, a low-pass, and a notch over the spread of each resonance."""
        period, nyquist = self.loops.clock.period, self.loops.clock.nyquist
        yield lambda _: ()
        if not self.uses_filters:
            return
        for ratio in _LOW_PASS_RATIOS:
            yield lambda bandwidth, ratio=ratio: (
                low_pass(min(ratio * bandwidth, 0.8 * nyquist) / (2.0 * np.pi), period),
            )
        for omega, _ in self.loops.plants.resonances():
            low, high = omega[search].min(), omega[search].max()
            for width in _NOTCH_WIDTHS:
                if high < 0.8 * nyquist:
                    hz, wide = np.sqrt(low * high) / (2.0 * np.pi), max(width, high / low - 1.0)
                    yield lambda _, hz=hz, wide=wide: (notch(hz, wide, _NOTCH_DEPTH, period),)

    def _set_position_gain(
        self,
        gains: Gains,
        bandwidth: float,
        plant: ComplexArray,
        others: Sequence[Gains],
        search: IntArray,
    ) -> Gains:
        """The largest position gain with margins and little overshoot of the link."""
        sampled = sample(self.loops.plants, self.loops.clock, search)
        for ratio in _POSITION_RATIOS:
            candidate = replace(gains, position_gain=bandwidth / ratio)
            if not self._keeps(plant, candidate):
                continue
            laws = [each.law() for each in others]
            laws[self.joint] = candidate.law()
            steps = Steps.of(close(sampled, laws, self.joint), self.loops.clock.period)
            if steps.overshoot.max() <= _MAX_OVERSHOOT:
                return candidate
        return replace(gains, position_gain=bandwidth / _POSITION_RATIOS[-1])
