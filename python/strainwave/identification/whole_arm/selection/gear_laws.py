"""Selection of the elastic law of gears with `spring = "auto"`.

All gears are linear at first. A score test of the cubic term decides which of them are worth fits
of stiffness curves. The held-out prediction decides between the laws.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Diagnostic, LawChoice, LawMargin, Place
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.effects import STIFFNESS_CURVE
from strainwave.domain.gear_laws import AUTO, STIFFNESS, curved_laws, stated_law
from strainwave.domain.gear_laws.laws import CUBIC
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.whole_arm.inference.held_out import held_out_scores, simplest_model
from strainwave.identification.whole_arm.inference.score_tests import TestedEffect, curve_tests_of
from strainwave.identification.whole_arm.problem.arm_unknowns import replace_stiffness
from strainwave.identification.whole_arm.problem.effect_unknowns import with_effects
from strainwave.identification.whole_arm.problem.restrictions import limit_unknown
from strainwave.identification.whole_arm.records.loads import gear_torques
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import resumed_coarse_search
from strainwave.identification.whole_arm.selection.candidate import (
    MAX_CANDIDATE_EVALUATIONS,
    Selection,
    run_trial,
)
from strainwave.identification.whole_arm.selection.stiffness_curves import restart_coarse_fit
from strainwave.numerics.held_out import weight_over

MAX_HIDDEN_CHANGE = 0.1
"""Relative change of the stiffness up to the largest torque, by its 95 % bound, from which one
stiffness is reported as an equivalent one. The slopes of strain-wave gears differ by more."""

_REFERENCE_LOAD = 0.5  # over the largest gear torque; the secant stiffness there starts a line

LINEAR = stated_law(AUTO).name


def select_gear_laws(fit: Fit, selection: Selection) -> Fit:
    """The coarse fit with the simplest gear laws that predict as well as any.

    Sets the laws of the arm of `selection`, and its choices.
    """
    automatic = {i for i, joint in enumerate(selection.arm.joints, start=1) if joint.selects_law}
    selection.arm = selection.arm.with_selected_laws(())
    selection.law_choices = {joint: LawChoice(joint, LINEAR) for joint in automatic}
    free = {joint for joint in automatic if (STIFFNESS, joint) in fit.space.keys}
    if not free:
        return fit
    trials = _Trials(fit, selection)
    while free and not selection.has_ended(fit):
        tested = curve_tests_of(fit, selection.arm, free)
        for one in tested:
            joint = one.named_effect[0]
            choice = selection.law_choices[joint]
            selection.law_choices[joint] = replace(choice, gain=one.gain, limit=one.limit)
        curved = [one.named_effect[0] for one in tested if one.is_promising]
        if not curved:
            break
        free.difference_update(curved)
        fit = trials.choose(fit, curved)
    return fit


class _Trials:
    """Fits with other gear laws than those of a linear fit."""

    def __init__(self, linear: Fit, selection: Selection) -> None:
        self.linear = linear
        self.selection = selection
        self.largest_torque = gear_torques(linear.objective.records, linear.values)
        self.iterations = linear.iterations

    def choose(self, fit: Fit, joints: Sequence[int]) -> Fit:
        """The fit with the laws selected for some joints, whose law in `fit` is linear.

        The joints first have the same law, then each has others while the rest keep theirs.
        """
        together = self._fits(fit, joints, [law.name for law in curved_laws()])
        if not together:
            return fit
        scores = held_out_scores(list(together.values())).sum(axis=1)
        best = list(together)[int(np.argmax(scores))]
        current = together[best]
        self.selection.arm = self._arm(joints, best)
        for joint in joints:
            law = self.selection.arm.joints[joint - 1].law.name
            rivals = together | {LINEAR: fit} if len(joints) == 1 else {law: current}
            others = [name for name in (LINEAR, *together) if name not in rivals]
            rivals |= self._fits(current, [joint], others, MAX_CANDIDATE_EVALUATIONS)
            choice = _select(joint, rivals)
            law, earlier = choice.law, self.selection.law_choices[joint]
            self.selection.law_choices[joint] = replace(earlier, law=law, margins=choice.margins)
            self.selection.arm, current = self._arm([joint], law), rivals[law]
        if not any(self.selection.arm.joints[joint - 1].law.is_curved for joint in joints):
            current = fit
        return replace(current, iterations=self.iterations)

    def _arm(self, joints: Sequence[int], law: str) -> Arm:
        """The arm with another law of some joints."""
        arm = self.selection.arm
        for joint in joints:
            arm = arm.with_joint(joint, spring=law)
        return arm

    def _fits(
        self,
        start: Fit,
        joints: Sequence[int],
        laws: Sequence[str],
        max_evaluations: int | None = None,
    ) -> dict[str, Fit]:
        """Fits with other laws of some joints, without those that cannot be simulated.

        `max_evaluations` limits the evaluations of each; None allows a whole coarse search.
        """
        fits = {}
        for law in laws:
            try:
                fits[law] = self._fit(start, joints, law, max_evaluations)
            except (InvalidInput, NotIdentifiable, NumericalFailure):
                continue
        return fits

    def _fit(self, start: Fit, joints: Sequence[int], law: str, max_evaluations: int | None) -> Fit:
        arm, options = self._arm(joints, law), self.selection.options
        values = self.linear.values | start.values | self._secants(start, joints)
        space, z = replace_stiffness(self.linear.space, arm, values, self.largest_torque.tolist())
        known = set(self.linear.space.keys)
        unknowns = tuple(
            unknown if unknown.key in known else limit_unknown(unknown, options, at)
            for unknown, at in zip(space.unknowns, z.tolist(), strict=True)
        )
        space = replace(space, unknowns=unknowns)
        own = Selection(
            arm, replace(options, max_iterations=self.iterations + self.selection.budget)
        )
        restart = start.restart(with_effects(start.objective, space, arm), z)
        restart = replace(restart, iterations=self.iterations)
        if max_evaluations is None:
            found = resumed_coarse_search(restart, own.options)
        else:
            found = run_trial(restart, own, max_evaluations)
        found = restart_coarse_fit(found, own)
        self.iterations = found.iterations
        self.selection.allow(self.iterations + self.selection.budget)
        return found

    def _secants(self, fit: Fit, joints: Sequence[int]) -> Values:
        """Stiffness of the line through a torque of the curve of each joint."""
        values, secants = fit.values, Values()
        for joint in joints:
            law = self.selection.arm.joints[joint - 1].law
            torque = _REFERENCE_LOAD * self.largest_torque[[joint - 1]]
            torsion = law.torsion(law.of_joint(values, joint), torque)
            secants[STIFFNESS, joint] = float((torque / torsion)[0])
        return secants


def _select(joint: int, rivals: Mapping[str, Fit]) -> LawChoice:
    """The law with the fewest parameters unless one with more predicts better."""
    names = list(rivals)
    chosen = simplest_model([rivals[name] for name in names])
    scores = held_out_scores([rivals[name] for name in names])

    def margin(k: int, other: int) -> LawMargin:
        difference = float(np.sum(scores[k] - scores[other]))
        weight = weight_over(scores[k], scores[other], np.random.default_rng(0))
        return LawMargin(names[other], difference, weight)

    others = (k for k in range(len(names)) if k != chosen)
    return LawChoice(joint, names[chosen], tuple(margin(chosen, k) for k in others))


def equivalent_stiffnesses(
    tests: Sequence[TestedEffect], fit: Fit, selection: Selection, largest_torque: Sequence[float]
) -> Iterator[Diagnostic]:
    """Warn about a linear law that was selected although the records allow a considerable curve.

    `tests` are those of the effects that `fit` lacks, `largest_torque` [N m] is that of each gear.
    """
    for test in tests:
        number, effect = test.named_effect
        choice, joint = selection.law_choices.get(number), selection.arm.joints[number - 1]
        if choice is None or choice.law != LINEAR or effect != STIFFNESS_CURVE.name:
            continue
        torque, stiffness = largest_torque[number - 1], fit.values[STIFFNESS, number]
        cubic = abs(test.sizes[CUBIC]) + CI95_STDS * test.stds[CUBIC]
        change = 3.0 * cubic * (torque / stiffness) ** 2 / stiffness
        if change > MAX_HIDDEN_CHANGE:
            yield Diagnostic(
                "equivalent-stiffness",
                Place(joint=number, parameter=STIFFNESS),
                "undecided",
                torque=torque,
                unit="N" if joint.motion == "prismatic" else "N m",
                change=change,
            )
