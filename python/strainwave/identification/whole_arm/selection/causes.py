"""Effects: those that the study names, and those that predict held-out stretches better.

A coarse fit near its minimum gets the named effects, and the fine fit drops insignificant ones.
A score test is one linear step. Effects with similar score tests are told apart by fits, which use
the shapes and limits of their laws, and by the held-out scores of these fits. The models that
predict about as well as the one that is handed over remain plausible, and enter its intervals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import Cause, WholeArmOptions
from strainwave.domain.arm.effects import STIFFNESS_CURVE, effect_named
from strainwave.domain.arm.gear_laws import STIFFNESS, gear_law
from strainwave.domain.arm.parameter_table import base_name
from strainwave.domain.keys import Key, Values
from strainwave.domain.results.arm_model import MAX_RESIDUAL_NOISE
from strainwave.domain.results.final_table import is_identified
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.inference.fit_tests import has_excess_residuals
from strainwave.identification.whole_arm.inference.parameter_estimates import (
    PlausibleModel,
    parameters_of,
)
from strainwave.identification.whole_arm.inference.score_tests import (
    TestedEffect,
    is_primary,
    lengthen_steps,
    min_relevant_share,
    score_tests_of,
    shifts,
)
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    NamedEffect,
    add_effects,
    insignificant_effects,
    named_effects,
    remove_effects,
    whole_inertia_of,
    with_effects,
)
from strainwave.identification.whole_arm.problem.objective import AbsentEffect
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace
from strainwave.identification.whole_arm.problem.starting_values import (
    Loads,
    gear_torques,
    loads_of,
    replace_stiffness,
)
from strainwave.identification.whole_arm.search import Fit, fine_search, polish, search_minimum
from strainwave.identification.whole_arm.selection.candidate import (
    Candidate,
    Selection,
    extend_ranges,
    held_out_scores,
    select_better,
    simplest_model,
)
from strainwave.identification.whole_arm.selection.sensor_constants import (
    add_fine_sensor_constants,
    remove_insignificant_sensor_constants,
)
from strainwave.numerics.statistics import MIN_WEIGHT, model_weights, weight_over
from strainwave.signals.motor import activity_of

MAX_NAMED_EVALUATIONS = 30  # of the trial with named effects, which have several parameters each
MAX_RIVAL_EFFECTS = 3  # fitted effects of largest predicted gain
MAX_OTHER_EFFECTS = 4  # fitted effects of the same joint if the rivals explain too little
MAX_LINEARISED_EFFECTS = 6  # further effects, one step from the fit
MIN_EXPLAINED_SHARE = 0.25  # of the cost; below, further effects of the joint are fitted
MIN_RIVAL_GAIN_SHARE = 0.4  # of the best effect's linear gain
MAX_REFIT_EVALUATIONS = 20  # of each search; most converge in 4 to 9, added inertias in 15
RIVAL_ROWS = 1_200_000
"""Budget of fits with one additional effect, in evaluated residual rows of two joints: 124
evaluations of a study of 9,700 rows, about a minute of one core."""
MAX_DUAL_UNKNOWNS = 60  # that dual numbers differentiate; of more, one evaluation takes too long
REFIT_GAIN_TOLERANCE = 0.1  # predicted cost reduction at which a search ends
MIN_ACHIEVED_GAIN_SHARE = 0.5  # share of the linear gain below which a second start is tried
LARGE_PART = 1.0 / 3.0  # of a link's inertia, of a vibrating part of it
MIN_REMAINING_COMPLIANCE = 0.3  # share of the gear; a slower part moves with its own spring only
MAX_INCLUDED_EFFECTS = 4  # that the data select


def add_named_effects(fit: Fit, selection: Selection) -> Fit:
    """The coarse fit with the effects that the study names, unless they gain too little."""
    arm = selection.arm
    if not named_effects(arm):
        return fit
    # as many as the fit without them
    selection.allow(selection.options.max_iterations + selection.budget)
    values = fit.values
    loads = loads_of(fit.objective.records, values)
    space, start = add_effects(fit.space, named_effects(arm), arm, values, loads, fit.records)
    extended = search_minimum(
        fit.restart(with_effects(fit.objective, space, arm), start),
        selection.options,
        max_evaluations=MAX_NAMED_EVALUATIONS,
    )
    return select_better(replace(fit, cost=fit.cost - _prior_relief(fit, space)), extended)


def _prior_relief(fit: Fit, space: ParameterSpace) -> float:
    """Cost reduction due to the lower trust in the rigid step that the effects require."""
    parameters = fit.space.parameters(fit.z)

    before, after = (
        float(np.sum((prior.rows[:, : len(parameters)] @ parameters - prior.target) ** 2))
        for prior in (fit.space.prior, space.prior)
    )
    return before - after


def _without_insignificant_effects(fit: Fit, selection: Selection) -> Fit | None:
    arm = selection.arm
    if not named_effects(arm):
        return None
    effects = set(insignificant_effects(fit.space, fit.z, confidence_of(fit).cautious))
    space = remove_effects(fit.space, effects, arm)
    objective = with_effects(fit.objective, space, arm)
    return fit.restart(objective, space.coordinates(fit.values)) if effects else None


remove_insignificant_effects = Candidate(
    _without_insignificant_effects, fine_search, is_addition=False, is_repeated=True
)


@dataclass(frozen=True, slots=True)
class Rival:
    """A model with one further effect."""

    cause: Cause  # the effect, without its parameters
    fit: Fit
    arm: Arm

    @property
    def named_effect(self) -> NamedEffect:
        """The joint and the effect."""
        return self.cause.joint, self.cause.effect


@dataclass(frozen=True, slots=True)
class ModelComparison:
    """The models that were compared with the one that is handed over."""

    tests: Sequence[TestedEffect] = ()
    included: tuple[Rival, ...] = ()  # in the order of inclusion
    rivals: tuple[Rival, ...] = ()  # of effects that are not included, the most likely first
    plausible: tuple[PlausibleModel, ...] = ()
    excluded: tuple[NamedEffect, ...] = ()  # effects that the budget excluded from fits
    evaluations: int = 0  # budget, in evaluations of the fit's objective


class _Budget:
    """Evaluations available for fits with one additional effect, and linearised effects."""

    def __init__(self, fit: Fit, options: WholeArmOptions) -> None:
        records = fit.objective.records
        n_rows = sum(len(record.time) for record in records)
        # of a row, relative to two joints: the numbers of joints and of unknowns both rise
        price = max(1.0, (records[0].arm.n_joints / 2.0) ** 2)
        self.evaluations = int(options.rival_effort * RIVAL_ROWS / (n_rows * price))
        self.remaining = self.evaluations
        self.linearised = int(MAX_LINEARISED_EFFECTS / price)
        self.excluded: list[NamedEffect] = []

    @property
    def next_limit(self) -> int:
        """Maximum evaluations of the next search."""
        return min(MAX_REFIT_EVALUATIONS, self.remaining)


def include_effects(fit: Fit, selection: Selection) -> tuple[Fit, ModelComparison]:
    """Include the effects that improve held-out prediction, for joints that select their effects.

    Effects are included one at a time, the simplest first: an effect by record predicts each record
    with parameters of its own. An effect stays out if another primary value is not determined with
    it, or if the study excludes one of the joint that predicts better. The other models enter the
    intervals by their weights. `fit` is at its minimum.
    """
    included: list[Rival] = []
    others: list[tuple[Fit, Arm]] = []  # the models without the included effects, and their rivals
    refined: list[tuple[Fit, Fit, list[Fit]]] = []  # before, after, and the rivals before
    while True:
        tests = score_tests_of(fit, selection.arm)
        budget = _Budget(fit, selection.options)
        rivals = _rivals_of(fit, tests, selection, budget)
        others += [(rival.fit, rival.arm) for rival in rivals]
        min_share = min_relevant_share(fit.objective, fit.z)
        supported = [
            rival
            for rival in rivals
            if rival.cause.weight > MIN_WEIGHT
            and rival.cause.share > min_share
            and not rival.cause.is_linearised
        ]
        best = extended = None
        while supported and extended is None and len(included) < MAX_INCLUDED_EFFECTS:
            best = supported.pop(simplest_model([one.fit for one in supported]))
            joint, effect = best.named_effect
            # the study leaves the choice to the data: it may state gear laws and effects
            if effect != STIFFNESS_CURVE.name and selection.arm.joints[joint - 1].selects_effects:
                extended = _include(fit, best, selection)
            else:  # the other effects of the joint would imitate it
                supported = [one for one in supported if one.named_effect[0] != joint]
        if best is None or extended is None:
            break
        included.append(best)
        refined.append((best.fit, extended, [rival.fit for rival in rivals]))
        others = [(fit, selection.arm), *(other for other in others if other[0] is not best.fit)]
        fit = extended
    plausible: list[PlausibleModel] = []
    if others:
        weights = _weights(fit, [other for other, _ in others], refined)
        plausible = [
            PlausibleModel(other, arm, weight, _determined_values(other, arm))
            for (other, arm), weight in zip(others, weights, strict=True)
        ]
    excluded = tuple(budget.excluded)
    return fit, ModelComparison(
        tests, tuple(included), tuple(rivals), tuple(plausible), excluded, budget.evaluations
    )


def _weights(
    fit: Fit, others: Sequence[Fit], refined: Sequence[tuple[Fit, Fit, list[Fit]]]
) -> list[float]:
    """Weights of other models against the fit, by held-out scores.

    Only the model with the best effect is refined, to the minimum and in its sensor constants. A
    rival that it did not replace before would gain as much: of two models that explain the same,
    as errors of the torque constant of either joint do, neither gets all the weight.
    """
    scores = held_out_scores([fit, *others, *(one for pair in refined for one in pair[:2])])
    n = 1 + len(others)
    rounds = zip(scores[n::2], scores[n + 1 :: 2], refined, strict=True)
    for before, after, (_, _, rivals) in rounds:
        for k, other in enumerate(others, start=1):
            lead = weight_over(before, scores[k], np.random.default_rng(0))
            if lead <= MIN_WEIGHT and any(other is rival for rival in rivals):
                scores[k] += after - before
    weights: list[float] = model_weights(scores[:n], np.random.default_rng(0))[1:].tolist()
    return weights


def _include(fit: Fit, rival: Rival, selection: Selection) -> Fit | None:
    """The fit with the effect of a rival; None if the data do not determine its values.

    Either a size of the effect is insignificant or at the limit of its range, or another primary
    value is lost.
    """
    selection.renew(fit)
    objective = with_effects(fit.objective, rival.fit.space, rival.arm)
    try:
        extended = fine_search(fit.restart(objective, rival.fit.z), selection.options)
        # the effect may have hidden, or imitated, the constant of a sensor
        extended = extend_ranges(extended, selection)
        extended = add_fine_sensor_constants(extended, selection)
        extended = remove_insignificant_sensor_constants(extended, selection)
        extended = polish(extended, selection.options)
    except NotIdentifiable:
        return None
    joint, name = rival.named_effect
    insignificant = insignificant_effects(
        extended.space, extended.z, confidence_of(extended).cautious
    )
    bounded = zip(extended.space.keys, extended.at_bounds, strict=True)
    sizes = effect_named(name).sizes
    if rival.named_effect in insignificant or any(
        at and base_name(key[0]) in sizes and key[1] == joint for key, at in bounded
    ):
        return None
    values = filter(is_primary, _determined_values(fit, selection.arm))
    return extended if _determined_values(extended, rival.arm).issuperset(values) else None


def _determined_values(fit: Fit, arm: Arm) -> frozenset[Key]:
    """The parameters that a fit determines."""
    records = fit.objective.records
    largest = gear_torques(records, fit.values).tolist()
    motion = {level.joint: level for level in activity_of([r.log for r in records], arm)}
    parameters = parameters_of(fit, arm, largest)[0]
    return frozenset(p.key for p in parameters if is_identified(p, arm, motion))


def _rivals_of(
    fit: Fit, tested: Sequence[TestedEffect], selection: Selection, budget: _Budget
) -> list[Rival]:
    """Models with one of the most significant effects each, the best held-out score first.

    No effect is fitted unless one is promising, but modes if the residuals are far above the noise.
    Promising effects beyond the fitted ones are linearised.
    """
    decided = [(joint, STIFFNESS_CURVE.name) for joint in selection.law_choices]
    excluded = {*named_effects(selection.arm), *decided}
    unnamed = [one for one in tested if one.named_effect not in excluded]
    min_share = min_relevant_share(fit.objective, fit.z)
    promising = [one for one in unnamed if one.is_promising and one.share > min_share]
    unnamed.sort(key=lambda one: -one.gain)
    min_gain = MIN_RIVAL_GAIN_SHARE * max((one.gain for one in promising), default=math.inf)
    candidates = [one for one in unnamed if one.gain >= min_gain]
    if not promising and has_excess_residuals(fit.objective, fit.z, MAX_RESIDUAL_NOISE):
        # a mode of vibration moves resonances beyond the reach of a linear step
        candidates = [one for one in unnamed if effect_named(one.named_effect[1]).starting_shapes]
    if not candidates:
        return []
    starts = [fit]
    long = lengthen_steps(fit)
    if long is not fit:
        long = replace(long, objective=long.objective.store_step_errors(fit.z))
        starts = [long, fit]  # some effects are too stiff for long steps
    candidates = candidates[:MAX_RIVAL_EFFECTS]
    rivals = _fit_rivals(starts, candidates, selection, budget)
    if not promising:
        rivals = [rival for rival in rivals if rival.cause.share > min_share]
    best = max(rivals, key=lambda one: one.cause.gain, default=None)
    if promising and (
        best is None
        or best.cause.share < MIN_EXPLAINED_SHARE
        or effect_named(best.named_effect[1]).by_record
    ):
        # a linear step underrates some effects; an effect by record can replace many others
        joint = (best or promising[0]).named_effect[0]
        further = [one for one in unnamed if one.named_effect[0] == joint and one not in candidates]
        rivals += _fit_rivals(starts, further[:MAX_OTHER_EFFECTS], selection, budget)
    known = {rival.named_effect for rival in rivals}
    others = [one for one in promising if one.named_effect not in known]
    unaffordable = others[budget.linearised : MAX_LINEARISED_EFFECTS]
    budget.excluded += [one.named_effect for one in unaffordable]
    for one in others[: budget.linearised]:
        attempts = (_linearise(start, one, selection) for start in starts)
        rivals += [rival for rival in attempts if rival is not None][:1]
    if not rivals:
        return []
    without, *scores = held_out_scores([fit, *(rival.fit for rival in rivals)])
    weighted = []
    for own, rival in sorted(zip(scores, rivals, strict=True), key=lambda pair: -np.sum(pair[0])):
        weight = weight_over(own, without, np.random.default_rng(0))
        weighted.append(replace(rival, cause=replace(rival.cause, weight=weight)))
    return weighted


def _fit_rivals(
    starts: Sequence[Fit],
    candidates: Sequence[TestedEffect],
    selection: Selection,
    budget: _Budget,
) -> list[Rival]:
    """Fit each effect; keep the fits that reduce the cost.

    A later one of the `starts` is used if no arm near those before it can be simulated.
    """
    rivals = []
    for one in candidates:
        if not budget.next_limit:
            budget.excluded.append(one.named_effect)
            continue
        attempts = (_refit(start, one, selection, budget) for start in starts)
        rival = next((rival for rival in attempts if rival is not None), None)
        if rival is not None and rival.cause.gain > 0.0:
            rivals.append(rival)
    return rivals


def _refit(fit: Fit, tested: TestedEffect, selection: Selection, budget: _Budget) -> Rival | None:
    """Fit with one additional effect; None if no such arm can be simulated.

    The search starts at the result of the linear step. While it gains much less than the linear
    step predicts, others start from the fit without the effect and a typical size, then from a
    large part of the link at each tested shape: it moves resonances beyond the reach of a step.
    """
    one, estimates = tested.named_effect, fit.values
    starts = [tested.values, estimates | tested.shapes]
    if effect_named(one[1]).is_part_of_link:
        shapes = (tested.shapes, *tested.other_shapes)
        starts += [with_large_part(estimates | each, one, selection.arm) for each in shapes]
    loads = loads_of(fit.objective.records, estimates)
    best: Rival | None = None
    for start in starts:
        limit = budget.next_limit
        if not limit or (best and best.cause.gain > MIN_ACHIEVED_GAIN_SHARE * tested.gain):
            break
        rival = _search_with_effect(fit, tested, start, loads, selection, limit)
        budget.remaining -= min(rival.fit.iterations, budget.remaining) if rival else limit
        if rival is not None and (best is None or rival.fit.cost < best.fit.cost):
            best = rival
    return best


def with_large_part(values: Values, one: NamedEffect, arm: Arm) -> Values:
    """Values of a link a large part of which vibrates, with the compliance of slow torsion.

    A fit without the part has the compliance 1 / k + s^2 / (J_f w^2), with the share s = J_f / J
    of the part, its own stiffness J_f w^2 and the stiffness k of the gear.
    """
    (joint, name), whole = one, whole_inertia_of(one, arm)
    assert whole is not None
    effect, part = effect_named(name), LARGE_PART * values[whole]
    frequency = "flexible_frequency"
    own = part * (math.tau * values.get((frequency, joint), effect.shapes[frequency])) ** 2
    scale = 1.0 - values.get((STIFFNESS, joint), 0.0) * LARGE_PART**2 / own
    changed = {whole: values[whole] - part, (effect.sizes[0], joint): part}
    if (STIFFNESS, joint) in values and scale > MIN_REMAINING_COMPLIANCE:
        changed[STIFFNESS, joint] = values[STIFFNESS, joint] / scale
    return values | changed


def _linearise(fit: Fit, tested: TestedEffect, selection: Selection) -> Rival | None:
    """The model one linear step from the fit; None if the step does not reduce the cost."""
    loads = loads_of(fit.objective.records, fit.values)
    rival = _search_with_effect(fit, tested, tested.values, loads, selection, max_evaluations=1)
    if rival is None or not rival.cause.gain > 0.0:
        return None
    return replace(rival, cause=replace(rival.cause, is_linearised=True))


def _search_with_effect(
    fit: Fit,
    tested: TestedEffect,
    start: Values,
    loads: Loads,
    selection: Selection,
    max_evaluations: int,
) -> Rival | None:
    """Search briefly with one additional effect, correct the step error, and search again.

    Returns None if no such arm can be simulated.
    """
    joint, name = tested.named_effect
    effect, arm = effect_named(name), selection.arm
    law, without = effect.fitted_law, None
    if law:
        extended = arm.with_joint(joint, spring=law)
        space, z = replace_stiffness(fit.space, extended, fit.values | start, loads.torque)
    else:
        possible = (*arm.joints[joint - 1].possible_effects, name)
        extended = arm.with_joint(joint, effects=tuple(dict.fromkeys(possible)))
        space, z = add_effects(fit.space, [(joint, name)], arm, start, loads, fit.records)
        if effect.needs_dual_numbers and len(space.unknowns) > MAX_DUAL_UNKNOWNS:
            absent: Values = {(each, joint): value for each, value in effect.absent.items()}
            whole = whole_inertia_of((joint, name), arm)
            without = AbsentEffect(absent, (effect.sizes[0], joint), whole)
    options = replace(selection.options, max_iterations=max_evaluations)
    search = partial(search_minimum, options=options, tolerance=REFIT_GAIN_TOLERANCE)
    try:
        objective = replace(with_effects(fit.objective, space, extended), without=without)
        first = search(Fit.at(objective, z))
        end = search(replace(first, objective=first.objective.correct_step_error(first.z)))
    except (InvalidInput, NotIdentifiable, NumericalFailure):
        return None
    gain, values = fit.cost - tested.rigid - end.cost, end.values
    if law:  # the stiffness of a curve at zero torsion is comparable with the linear one
        curve = gear_law(law).of_joint(values, joint)
        values[STIFFNESS, joint] = float(gear_law(law).stiffness(curve, np.zeros(1))[0])
    share = gain / max(fit.cost, 1e-300)
    return Rival(Cause(joint, name, (), gain, share, tuple(shifts(fit, values))), end, extended)
