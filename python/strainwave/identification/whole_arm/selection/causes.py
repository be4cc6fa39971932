"""Find the effect that the model most likely lacks by fits of the best score tests.

A score test is one linear step. Effects with similar score tests can be told apart by fits, which
use the shapes and limits of their laws.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import (
    WHOLE_ARM_FIT,
    Cause,
    Clause,
    Diagnostic,
    Parameter,
    ParameterShift,
    Place,
    WholeArmOptions,
)
from strainwave.domain.distributions import chi_square_limit
from strainwave.domain.effects import STIFFNESS_CURVE, effect_named
from strainwave.domain.gear_laws import STIFFNESS, gear_law
from strainwave.domain.keys import Key, Values
from strainwave.domain.parameter_table import base_name
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.whole_arm.inference.parameter_estimates import parameters_of
from strainwave.identification.whole_arm.inference.score_tests import (
    TestedEffect,
    is_relevant,
    lengthen_steps,
    score_tests_of,
    shifts,
)
from strainwave.identification.whole_arm.problem.arm_unknowns import replace_stiffness
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    NamedEffect,
    add_effects,
    effects_in,
    named_effects,
    with_effects,
)
from strainwave.identification.whole_arm.records.loads import Loads, gear_torques, loads_of
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import fine_search, search_minimum
from strainwave.identification.whole_arm.selection.candidate import Selection

MAX_RIVAL_EFFECTS = 3  # fitted effects of largest predicted gain
MAX_OTHER_EFFECTS = 4  # fitted effects of the same joint if the rivals explain too little
MIN_EXPLAINED_SHARE = 0.25  # of the cost; below, further effects of the joint are fitted
MIN_RIVAL_GAIN_SHARE = 0.4  # of the best effect's linear gain
MAX_REFIT_EVALUATIONS = 12  # of each search; nearly all converge in 4 to 9
RIVAL_ROWS = 600_000
"""Budget of fits with one additional effect, in evaluated residual rows: 62 evaluations of a study
of 9,700 rows, about half a minute of one core."""
REFIT_GAIN_TOLERANCE = 0.1  # predicted cost reduction at which a search ends
MIN_ACHIEVED_GAIN_SHARE = 0.5  # share of the linear gain below which a second start is tried
MAX_AUTO_EFFECTS = 4  # effects that a fit adds
MAX_NAMED_PARAMETERS = 3  # in a warning, of the effect and of the arm
MIN_UNEXPLAINED_SHARE = 1e-9  # of the cost; keeps the logarithm finite
MIN_SUFFICIENT_SHARE = 0.5  # of the cost; below, the warning says that more is missing


@dataclass(frozen=True, slots=True)
class Refit:
    """A fit with one additional effect."""

    named_effect: NamedEffect
    fit: Fit
    gain: float  # cost reduction minus its expectation if the residuals are noise
    share: float  # of the cost that the effect explains
    evidence: float  # decrease of Schwarz's criterion
    shifts: tuple[ParameterShift, ...]


def schwarz_decrease(share: float, parameters: int, cost: float) -> float:
    """Decrease of Schwarz's criterion by an effect: n ln(1 / (1 - share)) - p ln n.

    `share` is the share of the cost that the effect explains, p the number of its `parameters`, and
    n the `cost` without it, which the weights make the number of independent errors. An effect with
    several sizes must therefore explain more than one with a single size.
    """
    n = max(cost, 1.0)
    return -n * math.log(max(1.0 - share, MIN_UNEXPLAINED_SHARE)) - parameters * math.log(n)


@dataclass(frozen=True, slots=True)
class Refits:
    """Fits with one additional effect each, and the effects that the budget excluded."""

    fits: tuple[Refit, ...]  # the significant ones, the most likely first
    excluded: tuple[NamedEffect, ...]
    evaluations: int  # budget that was given, in evaluations of the fit's objective


class _Budget:
    """Evaluations available for fits with one additional effect."""

    def __init__(self, fit: Fit, options: WholeArmOptions) -> None:
        n_rows = sum(len(record.time) for record in fit.objective.records)
        self.evaluations = int(options.rival_effort * RIVAL_ROWS / n_rows)
        self.remaining = self.evaluations
        self.excluded: list[NamedEffect] = []

    @property
    def next_limit(self) -> int:
        """Maximum evaluations of the next search."""
        return min(MAX_REFIT_EVALUATIONS, self.remaining)


def fit_missing_effects(fit: Fit, tested: Sequence[TestedEffect], selection: Selection) -> Refits:
    """Fit each of the most significant effects, within a budget of evaluations.

    No effect is fitted unless one is promising. `fit` is at its minimum, and `tested` is in order
    of significance.
    """
    arm, options = selection.arm, selection.options
    decided = [(joint, STIFFNESS_CURVE.name) for joint in selection.law_choices]
    excluded = {*named_effects(arm), *decided}
    unnamed = [one for one in tested if one.named_effect not in excluded]
    promising = [one for one in unnamed if one.is_promising]
    if not promising:
        return Refits((), (), 0)
    unnamed.sort(key=_predicted_gain, reverse=True)
    min_gain = MIN_RIVAL_GAIN_SHARE * max(map(_predicted_gain, promising))
    rivals = [one for one in unnamed if _predicted_gain(one) >= min_gain][:MAX_RIVAL_EFFECTS]
    budget, starts = _Budget(fit, options), [fit]
    long = lengthen_steps(fit)
    if long is not fit:
        long = replace(long, objective=long.objective.store_step_errors(fit.z))
        starts = [long, fit]  # some effects are too stiff for long steps
    refits = _fit_rivals(starts, rivals, arm, options, budget)
    if not refits or not _is_sufficient(refits[0]):
        # a linear step underrates some effects; an effect by record can replace many others
        joint = refits[0].named_effect[0] if refits else promising[0].test.joint
        others = [one for one in unnamed if one.test.joint == joint and one not in rivals]
        refits += _fit_rivals(starts, others[:MAX_OTHER_EFFECTS], arm, options, budget)
    return Refits(tuple(_sort_by_evidence(refits)), tuple(budget.excluded), budget.evaluations)


def _is_sufficient(refit: Refit) -> bool:
    """Whether the effect explains so much that no further effects need a fit."""
    is_by_record = effect_named(refit.named_effect[1]).by_record
    return refit.share >= MIN_EXPLAINED_SHARE and not is_by_record


def _sort_by_evidence(refits: Iterable[Refit]) -> list[Refit]:
    """Refits in order of decreasing evidence."""
    return sorted(refits, key=lambda one: -one.evidence)


def _fit_rivals(
    starts: Sequence[Fit],
    rivals: Sequence[TestedEffect],
    arm: Arm,
    options: WholeArmOptions,
    budget: _Budget,
) -> list[Refit]:
    """Fit each effect; keep those significant beyond chance, the most likely first.

    A later one of the `starts` is used if no arm near those before it can be simulated.
    """
    refits = []
    for one in rivals:
        if not budget.next_limit:
            budget.excluded.append(one.named_effect)
            continue
        attempts = (_refit(start, one, arm, options, budget) for start in starts)
        refit = next((refit for refit in attempts if refit is not None), None)
        if refit is not None and _is_significant(refit, one.chance):
            refits.append(refit)
    return _sort_by_evidence(refits)


def _predicted_gain(tested: TestedEffect) -> float:
    """Cost reduction by the linear step, alone or with the more significant effects included."""
    return max(tested.alone, tested.test.gain if tested.is_promising else 0.0)


def _refit(
    fit: Fit, tested: TestedEffect, arm: Arm, options: WholeArmOptions, budget: _Budget
) -> Refit | None:
    """Fit with one additional effect; None if no such arm can be simulated.

    The search starts at the result of the linear step. If it gains much less than the linear step
    predicts, a second search starts from the fit without the effect.
    """
    n = len(fit.space.unknowns)
    estimates = fit.values
    sizes = {key: value for key, value in tested.values.items() if key not in estimates}
    loads = loads_of(fit.objective.records, estimates)
    best: Fit | None = None
    gain = -math.inf
    for start in (tested.values, estimates | sizes):
        limit = budget.next_limit
        if not limit or gain > MIN_ACHIEVED_GAIN_SHARE * tested.alone:
            break
        limited = replace(options, max_iterations=limit)
        other = _search_with_effect(fit, tested.named_effect, start, loads, arm, limited)
        budget.remaining -= limit if other is None else min(other.iterations, budget.remaining)
        if other is not None and (best is None or other.cost < best.cost):
            best, gain = other, fit.cost - tested.rigid - other.cost
    if best is None:
        return None
    values = best.values
    joint, law = tested.named_effect[0], effect_named(tested.named_effect[1]).fitted_law
    if law:  # its stiffness at zero torsion replaces the linear one
        curve = gear_law(law).of_joint(values, joint)
        values[STIFFNESS, joint] = float(gear_law(law).stiffness(curve, np.zeros(1))[0])
    parameter_shifts = tuple(shifts(fit, values))
    n_added = len(best.space.unknowns) - n
    share = gain / max(fit.cost, 1e-300)
    evidence = schwarz_decrease(share, n_added, fit.cost)
    return Refit(tested.named_effect, best, gain - n_added, share, evidence, parameter_shifts)


def _search_with_effect(
    fit: Fit, one: NamedEffect, start: Values, loads: Loads, arm: Arm, options: WholeArmOptions
) -> Fit | None:
    """Search briefly with one additional effect, correct the step error, and search again."""
    extended = _with_possible_effect(arm, one)
    if effect_named(one[1]).fitted_law:
        space, z = replace_stiffness(fit.space, extended, fit.values | start, loads.torque)
    else:
        space, z = add_effects(fit.space, [one], arm, start, loads, fit.records)
    search = partial(search_minimum, options=options, tolerance=REFIT_GAIN_TOLERANCE)
    try:
        first = search(Fit.at(with_effects(fit.objective, space, extended), z))
        return search(replace(first, objective=first.objective.correct_step_error(first.z)))
    except (InvalidInput, NotIdentifiable, NumericalFailure):
        return None


def _with_possible_effect(arm: Arm, one: NamedEffect) -> Arm:
    """The arm with one additional possible effect, or with the gear law that it is."""
    number, effect = one
    law = effect_named(effect).fitted_law
    if law:
        return arm.with_joint(number, spring=law)
    return arm.with_joints(
        replace(joint, effects=tuple(dict.fromkeys((*joint.possible_effects, effect))))
        if k == number
        else joint
        for k, joint in enumerate(arm.joints, start=1)
    )


def _is_significant(refit: Refit, chance: float) -> bool:
    """Whether a fitted effect is significant and relevant."""
    degrees = len(_effect_parameters(refit))
    significant = refit.gain + degrees > chi_square_limit(chance, degrees)
    return significant and refit.evidence > 0.0 and is_relevant(refit.share, refit.shifts)


def _effect_parameters(refit: Refit) -> set[Key]:
    """The parameters of the refit's effect."""
    joint, effect = refit.named_effect
    law = effect_named(effect).fitted_law
    names = gear_law(law).names if law else effect_named(effect).names
    keys = refit.fit.space.keys
    return {key for key in keys if key[1] == joint and base_name(key[0]) in names}


def list_causes(refits: Sequence[Refit], arm: Arm) -> Iterator[Cause]:
    """The published record of each refit."""
    for refit in refits:
        joint, effect = refit.named_effect
        values = refit.fit.values
        largest = gear_torques(refit.fit.objective.records, values).tolist()
        parameters, _ = parameters_of(
            refit.fit, _with_possible_effect(arm, refit.named_effect), largest
        )
        yield Cause(
            joint,
            effect,
            tuple(p for p in parameters if p.key in _effect_parameters(refit)),
            refit.gain,
            refit.share,
            refit.shifts,
        )


def add_significant_effects(fit: Fit, selection: Selection) -> Fit:
    """Add the significant effects, for joints with effects = "auto".

    Effects are added one at a time, the most likely first, until none is significant. If the
    residuals are noise, the probability of adding any is `FALSE_ALARMS`.
    """
    arm = selection.arm
    if not any(joint.selects_effects for joint in arm.joints):
        return fit
    for _ in range(MAX_AUTO_EFFECTS):
        tested = [
            one
            for one in score_tests_of(fit, arm)
            if arm.joints[one.test.joint - 1].selects_effects
        ]
        refits = fit_missing_effects(fit, tested, selection)
        if not refits.fits or refits.fits[0].named_effect[1] == STIFFNESS_CURVE.name:
            break  # the study states the gear law: the conclusion names the cause
        selection.renew(fit)
        best = refits.fits[0]
        extended = _with_possible_effect(arm, best.named_effect)
        objective = with_effects(fit.objective, best.fit.space, extended)
        fit = fine_search(fit.restart(objective, best.fit.z), selection.options)
    return fit


def warn_unfitted_effects(refits: Refits) -> Iterator[Diagnostic]:
    """Warn about effects that were excluded because the budget was exhausted."""
    if refits.excluded:
        effects = tuple(Clause("of-joint", name=e, joint=j) for j, e in refits.excluded)
        evaluations = refits.evaluations
        yield Diagnostic(
            "causes-not-fitted", WHOLE_ARM_FIT, effects=effects, evaluations=evaluations
        )


def warn_likely_cause(causes: Sequence[Cause]) -> Iterator[Diagnostic]:
    """Warn about the most likely cause: what it explains, what it changes, how to confirm it.

    Only the first cause gets a warning, because the gain of the others is only known with the first
    one in the model.
    """
    for cause in causes[:1]:
        effect = effect_named(cause.effect)
        rivals = tuple(Clause("of-joint", name=c.effect, joint=c.joint) for c in causes[1:])
        clause = Clause(
            "effect-likely",
            effect=cause.effect,
            setting=effect.setting,
            share=cause.share,
            sizes=tuple(_sizes(cause.parameters)),
            changes=_changes(cause.shifts) if cause.shifts else None,
            rivals=Clause("rivals", effects=rivals) if rivals else None,
            rest=None if cause.share >= MIN_SUFFICIENT_SHARE else Clause("mostly-unexplained"),
            experiment=effect.experiment,
        )
        yield Diagnostic.of(effect.warning_code, Place(joint=cause.joint), clause)


def _sizes(parameters: Sequence[Parameter]) -> Iterator[Clause]:
    """The parameters of an effect."""
    estimates = [p for p in parameters if p.value is not None and p.std is not None]
    for p in estimates[:MAX_NAMED_PARAMETERS]:
        template = "effect-size" if p.unit else "effect-size/no-unit"
        yield Clause(template, name=p.name, value=p.value, std=p.std, unit=p.unit)


def _changes(shifts: Sequence[ParameterShift]) -> Clause:
    """The parameters that an effect changes most."""
    listed = tuple(
        Clause(
            "shift",
            parameter=Place(joint=shift.joint, parameter=shift.name),
            change=shift.shift / shift.without,
        )
        for shift in shifts[:MAX_NAMED_PARAMETERS]
        if shift.without
    )
    return Clause("changes", shifts=listed)


def warn_added_effects(fit: Fit, arm: Arm) -> Iterator[Diagnostic]:
    """Warn about the effects that the fit added."""
    for number, name in effects_in(fit.space, arm):
        if arm.joints[number - 1].selects_effects:
            effect = effect_named(name)
            yield Diagnostic(
                "effect-taken-up",
                Place(joint=number),
                effect=name,
                description=effect.description,
                consequence=effect.consequence,
                experiment=effect.experiment,
            )
