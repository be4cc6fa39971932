"""What models with one more effect would explain of what a fit left, without fitting them.

A score test: the derivative of every channel by an effect's size, at size nothing, joins the fit's
own derivatives as one more column. What it takes off the cost in one linear step is the evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, ParameterShift, ScoreTest
from strainwave.domain.effects import all_effects, effect_named, names
from strainwave.domain.parameter_table import base_name
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import is_sensor_constant
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.effects import (
    NamedEffect,
    records_with,
    sizes_of,
)
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import Evaluated
from strainwave.identification.whole_arm.parametrisation import (
    OFFSET,
    SETTLING,
    VISCOUS,
    Key,
)
from strainwave.numerics.distributions import chi_square_limit

FALSE_ALARMS = 1e-4
"""Of a fit whose residuals are noise, the odds that any effect seems to be there."""

MATTERS = 0.1
"""Share of the cost from which an effect matters, whatever it moves."""

_ROUNDING = 1e-7  # of a column: less is nothing that the unknowns could not imitate
_INTERVAL = 1.96  # deviations by which moving another parameter does


@dataclass(frozen=True, slots=True)
class Tested:
    """A score test, and where its linear step leads."""

    test: ScoreTest
    alone: float  # what the effect takes off the cost with no other beside it
    values: Values  # of the unknowns after the step

    @property
    def one(self) -> NamedEffect:
        """The joint and the effect."""
        return self.test.joint, self.test.effect


def score_tests_of(fit: Fit, arm: Arm) -> list[Tested]:
    """The effects that no joint's model has yet, the most significant first.

    Parameters
    ----------
    fit : Fit
    arm : Arm

    Returns
    -------
    list of Tested
        Each one's gain is beyond that of those before; empty where the arm with effects
        cannot be simulated.
    """
    candidates = _missing(fit, arm)
    if not candidates:
        return []
    try:
        factor = _bordered(fit, arm, candidates)
    except (InvalidInput, NumericalFailure):
        return []
    sizes = {one: sizes_of(one, fit.records) for one in candidates}
    return list(_chosen(sizes, factor, fit))


def _missing(fit: Fit, arm: Arm) -> list[NamedEffect]:
    known = {(base_name(name), joint) for name, joint in fit.objective.space.keys}
    return [
        (number, effect.name)
        for number, joint in enumerate(arm.joints, start=1)
        for effect in all_effects()
        if joint.elastic and (effect.sizes[0], number) not in known
    ]


def _bordered(fit: Fit, arm: Arm, candidates: Sequence[NamedEffect]) -> FloatArray:
    """R of [unknowns effects residual], then the sizes' priors.

    (n_unknowns + n_keys + 1 + n_priors, n_unknowns + n_keys + 1)
    """
    objective = fit.objective
    pairs = [(one, key) for one in candidates for key in sizes_of(one, fit.records)]
    keys = [key for _, key in pairs]
    stds = [effect_named(effect).prior_std for (_, effect), _ in pairs]
    numbers = range(1, arm.n_joints + 1)
    absent = {name: value for effect in all_effects() for name, value in effect.absent.items()}
    nothing = {(name, j): value for name, value in absent.items() for j in numbers}
    values: Values = nothing | objective.space.values(fit.z)
    joints = tuple(replace(joint, effects=names()) for joint in arm.joints)
    rich = records_with(objective.records, arm.with_joints(joints), values)

    def tangent(k: int, _: Evaluated) -> FloatArray:
        begun = objective.memory.own[k][: len(rich[k].local)]
        return rich[k].linearised(values, begun, keys)[1][..., : len(keys)]

    whole = objective.bordered(fit.z, len(keys), tangent)
    n = len(objective.space.unknowns)
    known = [k for k, std in enumerate(stds) if std is not None]
    prior = np.zeros((len(known), whole.shape[1]))
    for row, k in enumerate(known):
        prior[row, n + k] = 1.0 / (stds[k] or np.inf)
    return np.concatenate([whole, prior])


@dataclass(frozen=True, slots=True)
class _Step:
    """What one effect takes off the cost, and by which sizes."""

    candidate: NamedEffect
    names: tuple[str, ...]
    gain: float
    size: FloatArray
    std: FloatArray

    def beyond(self, chance: float) -> float:
        """What the gain has beyond what as many sizes gain from noise with a chance."""
        return self.gain - chi_square_limit(chance, len(self.size))


def _chosen(
    sizes: Mapping[NamedEffect, Sequence[Key]], whole: FloatArray, fit: Fit
) -> Iterator[Tested]:
    """One after the other, each given those before it as long as they are evident."""
    n = len(fit.objective.space.unknowns)
    factor, columns, places, at = whole[n:, n:], {}, {}, 0
    for one, own in sizes.items():
        end = at + len(own)
        columns[one], places[one] = _seen(whole, n, slice(n + at, n + end)), slice(n + at, n + end)
        at = end
    left, target = list(sizes), factor[:, -1]
    taken = np.zeros((len(target), 0))
    alone: dict[NamedEffect, float] = {}
    chance = FALSE_ALARMS / len(sizes)
    while left:
        steps = [_step(one, sizes[one], columns[one], taken, target) for one in left]
        alone = alone or {step.candidate: step.gain for step in steps}
        best = max(steps, key=lambda step: step.beyond(chance))
        one = best.candidate
        moved = _moved(fit, whole[:n, :n], whole[:n, places[one]] @ best.size)
        found = _scored(best, fit, moved, chance)
        yield Tested(found, alone[one], moved)
        left.remove(one)
        if found.evident:
            taken = np.column_stack([taken, columns[one]])


def _seen(whole: FloatArray, n: int, place: slice) -> FloatArray:
    """What n unknowns leave of an effect's columns: zero where that is rounding."""
    left = whole[n:, place].copy()
    size = np.linalg.norm(whole[:, place], axis=0)
    left[:, np.linalg.norm(left, axis=0) <= _ROUNDING * size] = 0.0
    return left


def _scored(step: _Step, fit: Fit, moved: Values, chance: float) -> ScoreTest:
    """A score test in words of the effect's parameters."""
    joint, effect = step.candidate
    share = step.gain / max(fit.cost, 1e-300)
    significant = step.beyond(chance) > 0.0
    moves = tuple(shifts(fit, moved)) if significant else ()
    return ScoreTest(
        joint=joint,
        effect=effect,
        sizes=dict(zip(step.names, step.size.tolist(), strict=True)),
        stds=dict(zip(step.names, step.std.tolist(), strict=True)),
        gain=step.gain,
        share=share,
        evident=significant and (share > MATTERS or matter(moves)),
        shifts=moves,
    )


def matter(moves: Sequence[ParameterShift]) -> bool:
    """Whether a parameter leaves its 95 % interval.

    Parameters
    ----------
    moves : sequence of ParameterShift

    Returns
    -------
    bool
    """
    return any(abs(move.deviations) > _INTERVAL for move in moves)


def _moved(fit: Fit, factor: FloatArray, by_effect: FloatArray) -> Values:
    """The unknowns after the linear step that makes room for an effect."""
    step = np.asarray(-np.linalg.lstsq(factor, by_effect)[0])
    space = fit.objective.space
    return space.values(space.moved(fit.z, space.trusted(fit.z, step, 1.0)))


def shifts(fit: Fit, values: Values) -> Iterator[ParameterShift]:
    """By how much the arm's parameters differ from a fit's, the most significant first.

    Parameters
    ----------
    fit : Fit
    values : dict
        (name, joint) -> value, in a model with one more effect.

    Yields
    ------
    ParameterShift
        Of inertias, gravity, gears and Coulomb friction: what sensors do is no parameter of the
        arm, and of viscous friction only sums are known.
    """
    before = fit.objective.space.values(fit.z)
    std = np.sqrt(np.diag(fit.confidence.combined))
    found = []
    for (name, joint), deviation in zip(fit.objective.space.keys, std.tolist(), strict=True):
        if _is_primary((name, joint)) and deviation > 0.0:
            shift = values[name, joint] - before[name, joint]
            found.append(ParameterShift(name, joint, before[name, joint], shift, shift / deviation))
    yield from sorted(found, key=lambda move: -abs(move.deviations))


def _is_primary(key: Key) -> bool:
    others = (*VISCOUS, OFFSET, SETTLING)
    of_effects = {name for effect in all_effects() for name in effect.names}
    name = base_name(key[0])
    return not (name in others or name in of_effects or is_sensor_constant(key))


def _step(
    candidate: NamedEffect,
    sizes: Sequence[Key],
    columns: FloatArray,
    taken: FloatArray,
    target: FloatArray,
) -> _Step:
    """The best sizes of one effect beside those taken already; none below nothing."""
    basis = np.linalg.qr(taken)[0]
    columns = columns - basis @ (basis.T @ columns)
    target = target - basis @ (basis.T @ target)
    effect = effect_named(candidate[1])
    signed = np.array([effect.is_signed(name) for name, _ in sizes])
    size = least_squares(columns, target, signed)
    gain = float(np.sum(target**2) - np.sum((target + columns @ size) ** 2))
    std = np.sqrt(np.diag(np.linalg.pinv(columns.T @ columns)))
    return _Step(candidate, tuple(name for name, _ in sizes), gain, size, std)


def least_squares(columns: FloatArray, target: FloatArray, signed: BoolArray) -> FloatArray:
    """Sizes that take most off the target; those without sign that come out negative are zero.

    Parameters
    ----------
    columns : (n_rows, n_sizes)
    target : (n_rows,)
    signed : (n_sizes,)

    Returns
    -------
    (n_sizes,)
    """
    free, size = np.ones(len(signed), dtype=bool), np.zeros(len(signed))
    while free.any():
        size[free] = np.linalg.lstsq(columns[:, free], -target)[0]
        negative = ~signed & (size < 0.0)
        if not negative.any():
            break
        size[:], free = 0.0, free & ~negative
    return size
