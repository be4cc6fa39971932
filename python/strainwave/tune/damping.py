"""State feedback that damps the links: motors yield to the estimated torsions of their gears.

The velocity reference of a servo gets, with torsion e = n th - q of the observer,

    w + g_1 e + g_2 de

The observer becomes part of the control law of the joint. The gains of all joints are searched in
turn for the largest damping of the least damped mode of the links, over the plants with the least
damping and the smallest margins, while all margins are kept. They are used only if all plants are
stable and keep their margins, and if the least damping of all plants rises markedly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product

import numpy as np

from strainwave.domain import ComplexArray, ControlLaw, FloatArray, IntArray
from strainwave.domain.arm.description import MAX_LAW_STATES
from strainwave.domain.keys import JointNumber
from strainwave.numerics.parallel import run_parallel
from strainwave.tune.cascade_tuning import Loops
from strainwave.tune.closed_loop import POLE_TOLERANCE, Gains, SampledPlants, close
from strainwave.tune.margins import Margins, Requirements, margins_of
from strainwave.tune.observer import Observer

MIN_RATIO = 1.1
"""Ratio by which the feedback must raise the least damping of all plants to be used."""

# of the torsion over the frequency of the link's mode, and of its rate, both over the gear ratio
_TORSION_GAINS = (-0.8, -0.6, -0.4, -0.2, -0.1)
_RATE_GAINS = (-0.1, 0.0, 0.05, 0.1, 0.2)
_MEAN_WEIGHT = 0.2  # of the mean damping in the objective; another joint may limit the least
_LINK_BAND = 1.1  # of the highest mode of the links with held motors: slower poles are modes
_N_LEAST = 6  # plants of least damping in the search
_N_MARGINS = 3  # plants of smallest margins of each joint in the search
_MAX_ROUNDS = 3  # of searches; the worst of all plants joins the next


Pair = tuple[float, float]
Pairs = tuple[Pair, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Damping:
    """Feedback of the torsion of one joint, and the damping of the links with that of all."""

    joint: JointNumber
    gains: Pair  # of torsion [1/s] and its rate [1], at the motor; zero: not used
    reason: str  # why it is not used; empty otherwise
    # least and median over all plants of the damping ratio of the least damped mode of the links
    without: Pair
    with_feedback: Pair
    margins: Margins | None  # of the loop with the feedback; None if it is not used
    law: ControlLaw  # of the servo, with the feedback if it is used


def design_damping(
    loops: Loops,
    gains: Sequence[Gains],
    observers: Sequence[Observer],
    required: Requirements,
    margins: Sequence[Margins],
) -> tuple[Damping, ...]:
    """Feedback of the torsions of all elastic joints.

    The observers read the motor encoders alone, as control laws do. `margins` are those of the
    loops without the feedback.
    """
    if not observers:
        return ()
    laws = tuple(each.law() for each in gains)
    sizes = [len(laws[each.joint - 1].A) + len(each.names) for each in observers]
    modes = loops.plants.resonances(with_held_motors=True)
    highest = _LINK_BAND * max(float(omega.max()) for omega, _ in modes)
    search = _GainSearch(loops, laws, tuple(observers), required, highest)
    plain = search.dampings(np.arange(len(loops.plants)), search.no_feedback)
    without = _least_and_median(plain)
    if max(sizes) > MAX_LAW_STATES:
        reason = "servo, filters and observer have too many states for one control law"
        return search.unused(reason, without)
    order = [np.argsort(plain)[:_N_LEAST]]
    order += [np.argsort(each.share(required))[:_N_MARGINS] for each in margins]
    return search.best(plain, np.unique(np.concatenate(order)))


def damped_law(plain: ControlLaw, observer: Observer, gains: Pair) -> ControlLaw:
    """Law of a servo whose velocity reference yields to the observed torsion and its rate.

    The observer follows the deviation from a planned motion: it reads the motor angle less that of
    the reference, its input is the voltage without the feed-forward, and the interaction torque is
    zero. The feedback thus does not oppose the torsion of the planned motion.
    """
    n, m = len(plain.A), len(observer.A)
    correction = observer.L[:, 0]
    after = np.eye(m) - np.outer(correction, observer.C[0])  # xh = after x + L (y - r)
    row = np.array(gains) @ observer.torsion
    by_states, by_deviation = row @ after, float(row @ correction)
    deviation = np.array([-1.0, 0.0, 1.0])
    A = np.zeros((n + m, n + m))
    A[:n, :n], A[n:, n:] = plain.A, observer.A @ after
    A[:n, n:] = np.outer(plain.B[:, 1], by_states)
    through = np.outer(plain.B[:, 1], by_deviation * deviation)
    names = tuple(f"observer {name}" for name in observer.names)
    return ControlLaw(
        A=A,
        B=np.vstack([plain.B + through, np.outer(observer.A @ correction, deviation)]),
        C=np.concatenate([plain.C, plain.D[1] * by_states]),
        D=plain.D + plain.D[1] * by_deviation * deviation,
        E=np.concatenate([plain.E, observer.B[:, 0]]),
        holds=np.concatenate([plain.holds, np.zeros(m, dtype=bool)]),
        names=(*plain.names, *names),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _GainSearch:
    """Search of the gains of all joints."""

    loops: Loops
    plain: tuple[ControlLaw, ...]
    observers: tuple[Observer, ...]
    required: Requirements
    highest: float  # [rad/s] of the poles that count as modes of the links
    # (n_plants,) by gains: known results of `dampings`, otherwise not a number
    ratios: dict[Pairs, FloatArray] = field(default_factory=dict)

    def unused(self, reason: str, without: Pair) -> tuple[Damping, ...]:
        same = (0.0, 0.0), reason, without, without, None
        return tuple(Damping(one.joint, *same, self.plain[one.joint - 1]) for one in self.observers)

    def best(self, plain: FloatArray, chosen: IntArray) -> tuple[Damping, ...]:
        """The results with the best gains; `chosen` are the first plants of the search.

        `plain` (n_plants,) are the damping ratios without the feedback.
        """
        without = _least_and_median(plain)
        every, reason = np.arange(len(self.loops.plants)), ""
        for _ in range(_MAX_ROUNDS):
            laws = self.laws(pairs := self._climb(chosen))
            ratios = self.dampings(every, pairs)
            reached, searched = _least_and_median(ratios), chosen
            if reached[0] < MIN_RATIO * without[0]:
                reason = (
                    f"it changes the least damping ratio of all plants from {without[0]:.3g} to "
                    f"{reached[0]:.3g} only"
                )
                chosen = np.union1d(chosen, np.argsort(ratios)[:_N_LEAST])
            else:
                margins = [each for each, _ in self.loops.judge(self.feedbacks(laws))]
                shares = np.min([each.share(self.required) for each in margins], axis=0)
                if shares.min() >= 1.0:
                    break
                reason = "not all plants keep their margins with it"
                chosen = np.union1d(chosen, np.argsort(shares)[:_N_MARGINS])
            if len(chosen) == len(searched):  # the next search would end in the same gains
                return self.unused(reason, without)
        else:
            return self.unused(reason, without)
        results = []
        for one, pair in zip(self.observers, pairs, strict=True):
            i, is_used = one.joint - 1, any(pair)  # with gains of zero a joint keeps its servo
            reason = "" if is_used else "its feedback does not damp the links further"
            own, gains = margins[i] if is_used else None, _scaled(one, pair)
            results.append(Damping(one.joint, gains, reason, without, reached, own, laws[i]))
        return tuple(results)

    @property
    def no_feedback(self) -> Pairs:
        """Gains of zero."""
        return ((0.0, 0.0),) * len(self.observers)

    def _climb(self, chosen: IntArray) -> Pairs:
        """Gains of all joints with the largest objective over some plants, joint by joint."""

        def objective_of(pairs: Pairs) -> float:
            ratios = self.dampings(chosen, pairs)
            return float(ratios.min() + _MEAN_WEIGHT * ratios.mean())

        symmetric, omega = self.loops.responses.symmetric(chosen), self.loops.omega

        def keeps(pairs: Pairs) -> bool:  # its margins
            loops = self.loops.open_loops(symmetric, self.feedbacks(self.laws(pairs)))
            margins = (margins_of(each, omega) for each in loops)
            return all(each.share(self.required).min() >= 1.0 for each in margins)

        pairs = self.no_feedback
        largest = objective_of(pairs)
        for k in range(len(self.observers)):
            trials = [
                (*pairs[:k], pair, *pairs[k + 1 :]) for pair in product(_TORSION_GAINS, _RATE_GAINS)
            ]
            objectives = run_parallel([partial(objective_of, trial) for trial in trials])
            for trial, objective in zip(trials, objectives, strict=True):
                if objective > largest and keeps(trial):
                    pairs, largest = trial, objective
        return pairs

    def laws(self, pairs: Pairs) -> list[ControlLaw]:
        laws = list(self.plain)
        for one, pair in zip(self.observers, pairs, strict=True):
            if any(pair):
                laws[one.joint - 1] = damped_law(laws[one.joint - 1], one, _scaled(one, pair))
        return laws

    def dampings(self, chosen: IntArray, pairs: Pairs) -> FloatArray:
        """Damping ratio of the least damped mode of the links: (n_chosen,); -1 if unstable."""
        period, laws = self.loops.clock.period, self.laws(pairs)
        ratios = self.ratios.setdefault(pairs, np.full(len(self.loops.plants), np.nan))

        def of_part(part: SampledPlants) -> FloatArray:
            poles = close(part, laws).poles()
            rates = np.log(np.where(poles == 0.0, 1e-300, poles)) / period
            omega = np.abs(rates)
            is_mode = (rates.imag > 0.0) & (omega < self.highest)
            ratios = np.where(is_mode, -rates.real / np.maximum(omega, 1e-300), 1.0).min(axis=1)
            largest = np.abs(poles).max(axis=1)
            return np.where(largest < 1.0 + POLE_TOLERANCE, ratios, -1.0)

        if len(unknown := chosen[np.isnan(ratios[chosen])]):
            ratios[unknown] = np.concatenate(self.loops.sampled.part(unknown).map(of_part))
        return ratios[chosen]

    def feedbacks(self, laws: Sequence[ControlLaw]) -> ComplexArray:
        """Responses (n_joints, n_omega) from motor angles to minus voltages."""
        return np.stack([each.feedback(self.loops.z) for each in laws])


def _least_and_median(ratios: FloatArray) -> Pair:
    return float(ratios.min()), float(np.median(ratios))


def _scaled(observer: Observer, pair: Pair) -> Pair:
    """Gains of torsion [1/s] and rate at the motor from a pair without scale."""
    scale = 1.0 / observer.gear_ratio
    return pair[0] * observer.mode * scale, pair[1] * scale
