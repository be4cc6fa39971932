"""Find the effect that a model most likely lacks: fit each of the best score tests.

A score test is one linear step. Effects that resemble one another in that step differ in what they
explain once they are fitted, with the shapes and limits of their laws.
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

MAX_RIVAL_EFFECTS = 3  # fitted effects of largest promise
MAX_OTHER_EFFECTS = 4  # fitted effects of the same joint if the rivals explain too little
MIN_EXPLAINED_SHARE = 0.25  # of the cost; below, further effects of the joint are fitted
MIN_RIVAL_GAIN_SHARE = 0.4  # of the best effect's linear gain
MAX_REFIT_EVALUATIONS = 12  # of each search; nearly all converge in 4 to 9
RIVAL_ROWS = 600_000
"""Budget of fits with one additional effect, in evaluated residual rows: 62 evaluations of a study
of 9,700 rows, about half a minute of one core."""
REFIT_GAIN_TOLERANCE = 0.1  # predicted cost reduction at which a search ends
MIN_KEPT_PROMISE = 0.5  # share of the linear gain below which a second start is tried
MAX_AUTO_EFFECTS = 4  # effects that a fit adds
MAX_NAMED_PARAMETERS = 3  # in a warning, of the effect and of the arm
MIN_UNEXPLAINED_SHARE = 1e-9  # of the cost; keeps the logarithm finite
MIN_SUFFICIENT_SHARE = 0.5  # of the cost; below, the warning says that more is missing


@dataclass(frozen=True, slots=True)
class Refit:
    """A fit with one additional effect."""

    one: NamedEffect
    fit: Fit
    gain: float  # of the cost, less what so many parameters gain by chance
    share: float
    evidence: float
    shifts: tuple[ParameterShift, ...]


def evidence_of(share: float, parameters: int, cost: float) -> float:
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

    fits: tuple[Refit, ...]  # the likeliest first; without those that explain no more than chance
    not_fitted: tuple[NamedEffect, ...]
    evaluations: int  # budget that was given, in evaluations of the fit's objective


@dataclass(frozen=True, slots=True)
class _Steps:
    """A fit in long integrator steps and in its own steps."""

    long: Fit
    own: Fit

    @classmethod
    def of(cls, fit: Fit) -> _Steps:
        long = in_long_steps(fit)
        if long is not fit:
            long = replace(long, objective=long.objective.with_step_errors(fit.z))
        return cls(long, fit)


class _Budget:
    """Evaluations available for fits with one additional effect."""

    def __init__(self, fit: Fit, options: TuningOptions) -> None:
        n_rows = sum(len(record.time) for record in fit.objective.records)
        self.evaluations = int(options.rival_effort * RIVAL_ROWS / n_rows)
        self.left = self.evaluations
        self.refused: list[NamedEffect] = []

    @property
    def of_next(self) -> int:
        """Maximum evaluations of the next search."""
        return min(MAX_REFIT_EVALUATIONS, self.left)


def refits_of(fit: Fit, tested: Sequence[Tested], arm: Arm, options: TuningOptions) -> Refits:
    """Fit each of the most significant effects, within a budget of evaluations.

    No effect is fitted unless one is promising. `fit` is at its minimum, and `tested` is in order
    of significance.
    """
    named = named_effects(arm)
    promising = [one for one in tested if one.promising and one.one not in named]
    if not promising:
        return Refits((), (), 0)
    least = MIN_RIVAL_GAIN_SHARE * max(map(_promised_gain, promising))
    rivals = sorted(
        (one for one in tested if _promised_gain(one) >= least and one.one not in named),
        key=lambda one: -_promised_gain(one),
    )
    budget = _Budget(fit, options)
    steps = _Steps.of(fit)
    found = _fit_rivals(steps, rivals[:MAX_RIVAL_EFFECTS], arm, options, budget)
    if not found or found[0].share < MIN_EXPLAINED_SHARE or effect_named(found[0].one[1]).by_record:
        # a linear step may not see them, and what changes by record stands for much else
        joint = found[0].one[0] if found else promising[0].test.joint
        others = [one for one in tested if one.test.joint == joint and one.one not in named]
        others = [one for one in others if one not in rivals[:MAX_RIVAL_EFFECTS]]
        others.sort(key=_promised_gain, reverse=True)
        found += _fit_rivals(steps, others[:MAX_OTHER_EFFECTS], arm, options, budget)
    return Refits(tuple(_sort_by_evidence(found)), tuple(budget.refused), budget.evaluations)


def _sort_by_evidence(refits: Iterable[Refit]) -> list[Refit]:
    """Refits in order of decreasing evidence."""
    return sorted(refits, key=lambda one: -one.evidence)


def _fit_rivals(
    steps: _Steps, rivals: Sequence[Tested], arm: Arm, options: TuningOptions, budget: _Budget
) -> list[Refit]:
    """Fit each effect; keep those significant beyond chance, the most likely first."""
    found = []
    for one in rivals:
        if not budget.of_next:
            budget.refused.append(one.one)
            continue
        refit = _refit(steps.long, one, arm, options, budget)
        if refit is None and steps.own is not steps.long:  # too stiff an effect for long steps
            refit = _refit(steps.own, one, arm, options, budget)
        if refit is not None and _is_significant(refit, one.chance):
            found.append(refit)
    return _sort_by_evidence(found)


def _promised_gain(tested: Tested) -> float:
    """Cost reduction by the linear step, alone or with the more significant effects included."""
    return max(tested.alone, tested.test.gain if tested.promising else 0.0)


def _refit(
    fit: Fit, tested: Tested, arm: Arm, options: TuningOptions, budget: _Budget
) -> Refit | None:
    """Fit with one additional effect; None if no such arm can be simulated.

    The search starts where the linear step leads. If it gains less than the linear step promised,
    it also starts from the fit without the effect.
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
        other = _search_with_effect(fit, tested.one, start, loads, arm, limited)
        budget.left -= budget.of_next if other is None else min(other.iterations, budget.left)
        if other is not None and (found is None or other.cost < found.cost):
            found = other
        if (
            found is not None
            and fit.cost - tested.rigid - found.cost > MIN_KEPT_PROMISE * tested.alone
        ):
            break
    if found is None:
        return None
    gain = fit.cost - tested.rigid - found.cost
    moved = tuple(shifts(fit, found.objective.space.values(found.z)))
    more = len(found.objective.space.unknowns) - n
    share = gain / max(fit.cost, 1e-300)
    evidence = evidence_of(share, more, fit.cost)
    return Refit(tested.one, found, gain - more, share, evidence, moved)


def _search_with_effect(
    fit: Fit,
    one: NamedEffect,
    start: Values,
    loads: Loads,
    arm: Arm,
    options: TuningOptions,
) -> Fit | None:
    """Search briefly with one additional effect, correct the step error, and search again."""
    space = fit.objective.space
    extended, begin = with_effects(space, [one], arm, start, loads, fit.records)
    objective = replace(
        fit.objective.for_unknowns(extended),
        records=records_with(fit.objective.records, _with_possible_effect(arm, one), extended.keys),
    )
    try:
        found = search_from(objective, begin, 0, options, tolerance=REFIT_GAIN_TOLERANCE)
        objective = found.objective.corrected(found.z)
        return search_from(
            objective, found.z, found.iterations, options, tolerance=REFIT_GAIN_TOLERANCE
        )
    except (InvalidInput, NotIdentifiable, NumericalFailure):
        return None


def _in_short_steps(fit: Fit, refit: Refit, arm: Arm) -> tuple[Objective, FloatArray]:
    """The objective of a refit in the steps of the fit, and the point of the refit."""
    space = refit.fit.objective.space
    records = records_with(fit.objective.records, _with_possible_effect(arm, refit.one), space.keys)
    return replace(fit.objective.for_unknowns(space), records=records), refit.fit.z


def _with_possible_effect(arm: Arm, one: NamedEffect) -> Arm:
    """The arm with one additional possible effect."""
    number, effect = one
    return arm.with_joints(
        replace(joint, effects=tuple(dict.fromkeys((*joint.possible_effects, effect))))
        if k == number
        else joint
        for k, joint in enumerate(arm.joints, start=1)
    )


def _is_significant(refit: Refit, chance: float) -> bool:
    """Whether a fitted effect is significant and matters."""
    degrees = len(_own_parameters(refit))
    significant = refit.gain + degrees > chi_square_limit(chance, degrees)
    return significant and refit.evidence > 0.0 and matters(refit.share, refit.shifts)


def _own_parameters(refit: Refit) -> set[Key]:
    """The parameters of the refit's effect."""
    joint, effect = refit.one
    own = effect_named(effect).names
    keys = refit.fit.objective.space.keys
    return {key for key in keys if key[1] == joint and base_name(key[0]) in own}


def causes_of(refits: Sequence[Refit], arm: Arm) -> Iterator[Cause]:
    """The published record of each refit."""
    for refit in refits:
        joint, effect = refit.one
        values = refit.fit.objective.space.values(refit.fit.z)
        largest = gear_torques(refit.fit.objective.records, values).tolist()
        parameters, _ = parameters_of(refit.fit, _with_possible_effect(arm, refit.one), largest)
        yield Cause(
            joint,
            effect,
            tuple(p for p in parameters if (p.name, p.joint) in _own_parameters(refit)),
            refit.gain,
            refit.share,
            refit.shifts,
        )


def with_demanded_effects(fit: Fit, selection: Selection) -> Fit:
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
        refits = refits_of(fit, tested, arm, selection.options)
        if not refits.fits:
            break
        selection.renew(fit)
        objective, z = _in_short_steps(fit, refits.fits[0], arm)
        fit = fine_search(objective, z, fit.iterations, selection.options)
    return fit


def budget_warnings(refits: Refits) -> Iterator[Diagnostic]:
    """Warn about effects that were not fitted because the budget was spent."""
    if refits.not_fitted:
        names = ", ".join(f"{effect} of joint {joint}" for joint, effect in refits.not_fitted)
        text = f"{names} might explain the residuals, but the {refits.evaluations} evaluations for"
        text += " fits with one more effect were spent before: the likely cause may be one of"
        text += " these. Raise tuning.rival_effort to fit them"
        yield Diagnostic("causes-not-fitted", "tuning", text)


def cause_warnings(causes: Sequence[Cause]) -> Iterator[Diagnostic]:
    """Warn about the most likely cause: what it explains, what it changes, how to confirm it.

    Only the first cause gets a warning, because the gain of the others is only known with the first
    one in the model.
    """
    for cause in causes[:1]:
        effect = effect_named(cause.effect)
        known = [p for p in cause.parameters if p.value is not None and p.std is not None]
        sizes = ", ".join(
            f"{p.name} {p.value:.2g} +- {p.std:.1g} {p.unit}".rstrip()
            for p in known[:MAX_NAMED_PARAMETERS]
        )
        text = f"{cause.effect} would explain {100.0 * cause.share:.2g} % of the residuals"
        text += f" ({sizes})"
        if cause.shifts:
            text += f", and move {_shift_text(cause.shifts)}"
        rivals = [f"{other.effect} of joint {other.joint}" for other in causes[1:]]
        if rivals:
            text += f"; less likely, {' or '.join(rivals)}"
        if cause.share < MIN_SUFFICIENT_SHARE:
            text += "; it leaves most of them unexplained"
        text += f'; give the joint effects = ["{cause.effect}"], or "auto", to fit it;'
        text += f" to be sure, {effect.experiment}"
        yield Diagnostic(effect.warning_code, f"joint {cause.joint}", text)


def _shift_text(moves: Sequence[ParameterShift]) -> str:
    """The parameters that an effect changes most, as text."""
    return ", ".join(
        f"{move.name}{'' if move.joint is None else f' of joint {move.joint}'} by"
        f" {100.0 * move.shift / move.without:+.2g} %"
        for move in moves[:MAX_NAMED_PARAMETERS]
        if move.without
    )


def taken_up(fit: Fit, arm: Arm) -> Iterator[Diagnostic]:
    """Warn about the effects that the fit added."""
    for number, name in effects_in(fit.objective.space, arm):
        if arm.joints[number - 1].selects_effects:
            effect = effect_named(name)
            text = f"{name}, {effect.description}, was taken into the model: without it"
            text += f" {effect.consequence}; to be sure, {effect.experiment}"
            yield Diagnostic("effect-taken-up", f"joint {number}", text)
