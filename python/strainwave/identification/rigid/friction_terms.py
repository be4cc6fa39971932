"""Fits of a rigid model with further terms: shapes, corrections of the signals, estimates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, FrictionTerm, Parameter, Place
from strainwave.domain.arm.description import unit_in
from strainwave.domain.arm.effects import effect_named
from strainwave.domain.results.estimates import physical_range
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import CORRECTIONS, DELAY, ZERO, correct
from strainwave.identification.rigid.equations import FurtherTerm
from strainwave.identification.rigid.model_choice import MIN_STDS, STRIBECK, is_selected
from strainwave.identification.rigid.trial import (
    Motion,
    Trial,
    excess_variance,
    fit_trial,
    neighbours,
    prepare_all,
)

LOAD = "load-friction"
_MAX_ITERATIONS = 12
MAX_POWER_RATIO = 0.5
"""Ratio of squared residuals from which a delay or a distant encoder zero corrects the signals."""

# changes at convergence, and largest changes in one iteration: of a shape's logarithm, and of
# corrections in prior standard deviations
_SHAPE_TOLERANCE, _MAX_SHAPE_CHANGE = 0.02, 0.7
_TOLERANCE, _MAX_CHANGE = 1e-4, 0.5


def fit_with_terms(trial: Trial, motions: Sequence[Motion], terms: Sequence[FurtherTerm]) -> Trial:
    """Fit with terms at the bandwidth of a trial, by Gauss-Newton iterations.

    They estimate Stribeck velocities, and the corrections of the signals. Terms that the study
    does not name are left out if their size is impossible.
    """
    for _ in range(_MAX_ITERATIONS):
        trial = refit(trial, motions, terms)
        sizes, shapes = (
            trial.factor.common[: len(terms)].tolist(),
            iter(trial.factor.common[len(terms) :].tolist()),
        )
        deviations = trial.equations.common_deviation[: len(terms)].tolist()
        moved, has_converged = [], True
        for c, size, deviation in zip(terms, sizes, deviations, strict=True):
            if c.effect in CORRECTIONS:
                limit = _MAX_CHANGE * deviation
                step = min(max(size, -limit), limit)
                has_converged &= abs(size) <= _TOLERANCE * deviation
                moved.append(replace(c, corrected=c.corrected + step))
            elif c.effect == STRIBECK:
                change = 0.0 if c.size is None else next(shapes)
                step = min(max(change, -_MAX_SHAPE_CHANGE), _MAX_SHAPE_CHANGE)
                has_converged &= c.size is not None and abs(change) <= _SHAPE_TOLERANCE
                moved.append(replace(c, shape=c.shape * float(np.exp(step)), size=size))
            else:
                moved.append(c)
        possible = [
            c
            for c, size in zip(moved, sizes, strict=True)
            if (c.corrected or size) >= 0.0
            or physical_range(effect_named(c.effect).sizes[0]) == "any"
            or not is_selected(trial.arm, c)
        ]
        if has_converged and len(possible) == len(moved):
            break
        terms = possible
    turned = [
        # half a turn away if gravity pulls the link of a planar arm up there
        replace(c, corrected=c.corrected - math.copysign(math.pi, c.corrected))
        if c.effect == ZERO and _gravity_torque(trial, c.joint) < 0.0
        else c
        for c in trial.candidates
    ]
    return refit(trial, motions, turned) if turned != list(trial.candidates) else trial


def _gravity_torque(trial: Trial, joint: int) -> float:
    """Gravity torque of the link of a planar arm, its joint from 0; zero for chains."""
    key = (f"gravity_torque_{joint + 1}", None)
    keys = [column.key for column in trial.arm.rigid_columns]
    return float(dict(zip(keys, trial.solution, strict=True)).get(key, 0.0))


def with_delay(
    trial: Trial, motions: Sequence[Motion], candidates: Sequence[FurtherTerm]
) -> list[FurtherTerm]:
    """Candidates with the torque delay of least residuals, if it is significant and halves them.

    A smaller delay is a candidate as others.
    """
    delays = [c for c in candidates if c.effect == DELAY]
    limit = MAX_POWER_RATIO * trial.residual_power
    if not delays or refit(trial, motions, delays).residual_power > limit:
        return list(candidates)
    fit = fit_with_terms(trial, motions, delays)
    is_shown = fit.residual_power < limit and not insignificant([fit], fit.common_deviation)
    return [
        *(c for c in candidates if c.effect != DELAY),
        *(fit.candidates if is_shown else delays),
    ]


def with_coarse_zeros(
    trial: Trial, motions: Sequence[Motion], candidates: Sequence[FurtherTerm]
) -> tuple[Trial, list[FurtherTerm]]:
    """Candidates whose encoder zeros start at the best eighth of a turn, with the trial there.

    From a distant start, the gravity torque vanishes and a spring explains its remainder. Chains
    have the centres of mass of their links anywhere, so that a distant zero is another centre.
    """
    result = list(candidates)
    for k, c in enumerate(result):
        if (
            c.effect != ZERO
            or trial.arm.base.has_groups
            or trial.arm.joints[c.joint].motion != "revolute"
        ):
            continue
        for eighth in (-3, -2, -1, 1, 2, 3):
            moved = [*result[:k], replace(c, corrected=eighth * math.pi / 4.0), *result[k + 1 :]]
            corrected = corrected_motions(trial.arm, motions, moved)
            stretches = prepare_all(trial.arm, corrected, trial.bandwidth_hz)
            other = fit_trial(trial.arm, stretches, None)
            is_better = other.residual_power < MAX_POWER_RATIO * trial.residual_power
            if _gravity_torque(other, c.joint) > 0.0 and is_better:  # otherwise half a turn further
                trial, result = other, moved
    return trial, result


def refit(trial: Trial, motions: Sequence[Motion], terms: Sequence[FurtherTerm]) -> Trial:
    """Fit at the bandwidth of a trial with terms as they are."""
    stretches = trial.stretches
    if any(c.corrected for c in terms):
        corrected = corrected_motions(trial.arm, motions, terms)
        stretches = prepare_all(trial.arm, corrected, trial.bandwidth_hz)
    weights = trial.factor.root
    return fit_trial(trial.arm, stretches, trial.estimate, candidates=terms, weights=weights)


def corrected_motions(
    arm: Arm, motions: Sequence[Motion], terms: Sequence[FurtherTerm]
) -> list[Motion]:
    """Motions without the encoder zeros and delays by which terms correct the signals."""
    values = [(c.effect, c.joint, c.corrected) for c in terms if c.corrected]
    return [(correct(signals, arm, values), period) for signals, period in motions]


def estimated_terms(
    trials: Sequence[Trial], best: Trial, changes: Sequence[Mapping[str, float]]
) -> tuple[FrictionTerm, ...]:
    """Sizes and shapes of the terms of a trial, with the changes of other values.

    The standard deviations include the scatter between neighbouring bandwidths.
    """
    candidates = best.candidates
    values, nearby = best.factor.common, neighbours(trials, best)
    others = [(t.factor.common, t.common_deviation**2) for t in nearby]
    stds = np.sqrt(best.common_deviation**2 + excess_variance(values, others))
    width, at_shape = best.interval_half_width, len(candidates)
    terms = []
    for k, candidate in enumerate(candidates):
        effect, joint = effect_named(candidate.effect), candidate.joint + 1 or None
        key, value = (effect.sizes[0], joint), candidate.corrected + float(values[k])
        unit = unit_in(best.arm, key)
        size = Parameter.estimated(key, value, float(stds[k]), unit, "rigid", width)
        shape = None
        if candidate.size is not None:
            (name,) = effect.shapes
            std, unit = candidate.shape * float(stds[at_shape]), unit_in(best.arm, (name, joint))
            shape = Parameter.estimated((name, joint), candidate.shape, std, unit, "rigid", width)
            at_shape += 1
        law = candidate.effect, joint, size, candidate.shape
        terms.append(FrictionTerm(*law, shape, changes[k]))
    return tuple(terms)


def insignificant(trials: Sequence[Trial], stds: FloatArray) -> list[FurtherTerm]:
    """Terms of a fit, the first trial, that it and its neighbours do not show, at most one a joint.

    `stds` (n_terms, ...) are the standard deviations of the sizes. They are those at the estimated
    shapes: the size of a term is uncertain if its shape is, even if the term is certain.
    """
    fit, *others = trials
    n = len(fit.candidates)
    values = np.array([c.corrected for c in fit.candidates]) + fit.factor.common[:n]
    excess = excess_variance(
        fit.factor.common[:n],
        [(t.factor.common[:n], t.common_deviation[:n] ** 2) for t in others],
    )
    z = np.abs(values) / np.sqrt(stds[:n] ** 2 + excess + np.finfo(float).tiny)
    joints = np.array([c.joint for c in fit.candidates])
    return [
        c
        for c, own in zip(fit.candidates, z, strict=True)
        if own < MIN_STDS and own == z[joints == c.joint].min()
    ]


def term_warning(term: FrictionTerm) -> Diagnostic:
    """State that the model of a joint has a further term."""
    place = Place(joint=term.joint)
    size = term.size
    if term.effect == LOAD:
        return Diagnostic("load-friction", place, share=size.value, std=size.std)
    effect = effect_named(term.effect)
    variant = {ZERO: "zero", DELAY: "delay"}.get(term.effect)
    return Diagnostic(
        "friction-term",
        place,
        *([variant] if variant else []),
        description=effect.description,
        label=size.name,
        value=size.value,
        std=size.std,
        unit=size.unit,
    )
