"""Friction of rigid joints in addition to viscous and Coulomb friction, where the data support it.

Candidates are effects of the joint model: friction that grows with the load, that falls with the
velocity near standstill (Stribeck), and that grows with a power of the velocity.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, FrictionTerm, Parameter, Place
from strainwave.domain.combinations import FRICTION_COLUMNS
from strainwave.domain.effects import effect_named
from strainwave.domain.units import unit_in
from strainwave.identification.rigid.bandwidth import excess_variance, neighbours
from strainwave.identification.rigid.equations import Candidate, Terms, assemble
from strainwave.identification.rigid.stretch import n_compliances
from strainwave.identification.rigid.trial import Trial
from strainwave.numerics import least_squares as ls

LOAD, STRIBECK, POWER = "load-friction", "stribeck", "power-friction"
# significance of a term in standard deviations of the jackknife: 1e-4 false alarms
_MIN_STDS = 4.0
_MIN_LOAD_FRICTION = 0.01  # of the load; smaller shares are below the error of the torque constant
_MAX_ROUNDS = 4  # of the selection; each adds at most one term per joint
# Stribeck velocities over the largest velocity of the joint; below, the encoder hides the effect
_STRIBECK_VELOCITIES = (0.03, 0.06, 0.12, 0.25)
_MAX_SHAPE_ITERATIONS = 6
_SHAPE_TOLERANCE = 0.02  # change of a shape's logarithm at convergence
_MAX_LOG_CHANGE = 0.7  # of a shape in one iteration
# Rows are four per period of the cut-off; a low-passed signal has two independent values.
_ROWS_PER_INDEPENDENT_ROW = 2.0


def _is_supported(trial: Trial, k: int, candidate: Candidate) -> bool:
    """Whether a term is significant and no parameter of its joint is impossible."""
    smallest = _MIN_LOAD_FRICTION if candidate.effect == LOAD else 0.0
    size, std = trial.factor.common[k], trial.common_deviation[k]
    implausible = {trial.arm.rigid_columns[i].joint for i in trial.implausible}
    return bool(size > max(smallest, _MIN_STDS * std)) and candidate.joint + 1 not in implausible


def select_terms(best: Trial, load_friction: bool | None) -> tuple[Candidate, ...]:
    """Terms that the data support, with their shapes at the selected bandwidth.

    Adds the term of each joint that decreases the BIC most, while terms are significant.

        BIC = n ln(cost) + ln(n) (number of terms and shapes)

    with n independent rows of the joint. Empty for arms with elastic gears: their load is not known
    accurately enough, and the whole-arm fit estimates the friction. `load_friction` is the option:
    True includes the load friction of all joints, False of none. Planar arms and single joints have
    no other candidates, as published.
    """
    arm = best.arm
    if n_compliances(arm):
        return ()
    columns = best.determined[arm.n_body : arm.n_body + FRICTION_COLUMNS * arm.n_joints]
    is_determined = columns.reshape(arm.n_joints, FRICTION_COLUMNS).all(axis=1)
    chosen = [Candidate(LOAD, joint) for joint in range(arm.n_joints)] if load_friction else []
    effects = [STRIBECK, POWER] if arm.base.has_groups else []
    effects += [LOAD] if load_friction is None else []
    rest = {(e, i) for e in effects for i in np.flatnonzero(is_determined).tolist()}
    for _ in range(_MAX_ROUNDS):
        trial = best.refit_with_terms(chosen) if chosen else best
        rest -= {(c.effect, c.joint) for c in chosen}
        added = _best_candidates(trial, chosen, rest)
        if not added:
            break
        while added:
            trial = best.refit_with_terms([*chosen, *added])
            places = range(len(chosen), len(chosen) + len(added))
            kept = [c for k, c in zip(places, added, strict=True) if _is_supported(trial, k, c)]
            rest -= {(c.effect, c.joint) for c in added if c not in kept}
            if len(kept) == len(added):
                break
            added = kept
        chosen += added
    return _with_shapes(best, chosen).candidates if chosen else ()


def _best_candidates(
    trial: Trial, chosen: Sequence[Candidate], rest: Collection[tuple[str, int]]
) -> list[Candidate]:
    """The candidate of each joint with the largest decrease of the BIC, if any decreases it.

    `rest` has the effects and joints, from 0, that may be added.
    """
    n_joints = trial.arm.n_joints
    n = np.bincount(trial.equations.group, minlength=n_joints) / _ROWS_PER_INDEPENDENT_ROW
    cost = _costs(trial, chosen)[0]
    least: dict[int, tuple[float, Candidate]] = {}
    for effect, shapes in _alternatives(trial):
        added = [Candidate(effect, i, shapes[i]) for i in range(n_joints) if (effect, i) in rest]
        if not added:
            continue
        costs, sizes = _costs(trial, [*chosen, *added])
        for candidate, size in zip(added, sizes[len(chosen) :].tolist(), strict=True):
            i = candidate.joint
            n_unknowns = 2 if effect == STRIBECK else 1
            if size > 0.0 and cost[i] > 0.0:
                change = float(n[i] * np.log(costs[i] / cost[i]) + n_unknowns * np.log(n[i]))
                if change < least.get(i, (0.0, candidate))[0]:
                    least[i] = change, candidate
    return [candidate for _, candidate in least.values()]


def _alternatives(trial: Trial) -> Iterator[tuple[str, list[float]]]:
    """Effects with a shape for each joint."""
    velocities = [np.abs(s.signals.motor_velocity).max(axis=0) for s in trial.stretches]
    largest = np.maximum(np.max(velocities, axis=0), np.finfo(float).tiny)
    yield LOAD, [1.0] * len(largest)
    for share in _STRIBECK_VELOCITIES:
        yield STRIBECK, (share * largest).tolist()
    # at its usual value: size and exponent have nearly the same effect
    (exponent,) = effect_named(POWER).shapes.values()
    yield POWER, [exponent] * len(largest)


def _costs(trial: Trial, candidates: Sequence[Candidate]) -> tuple[FloatArray, FloatArray]:
    """Weighted squared residuals of each joint and sizes of the terms, by one solution."""
    terms = Terms.of(candidates, trial.stretches)
    equations = assemble(trial.arm, trial.stretches, trial.estimate, terms)
    factor = ls.factorise(equations, trial.factor.root)
    squares = (trial.factor.root * ls.residual_of(equations, factor)) ** 2
    costs = np.bincount(equations.group, squares, minlength=trial.arm.n_joints)
    return np.asarray(costs, dtype=np.float64), factor.common


def _with_shapes(best: Trial, candidates: Sequence[Candidate]) -> Trial:
    """Fit with terms whose Stribeck velocities are estimated by Gauss-Newton iterations."""
    trial = best.refit_with_terms(candidates)
    n = len(candidates)
    for _ in range(_MAX_SHAPE_ITERATIONS):
        current = [
            replace(c, size=float(size)) if c.effect == STRIBECK else c
            for c, size in zip(trial.candidates, trial.factor.common[:n], strict=True)
        ]
        if all(c.size is None for c in current):
            break
        trial = best.refit_with_terms(current)
        changes = np.zeros(n)
        changes[[k for k, c in enumerate(current) if c.size is not None]] = trial.factor.common[n:]
        if np.all(np.abs(changes) < _SHAPE_TOLERANCE):
            break
        steps = np.exp(np.clip(changes, -_MAX_LOG_CHANGE, _MAX_LOG_CHANGE)).tolist()
        moved = [replace(c, shape=c.shape * f) for c, f in zip(current, steps, strict=True)]
        trial = replace(trial, candidates=tuple(moved))
    return trial


def estimated_terms(trials: Sequence[Trial], best: Trial) -> tuple[FrictionTerm, ...]:
    """Sizes and shapes of the terms of a trial.

    The standard deviations include the scatter between neighbouring bandwidths.
    """
    candidates = best.candidates
    values, nearby = best.factor.common, neighbours(trials, best)
    others = [(t.factor.common, t.common_deviation**2) for t in nearby]
    stds = np.sqrt(best.common_deviation**2 + excess_variance(values, others))
    width, at_shape = best.interval_half_width, len(candidates)
    terms = []
    for k, candidate in enumerate(candidates):
        effect, joint = effect_named(candidate.effect), candidate.joint + 1
        key = effect.sizes[0], joint
        size = Parameter.estimated(
            key, float(values[k]), float(stds[k]), unit_in(best.arm, key), "rigid", width
        )
        shape = None
        if candidate.size is not None:
            (name,) = effect.shapes
            std, unit = candidate.shape * float(stds[at_shape]), unit_in(best.arm, (name, joint))
            shape = Parameter.estimated((name, joint), candidate.shape, std, unit, "rigid", width)
            at_shape += 1
        terms.append(FrictionTerm(candidate.effect, joint, size, candidate.shape, shape))
    return tuple(terms)


def term_warning(term: FrictionTerm) -> Diagnostic:
    """State that the friction of a joint has a further term."""
    place = Place(joint=term.joint)
    size = term.size
    if term.effect == LOAD:
        return Diagnostic("load-friction", place, share=size.value, std=size.std)
    effect = effect_named(term.effect)
    return Diagnostic(
        "friction-term",
        place,
        description=effect.description,
        label=size.name,
        value=size.value,
        std=size.std,
        unit=size.unit,
    )
