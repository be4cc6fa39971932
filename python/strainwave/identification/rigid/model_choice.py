"""Which further terms a rigid model has, and what doubt about them adds to its intervals.

A term enters if it improves the prediction of stretches that the fit does not use. Terms that stay
out make plausible models: their change of the estimates, weighted by their prediction, is model
error, as far as it exceeds what the same data explain.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray
from strainwave.domain.arm.effects import OF_RIGID_JOINTS, effect_named
from strainwave.domain.results.estimates import physical_range
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import DELAY, TORSION, ZERO
from strainwave.identification.rigid.conclusion import MAX_NEGLIGIBLE_SHARE, has_zero_bound
from strainwave.identification.rigid.equations import ALL_JOINTS, FurtherTerm, assemble
from strainwave.identification.rigid.filtered_record import FilteredRecord, n_compliances
from strainwave.identification.rigid.submodels import Submodels
from strainwave.identification.rigid.trial import Trial
from strainwave.numerics import least_squares as ls
from strainwave.numerics.statistics import MIN_WEIGHT, model_weights

STRIBECK, POWER = "stribeck", "power-friction"

MIN_STDS = 4.5
"""Standard deviations from which a term is shown.

One of 80 candidates exceeds them by chance in 2 % of all fits with 20 blocks (Student's t).
"""

# Stribeck velocities over the largest velocity of the joint; below, the encoder hides the effect
_STRIBECK_VELOCITIES = (0.03, 0.06, 0.12, 0.25)
# largest speed [rad/s] of a motor below which (S16) is nearly viscous friction
_MIN_POWER_SPEED = 3.0
# by which a logged torque leads the motion: half a sample by its hold, one by the order of the log;
# on measured arms, greater leads within a record mispredict faster motions
_MAX_LEAD_SAMPLES = 1.5
_GAIN_STD = 0.3  # prior standard deviation of the relative error of a torque constant


def candidates_of(arm: Arm, stretches: Sequence[FilteredRecord]) -> list[FurtherTerm]:
    """Terms that the joints of an arm with rigid gears may have, as the study allows.

    Joints that stay at rest have none.
    """
    if n_compliances(arm):
        return []
    velocities = [np.abs(s.signals.motor_velocity).max(axis=0) for s in stretches]
    largest = np.max(velocities, axis=0)
    speeds = [np.mean(np.abs(s.signals.motor_velocity), axis=0) for s in stretches]
    slides = np.any([np.any(s.signals.direction != 0.0, axis=0) for s in stretches], axis=0)
    (exponent,) = effect_named(POWER).shapes.values()
    shapes: Mapping[str, Sequence[FloatArray]] = {
        STRIBECK: [share * largest for share in _STRIBECK_VELOCITIES],
        "direction-friction": [np.mean(speeds, axis=0)],
        POWER: [np.full(arm.n_joints, exponent)],
    }
    effects = [
        [name for name in OF_RIGID_JOINTS if joint.selects_effects or name in joint.named_effects]
        for joint in arm.joints
    ]
    of_joints = [
        FurtherTerm(effect, i, float(shape[i]))
        for i in range(arm.n_joints)
        for effect in effects[i]
        for shape in shapes.get(effect, [np.ones(arm.n_joints)])
        if slides[i] and effect != DELAY
        if effect != ZERO or arm.gravity_size > 0.0
        if effect != POWER or largest[i] > _MIN_POWER_SPEED
        if effect != TORSION or arm.joints[i].torque_at_link
    ]
    is_delayed = any(DELAY in names for names in effects)
    return [*of_joints, FurtherTerm(DELAY, ALL_JOINTS)] if is_delayed else of_joints


def is_selected(arm: Arm, candidate: FurtherTerm) -> bool:
    """Whether the data decide about a candidate.

    Otherwise the study names it, or it corrects the signals because the residuals halve with it.
    """
    if candidate.corrected:
        return False
    i = candidate.joint
    joints = arm.joints if i == ALL_JOINTS else arm.joints[i : i + 1]
    return any(joint.selects_effects for joint in joints)


@dataclass(frozen=True)
class ModelChoice:
    """Models of a trial with any of the candidates."""

    trial: Trial
    candidates: tuple[FurtherTerm, ...]  # columns of their sizes, of shapes and of gains follow
    models: Submodels

    @staticmethod
    def of(trial: Trial, candidates: Sequence[FurtherTerm]) -> ModelChoice:
        """Linearise the candidates, and errors of the torque constants, at a trial.

        The terms of the trial precede the candidates.
        """
        arm = trial.arm
        taken = {c.key for c in trial.candidates}
        rest = [c for c in candidates if c.key not in taken]
        candidates = [*trial.candidates, *rest]
        equations = assemble(arm, trial.stretches, trial.estimate, candidates)
        if arm.n_joints > 1:
            equations = _with_gains(equations, trial, len(trial.candidates))
        return ModelChoice(trial, tuple(candidates), Submodels(trial, equations))

    def with_shapes(self, terms: Sequence[int]) -> list[int]:
        """Columns of the sizes and of the estimated shapes of some candidates."""
        estimated = [k for k, c in enumerate(self.candidates) if c.size is not None]
        n = len(self.candidates)
        return [*terms, *(n + at for at, k in enumerate(estimated) if k in terms)]

    def is_possible(self, terms: Sequence[int]) -> bool:
        """Whether the terms make no size and no parameter impossible that is possible without.

        A negative value is impossible if its interval, or that without the terms, excludes zero.
        """
        solution, own = self.models.solution(terms), self.trial.solution
        columns = self.trial.arm.rigid_columns
        negative = [
            k for k, c in enumerate(columns) if solution[k] < 0.0 and has_zero_bound(c.name)
        ]
        if negative:
            width = self.trial.interval_half_width
            upper = solution + width * np.sqrt(np.diag(self.covariance(terms)))
            half = width * self.trial.standard_deviations
            is_certain = (own > half) | ((upper < 0.0) & (own > -half) & self.trial.determined)
            if is_certain[negative].any():
                return False
        of_terms = zip(terms, self.models.sizes(terms).tolist(), strict=True)
        return all(
            self.candidates[k].corrected + size > self._least(self.candidates[k].effect)
            for k, size in of_terms
        )

    def _least(self, effect: str) -> float:
        """Lower limit of the size of an effect."""
        if effect == DELAY:
            sample_times = [s.signals.sample_time for s in self.trial.stretches]
            return -_MAX_LEAD_SAMPLES * max(sample_times)
        return -np.inf if physical_range(effect_named(effect).sizes[0]) == "any" else 0.0

    def covariance(self, terms: Sequence[int]) -> FloatArray:
        """Jackknife covariance of the parameters in a model."""
        shifts = self.models.shifts(terms)
        return np.asarray((len(shifts) - 1) / len(shifts) * shifts.T @ shifts)

    def is_determined(self, terms: Sequence[int]) -> BoolArray:
        """Whether the interval of each parameter is narrower than its value, or negligible."""
        half = self.trial.interval_half_width * np.sqrt(np.diag(self.covariance(terms)))
        factor = self.trial.factor
        torque = float(np.linalg.norm(factor.root * self.trial.equations.target))
        is_negligible = half * factor.scale < MAX_NEGLIGIBLE_SHARE * torque
        is_narrow = half < np.abs(self.models.solution(terms))
        return np.asarray((is_narrow | is_negligible) & self.trial.determined)

    def select(self, left_out: Collection[tuple[str, int]] = ()) -> list[FurtherTerm]:
        """Terms of the trial, those that the study names, and those that improve the prediction.

        A term enters in addition to those of its joint, or in place of one: a term that resembles
        a missing one would keep it out. `left_out` are effects and joints that do not enter.
        """
        chosen = list(range(len(self.trial.candidates)))
        for same in self._rivals(chosen):
            first = self.candidates[same[0]]
            if first.corrected or not is_selected(self.trial.arm, first):
                chosen.append(max(same, key=lambda k: self._total([*chosen, k])))
        has_changed = True
        while has_changed:
            has_changed, changed_joints, total = False, set[int](), self._total(chosen)
            moves = self._moves(chosen, left_out)
            totals = {move: self._total(_moved(chosen, *move)) for move in moves}
            better = (move for move in totals if totals[move] > total)
            for move in sorted(better, key=lambda move: -totals[move]):
                model, joint = _moved(chosen, *move), self.candidates[move[1]].joint
                if joint not in changed_joints and self._improves(chosen, model):
                    chosen, has_changed = model, True
                    changed_joints.add(joint)
        return [self.candidates[k] for k in chosen]

    def _moves(
        self, chosen: Sequence[int], left_out: Collection[tuple[str, int]]
    ) -> Iterator[tuple[int | None, int]]:
        """Terms that may enter a model, each alone and with a term that it replaces."""
        for same in self._rivals(chosen):
            new = self.candidates[same[0]]
            if new.key not in left_out:
                others = (k for k in chosen if self.candidates[k].joint == new.joint)
                replaced = [k for k in others if is_selected(self.trial.arm, self.candidates[k])]
                yield from itertools.product([None, *replaced], same)

    def _improves(self, chosen: Sequence[int], model: Sequence[int]) -> bool:
        """Whether the last term of a model is significant, and the model the better one.

        It predicts held-out stretches better, and leaves all values possible and determined.
        """
        size, std = float(self.models.sizes(model)[-1]), float(self.models.size_stds(model)[-1])
        return (
            abs(size) > MIN_STDS * std
            and self._total(model) > self._total(chosen)
            and self.is_possible(model)
            and not np.any(self.is_determined(chosen) & ~self.is_determined(model))
        )

    def model_error(self) -> FloatArray:
        """Variance (n_parameters, n_parameters) between the trial's model and plausible rivals.

        The rivals have one term of a joint less, one or two more, or other torque constants. Their
        weights are those of held-out prediction. Of a change, the excess over its interval from the
        same blocks counts: a term of no effect changes the estimates as well.
        """
        rng = np.random.default_rng(0)
        total = np.zeros_like(self.trial.covariance)
        chosen = self.with_shapes(range(len(self.trial.candidates)))
        solution, shifts = self.models.solution(chosen), self.models.shifts(chosen)
        n = len(shifts)
        for family in self._families(list(range(len(self.trial.candidates)))):
            scores = np.array([self.models.scores(model) for model in (chosen, *family)])
            for weight, model in zip(model_weights(scores, rng)[1:], family, strict=True):
                if weight < 1.0 - MIN_WEIGHT:  # beyond a 95 % interval
                    continue
                change = self.models.solution(model) - solution
                moved = self.models.shifts(model) - shifts
                variance = (n - 1) / n * np.sum(moved**2, axis=0)
                expected = self.trial.interval_half_width**2 * variance
                excess = np.sign(change) * np.sqrt(np.clip(change**2 - expected, 0.0, None))
                total += weight * np.outer(excess, excess)
        return total

    def changes(self) -> list[dict[str, float]]:
        """Changes of the values by each term of the trial, if beyond the standard deviations."""
        every = list(range(len(self.trial.candidates)))
        solution = self.models.solution(self.with_shapes(every))
        stds, columns = self.trial.standard_deviations, self.trial.arm.rigid_columns
        result = []
        for left in every:
            model = self.with_shapes([k for k in every if k != left])
            change = solution - self.models.solution(model)
            at = np.flatnonzero((np.abs(change) > stds) & self.trial.determined)
            result.append({columns[k].label: float(change[k]) for k in at})
        return result

    def noise_share(self) -> FloatArray:
        """Share (n_parameters,) of the trial's variances that does not repeat with the motion."""
        return self.models.noise_share(self.with_shapes(range(len(self.trial.candidates))))

    def _families(self, chosen: list[int]) -> Iterator[list[list[int]]]:
        """Rivals of a model that explain the same: terms of one joint, or torque constants."""
        joint_of = [c.joint for c in self.candidates]
        n_joints = self.trial.arm.n_joints
        for joint in range(n_joints):
            models = [
                [k for k in chosen if k != left] for left in chosen if joint_of[left] == joint
            ]
            added = [
                max(([*chosen, k] for k in same), key=self._total)
                for same in self._rivals(chosen)
                if joint_of[same[0]] == joint
            ]
            added = [m for m in added if self.is_possible(m)]
            models += [*added, *self._pairs(added)]
            yield [self.with_shapes(model) for model in models]
        if n_joints > 1:
            first = self.models.equations.common.shape[1] - n_joints
            yield [[*self.with_shapes(chosen), first + joint] for joint in range(n_joints)]

    def _pairs(self, added: Sequence[list[int]]) -> list[list[int]]:
        """Best pair of each last term of some models, if it predicts better than both alone.

        Two terms may predict better only together, as those of load and speed.
        """
        totals = {m[-1]: self._total(m) for m in added}
        pairs: dict[frozenset[int], list[int]] = {}
        for model in added:
            others = [[*model, k] for k in totals if k != model[-1]]
            pair = max(others, key=self._total, default=model)
            alone = max(totals[k] for k in pair[-2:] if k in totals)
            if self._total(pair) > alone and self.is_possible(pair):
                pairs[frozenset(pair)] = pair
        return list(pairs.values())

    def _rivals(self, chosen: Sequence[int]) -> list[list[int]]:
        """Candidates that a model lacks, those of one effect and joint together.

        Without those that the data cannot show, unless the study names them.
        """
        taken = {self.candidates[k].key for k in chosen}
        groups: dict[tuple[str, int], list[int]] = {}
        for k, c in enumerate(self.candidates):
            is_named = not is_selected(self.trial.arm, c)
            if c.key not in taken and (self.models.is_visible[k] or is_named):
                groups.setdefault(c.key, []).append(k)
        return list(groups.values())

    def _total(self, terms: Sequence[int]) -> float:
        return float(np.sum(self.models.scores(terms)))


def _moved(terms: Sequence[int], left: int | None, entering: int) -> list[int]:
    return [*(k for k in terms if k != left), entering]


def _with_gains(equations: ls.Equations, trial: Trial, n_terms: int) -> ls.Equations:
    """Equations with the relative error of each joint's torque constant as a further unknown.

    Its column is the torque of the model. A second pass takes that of the model with the errors:
    only then do those of two joints fit alike if both have the same ratio.
    """
    group, n_joints = equations.group, trial.arm.n_joints
    residual = ls.residual_of(trial.equations, trial.factor)
    for _ in range(2):
        torque = equations.target - residual
        gains = torque[:, None] * (group[:, None] == np.arange(n_joints))
        extended = replace(
            equations,
            common=np.hstack([equations.common, gains]),
            common_deviation=np.append(equations.common_deviation, np.full(n_joints, _GAIN_STD)),
        )
        own = replace(
            extended,
            common=extended.common[:, [*range(n_terms), *range(-n_joints, 0)]],
            common_deviation=extended.common_deviation[[*range(n_terms), *range(-n_joints, 0)]],
        )
        factor = ls.factorise(own, trial.factor.root)
        residual = ls.residual_of(own, factor) + gains @ factor.common[n_terms:]
    return extended
