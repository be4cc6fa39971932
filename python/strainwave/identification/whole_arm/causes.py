"""Which effect a model most likely lacks: the best of the score tests, each fitted.

A score test sees one linear step. Effects that resemble one another differ in what they explain
once fitted, with the shapes and limits of their laws.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from strainwave.domain import Cause, Diagnostic, FloatArray, ParameterShift, TuningOptions
from strainwave.domain.effects import effect_named
from strainwave.domain.parameter_table import base_name
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.whole_arm.effects import (
    NamedEffect,
    effects_in,
    named_effects,
    records_with,
    with_effects,
)
from strainwave.identification.whole_arm.estimates import Fit, parameters_of
from strainwave.identification.whole_arm.gear_load import gear_torques
from strainwave.identification.whole_arm.loads import Loads, loads_of
from strainwave.identification.whole_arm.objective import Objective
from strainwave.identification.whole_arm.parametrisation import Key
from strainwave.identification.whole_arm.score_tests import (
    Tested,
    in_long_steps,
    matters,
    score_tests_of,
    shifts,
)
from strainwave.identification.whole_arm.selection import Selection
from strainwave.identification.whole_arm.solver import fine_search, search_from
from strainwave.numerics.distributions import chi_square_limit

_RIVALS = 3  # effects that are fitted
_OTHERS = 4  # of the same joint, where those explain less than
_HARDLY = 0.25  # of the cost
_AS_GOOD = 0.4  # share of the best one's gain that makes a rival
_TRIAL = 12  # evaluations of each
RIVAL_ROWS = 600_000
"""Compared rows for which fits with one more effect may be evaluated: 62 evaluations of the records
of a usual study, or half a minute of one core."""
_GAIN = 0.1  # predicted, at which they end
_KEPT = 0.5  # share of what a linear step promised that a fit from there must gain
_MOST = 4  # effects that a fit takes up by itself
_MOVES = 3  # parameters that a warning names, of the effect and of the arm
_ALL = 1e-9  # of the cost: what a perfect effect leaves
_LITTLE = 0.5  # share of the cost below which more than the named effect is missing


@dataclass(frozen=True, slots=True)
class Refit:
    """A fit with one more effect."""

    one: NamedEffect
    fit: Fit
    gain: float  # of the cost, less what so many parameters gain by chance
    share: float
    evidence: float
    shifts: tuple[ParameterShift, ...]


def evidence_of(share: float, parameters: int, cost: float) -> float:
    """By what an effect lowers Schwarz's information criterion: n ln(1 / (1 - share)) - p ln n.

    Weights make every independent error one, so that the cost is their number n. What residuals
    that are not noise leave to chance grows with them: an effect of many sizes must explain more
    of them than one of a single size.

    `share`: Of the cost that it explains.
    `parameters`: That it has, p.
    `cost`: Without it.
    """
    n = max(cost, 1.0)
    return -n * math.log(max(1.0 - share, _ALL)) - parameters * math.log(n)


@dataclass(frozen=True, slots=True)
class Refits:
    """Fits with one more effect each, and the effects for which the budget did not suffice."""

    fits: tuple[Refit, ...]  # the likeliest first; without those that explain no more than chance
    not_fitted: tuple[NamedEffect, ...]
    evaluations: int  # budget that was given, in evaluations of the fit's objective


@dataclass(frozen=True, slots=True)
class _Steps:
    """A fit in long steps of the integrator, and in those of its own."""

    long: Fit
    own: Fit

    @classmethod
    def of(cls, fit: Fit) -> _Steps:
        long = in_long_steps(fit)
        if long is not fit:
            long = replace(long, objective=long.objective.with_step_errors(fit.z))
        return cls(long, fit)


class _Budget:
    """Evaluations that fits with one more effect may spend."""

    def __init__(self, fit: Fit, options: TuningOptions) -> None:
        n_rows = sum(len(record.time) for record in fit.objective.records)
        self.evaluations = int(options.rival_effort * RIVAL_ROWS / n_rows)
        self.left = self.evaluations
        self.refused: list[NamedEffect] = []

    @property
    def of_next(self) -> int:
        """Evaluations of the next search."""
        return min(_TRIAL, self.left)


def refits_of(fit: Fit, tested: Sequence[Tested], arm: Arm, options: TuningOptions) -> Refits:
    """Fit each of the effects that explain most, if any is promising, within a budget.

    `fit` is at its minimum, and `tested` is in the order of significance.
    """
    named = named_effects(arm)
    promising = [one for one in tested if one.promising and one.one not in named]
    if not promising:
        return Refits((), (), 0)
    least = _AS_GOOD * max(map(_promise, promising))
    rivals = sorted(
        (one for one in tested if _promise(one) >= least and one.one not in named),
        key=lambda one: -_promise(one),
    )
    budget = _Budget(fit, options)
    steps = _Steps.of(fit)
    found = _likely(steps, rivals[:_RIVALS], arm, options, budget)
    if not found or found[0].share < _HARDLY or effect_named(found[0].one[1]).by_record:
        # a linear step may not see them, and what changes by record stands for much else
        joint = found[0].one[0] if found else promising[0].test.joint
        others = [one for one in tested if one.test.joint == joint and one.one not in named]
        others = [one for one in others if one not in rivals[:_RIVALS]]
        others.sort(key=_promise, reverse=True)
        found += _likely(steps, others[:_OTHERS], arm, options, budget)
    return Refits(tuple(_by_evidence(found)), tuple(budget.refused), budget.evaluations)


def _by_evidence(refits: Iterable[Refit]) -> list[Refit]:
    """The likeliest first."""
    return sorted(refits, key=lambda one: -one.evidence)


def _likely(
    steps: _Steps, rivals: Sequence[Tested], arm: Arm, options: TuningOptions, budget: _Budget
) -> list[Refit]:
    """Fits with each of some effects that explain more than chance, the most likely first."""
    found = []
    for one in rivals:
        if not budget.of_next:
            budget.refused.append(one.one)
            continue
        refit = _refit(steps.long, one, arm, options, budget)
        if refit is None and steps.own is not steps.long:  # too stiff an effect for long steps
            refit = _refit(steps.own, one, arm, options, budget)
        if refit is not None and _shows(refit, one.chance):
            found.append(refit)
    return _by_evidence(found)


def _promise(tested: Tested) -> float:
    """What an effect takes off the cost alone, or beside a likelier one that hides it."""
    return max(tested.alone, tested.test.gain if tested.promising else 0.0)


def _refit(
    fit: Fit, tested: Tested, arm: Arm, options: TuningOptions, budget: _Budget
) -> Refit | None:
    """The fit with an effect; None where no arm can be there.

    From where the effect's linear step leads, and where that gains less than it promised, from
    the fit without it.
    """
    n = len(fit.objective.space.unknowns)
    here = fit.objective.space.values(fit.z)
    sizes = {key: value for key, value in tested.values.items() if key not in here}
    loads = loads_of(fit.objective.records, here)
    found: Fit | None = None
    for start in (tested.values, here | sizes):
        limited = replace(options, max_iterations=budget.of_next)
        if not budget.of_next:
            break
        other = _fitted_with(fit, tested.one, start, loads, arm, limited)
        budget.left -= budget.of_next if other is None else min(other.iterations, budget.left)
        if other is not None and (found is None or other.cost < found.cost):
            found = other
        if found is not None and fit.cost - tested.rigid - found.cost > _KEPT * tested.alone:
            break
    if found is None:
        return None
    gain = fit.cost - tested.rigid - found.cost
    moved = tuple(shifts(fit, found.objective.space.values(found.z)))
    more = len(found.objective.space.unknowns) - n
    share = gain / max(fit.cost, 1e-300)
    evidence = evidence_of(share, more, fit.cost)
    return Refit(tested.one, found, gain - more, share, evidence, moved)


def _fitted_with(
    fit: Fit,
    one: NamedEffect,
    start: Values,
    loads: Loads,
    arm: Arm,
    options: TuningOptions,
) -> Fit | None:
    """Search shortly with one more effect from given values, and correct the step error there."""
    space = fit.objective.space
    extended, begin = with_effects(space, [one], arm, start, loads, fit.records)
    objective = replace(
        fit.objective.for_unknowns(extended),
        records=records_with(fit.objective.records, _having(arm, one), extended.keys),
    )
    try:
        found = search_from(objective, begin, 0, options, tolerance=_GAIN)
        objective = found.objective.corrected(found.z)
        return search_from(objective, found.z, found.iterations, options, tolerance=_GAIN)
    except (InvalidInput, NotIdentifiable, NumericalFailure):
        return None


def _in_short_steps(fit: Fit, refit: Refit, arm: Arm) -> tuple[Objective, FloatArray]:
    """The objective of a fit with the effect of a refit, and where that ended."""
    space = refit.fit.objective.space
    records = records_with(fit.objective.records, _having(arm, refit.one), space.keys)
    return replace(fit.objective.for_unknowns(space), records=records), refit.fit.z


def _having(arm: Arm, one: NamedEffect) -> Arm:
    """An arm whose joint may have one more effect."""
    number, effect = one
    return arm.with_joints(
        replace(joint, effects=tuple(dict.fromkeys((*joint.possible_effects, effect))))
        if k == number
        else joint
        for k, joint in enumerate(arm.joints, start=1)
    )


def _shows(refit: Refit, chance: float) -> bool:
    """Whether a fitted effect explains more than chance, and something that matters."""
    degrees = len(_own_parameters(refit))
    significant = refit.gain + degrees > chi_square_limit(chance, degrees)
    return significant and refit.evidence > 0.0 and matters(refit.share, refit.shifts)


def _own_parameters(refit: Refit) -> set[Key]:
    """The parameters of its effect."""
    joint, effect = refit.one
    own = effect_named(effect).names
    keys = refit.fit.objective.space.keys
    return {key for key in keys if key[1] == joint and base_name(key[0]) in own}


def causes_of(refits: Sequence[Refit], arm: Arm) -> Iterator[Cause]:
    """What the fitted effects mean to a reader."""
    for refit in refits:
        joint, effect = refit.one
        values = refit.fit.objective.space.values(refit.fit.z)
        largest = gear_torques(refit.fit.objective.records, values).tolist()
        parameters, _ = parameters_of(refit.fit, _having(arm, refit.one), largest)
        yield Cause(
            joint,
            effect,
            tuple(p for p in parameters if (p.name, p.joint) in _own_parameters(refit)),
            refit.gain,
            refit.share,
            refit.shifts,
        )


def with_demanded_effects(fit: Fit, selection: Selection) -> Fit:
    """With the effects that the records demand, in joints whose effects are "auto".

    One after the other, the likeliest of those that are evident, until none is: with noise for
    residuals the odds of taking up any are `FALSE_ALARMS`.
    """
    arm = selection.arm
    if not any(joint.selects_effects for joint in arm.joints):
        return fit
    for _ in range(_MOST):
        tested = [
            one
            for one in score_tests_of(fit, arm)
            if arm.joints[one.test.joint - 1].selects_effects
        ]
        refits = refits_of(fit, tested, arm, selection.options)
        if not refits.fits:
            break
        selection.renew(fit)
        objective, z = _in_short_steps(fit, refits.fits[0], arm)
        fit = fine_search(objective, z, fit.iterations, selection.options)
    return fit


def budget_warnings(refits: Refits) -> Iterator[Diagnostic]:
    """The effects that were not fitted because the budget for such fits was spent."""
    if refits.not_fitted:
        names = ", ".join(f"{effect} of joint {joint}" for joint, effect in refits.not_fitted)
        text = f"{names} might explain the residuals, but the {refits.evaluations} evaluations for"
        text += " fits with one more effect were spent before: the likely cause may be one of"
        text += " these. Raise tuning.rival_effort to fit them"
        yield Diagnostic("causes-not-fitted", "tuning", text)


def cause_warnings(causes: Sequence[Cause]) -> Iterator[Diagnostic]:
    """The most likely cause: what it explains and moves, and the experiment that confirms it.

    `causes`: The most likely first.

    Yields: One at a time: what the others would explain is known only with this one in the model.
    """
    for cause in causes[:1]:
        effect = effect_named(cause.effect)
        known = [p for p in cause.parameters if p.value is not None and p.std is not None]
        sizes = ", ".join(
            f"{p.name} {p.value:.2g} +- {p.std:.1g} {p.unit}".rstrip() for p in known[:_MOVES]
        )
        text = f"{cause.effect} would explain {100.0 * cause.share:.2g} % of the residuals"
        text += f" ({sizes})"
        if cause.shifts:
            text += f", and move {_moves(cause.shifts)}"
        rivals = [f"{other.effect} of joint {other.joint}" for other in causes[1:]]
        if rivals:
            text += f"; less likely, {' or '.join(rivals)}"
        if cause.share < _LITTLE:
            text += "; it leaves most of them unexplained"
        text += f'; give the joint effects = ["{cause.effect}"], or "auto", to fit it;'
        text += f" to be sure, {effect.experiment}"
        yield Diagnostic(effect.warning_code, f"joint {cause.joint}", text)


def _moves(moves: Sequence[ParameterShift]) -> str:
    """The parameters that an effect moves most, in words."""
    return ", ".join(
        f"{move.name}{'' if move.joint is None else f' of joint {move.joint}'} by"
        f" {100.0 * move.shift / move.without:+.2g} %"
        for move in moves[:_MOVES]
        if move.without
    )


def taken_up(fit: Fit, arm: Arm) -> Iterator[Diagnostic]:
    """The effects that a fit took up by itself.

    `arm`: As in the study.
    """
    for number, name in effects_in(fit.objective.space, arm):
        if arm.joints[number - 1].selects_effects:
            effect = effect_named(name)
            text = f"{name}, {effect.description}, was taken into the model: without it"
            text += f" {effect.consequence}; to be sure, {effect.experiment}"
            yield Diagnostic("effect-taken-up", f"joint {number}", text)
