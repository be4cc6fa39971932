"""Selection of the elastic law of gears with `spring = "auto"`; restarts of curves without a knee.

All gears are linear at first. A score test of the cubic term decides which of them are worth fits
of stiffness curves. The held-out prediction decides between the laws.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from strainwave.domain import Diagnostic, LawChoice, LawMargin, Place, SearchEnd
from strainwave.domain.arm.effects import STIFFNESS_CURVE
from strainwave.domain.arm.gear_laws import AUTO, CUBIC, STIFFNESS, GearLaw, curved_laws, stated_law
from strainwave.domain.keys import Key, Values
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.inference.parameter_estimates import identified_curves
from strainwave.identification.whole_arm.inference.score_tests import TestedEffect, curve_tests_of
from strainwave.identification.whole_arm.problem.effect_unknowns import with_effects
from strainwave.identification.whole_arm.problem.parameter_space import limit_unknown
from strainwave.identification.whole_arm.problem.starting_values import (
    gear_torques,
    replace_stiffness,
)
from strainwave.identification.whole_arm.search import Fit, fine_search, resumed_coarse_search
from strainwave.identification.whole_arm.selection.candidate import (
    MAX_CANDIDATE_EVALUATIONS,
    MIN_SIGNIFICANCE_STDS,
    Selection,
    held_out_scores,
    run_trial,
    select_better,
    simplest_model,
)
from strainwave.numerics.statistics import weight_over

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
    trials = _LawTrials(fit, selection)
    while free and not selection.is_budget_exhausted(fit):
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


class _LawTrials:
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
            with suppress(InvalidInput, NotIdentifiable, NumericalFailure):
                fits[law] = self._fit(start, joints, law, max_evaluations)
        return fits

    def _fit(self, start: Fit, joints: Sequence[int], law: str, max_evaluations: int | None) -> Fit:
        arm, options = self._arm(joints, law), self.selection.options
        values = self.linear.values | start.values
        for joint in joints:  # the stiffness of the line through a torque of the curve
            current = self.selection.arm.joints[joint - 1].law
            torque = _REFERENCE_LOAD * self.largest_torque[[joint - 1]]
            torsion = current.torsion(current.of_joint(values, joint), torque)
            values[STIFFNESS, joint] = float((torque / torsion)[0])
        space, z = replace_stiffness(self.linear.space, arm, values, self.largest_torque.tolist())
        known = set(self.linear.space.keys)
        unknowns = tuple(
            unknown if unknown.key in known else limit_unknown(unknown, options, at)
            for unknown, at in zip(space.unknowns, z.tolist(), strict=True)
        )
        objective = with_effects(start.objective, replace(space, unknowns=unknowns), arm)
        restart = replace(start.restart(objective, z), iterations=self.iterations)
        max_iterations = self.iterations + self.selection.budget
        own = Selection(arm, replace(options, max_iterations=max_iterations))
        if max_evaluations is None:
            fit = resumed_coarse_search(restart, own.options)
        else:
            fit = run_trial(restart, own, max_evaluations)
        fit = restart_coarse_fit(fit, own)
        self.iterations = fit.iterations
        self.selection.allow(self.iterations + self.selection.budget)
        return fit


def _select(joint: int, rivals: Mapping[str, Fit]) -> LawChoice:
    """The law with the fewest parameters unless one with more predicts better."""
    names = list(rivals)
    chosen = simplest_model([rivals[name] for name in names])
    scores = held_out_scores([rivals[name] for name in names])

    margins = [
        LawMargin(
            names[k],
            float(np.sum(scores[chosen] - scores[k])),
            weight_over(scores[chosen], scores[k], np.random.default_rng(0)),
        )
        for k in range(len(names))
        if k != chosen
    ]
    return LawChoice(joint, names[chosen], tuple(margins))


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


def restart_coarse_fit(fit: Fit, selection: Selection) -> Fit:
    """Restart the search from other curves for each gear whose curve lost a knee.

    Returns the fit of least cost.
    """
    for number, joint in enumerate(selection.arm.joints, start=1):
        law = joint.law
        if not law.is_curved or (law.names[0], number) not in fit.space.keys:
            continue
        values = fit.values
        largest = gear_torques(fit.objective.records, values)[number - 1]
        for start in alternative_curves(law, values, number, largest):
            if selection.is_budget_exhausted(fit):
                return replace(fit, end=SearchEnd.EVALUATION_LIMIT)
            z = fit.space.coordinates(start)
            try:
                restarted = run_trial(replace(fit, z=z), selection, MAX_CANDIDATE_EVALUATIONS)
            except NotIdentifiable:
                continue  # the arm cannot be simulated with this curve
            fit = select_better(fit, restarted)
            new_values = fit.values
            if new_values != values and not any(
                alternative_curves(law, new_values, number, largest)
            ):
                break  # the curve has all its knees
    return fit


def restart_fine_fit(fit: Fit, selection: Selection) -> Fit:
    """Restart a fine fit from other curves if a curve lost a knee.

    Long integrator steps may hide the loss in the coarse fit. The restarts have their own budget of
    evaluations, equal to that of the fit.
    """
    options = selection.options
    selection.renew(fit)
    restarted = restart_coarse_fit(fit, selection)
    if restarted.iterations == fit.iterations:
        selection.options = options
        return fit
    if restarted.cost < fit.cost:
        objective = restarted.objective.update_weights(restarted.z)
        return fine_search(replace(restarted, objective=objective), selection.options)
    return replace(restarted, end=fit.end)


def alternative_curves(
    law: GearLaw, values: Values, joint: int, largest_torque: float
) -> Iterator[Values]:
    """Values of the arm with alternative curves of one gear.

    `values` are those at the end of a search, `joint` counts from 1, and `largest_torque` [N m] is
    that of the gear in the records. Yields nothing if the curve has all its knees.
    """
    for start in law.restarts(law.of_joint(values, joint), largest_torque):
        yield {**values, **{(name, joint): value for name, value in start.items()}}


def remove_insignificant_stiffness_terms(fit: Fit, selection: Selection) -> Fit:
    """Repeat the fit without the optional terms of gear laws that are zero within their errors.

    A chi-square distance tests all optional parameters of a gear together. Returns the fit itself
    if all terms are significant. A gear whose law the fit selects becomes linear.
    """
    keys, insignificant = fit.space.keys, dict[Key, float]()
    for number, joint in enumerate(selection.arm.joints, start=1):
        names = joint.law.may_vanish
        places = [k for k, (name, of) in enumerate(keys) if of == number and name in names]
        if places:
            estimate = fit.space.parameters(fit.z)[places]
            covariance = confidence_of(fit).cautious[np.ix_(places, places)]
            if estimate @ np.linalg.solve(covariance, estimate) < MIN_SIGNIFICANCE_STDS**2:
                insignificant |= {keys[k]: 0.0 for k in places}
    if insignificant:
        start = fit.with_unknowns(fit.space.fix_values(insignificant))
        fit = fine_search(start, selection.options)
    straight = selection.law_choices.keys() & {number for _, number in insignificant}
    if not straight:
        return fit
    for number in straight:
        _select_line(number, selection)
    removed = {key for key in insignificant if key[1] in straight}
    fixed = {key: value for key, value in fit.space.fixed.items() if key not in removed}
    space = replace(fit.space, fixed=fixed)
    return replace(fit, objective=with_effects(fit.objective, space, selection.arm))


def straighten_curves(fit: Fit, selection: Selection) -> Fit:
    """Make gears linear whose curve has one identified slope and does not predict better."""
    largest = gear_torques(fit.objective.records, fit.values).tolist()
    for number in selection.law_choices:
        law, keys = selection.arm.joints[number - 1].law, fit.space.keys
        known = identified_curves(fit, confidence_of(fit).combined, selection.arm, largest)
        slopes = {known.get((name, number), (name, number)) for name in law.names} - {None}
        if not law.is_curved or len(slopes) > 1:
            continue
        kept = [
            k
            for k, key in enumerate(keys)
            if key in slopes or key not in {(name, number) for name in law.names}
        ]
        space = fit.space.select(kept)
        unknowns = (replace(u, name=STIFFNESS) if u.key in slopes else u for u in space.unknowns)
        space, line = replace(space, unknowns=tuple(unknowns)), replace(selection)
        _select_line(number, line)
        start = fit.restart(with_effects(fit.objective, space, line.arm), fit.z[kept])
        straight = fine_search(start, selection.options)
        if simplest_model([straight, fit]) == 0:
            fit = straight
            _select_line(number, selection)
    return fit


def _select_line(number: int, selection: Selection) -> None:
    selection.arm = selection.arm.with_joint(number, spring=LINEAR)
    selection.law_choices = selection.law_choices | {number: LawChoice(number, LINEAR)}
