"""What models with one more effect would explain of what a fit left, without fitting them.

A score test: the derivative of every channel by an effect's size, at size nothing, joins the fit's
own derivatives as one more column. What it takes off the cost in one linear step is the evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, ParameterShift, ScoreTest
from strainwave.domain.effects import Effect, all_effects, effect_named
from strainwave.domain.parameter_table import base_name
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import is_sensor_constant
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.effect_columns import EffectColumns, Hypothesis, Shapes
from strainwave.identification.whole_arm.effects import (
    NamedEffect,
    effects_in,
    known_joint,
)
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.loads import loads_of
from strainwave.identification.whole_arm.parametrisation import (
    OFFSET,
    SETTLING,
    VISCOUS,
    Key,
)
from strainwave.identification.whole_arm.residual_analysis import exceed_noise
from strainwave.numerics.distributions import chi_square_limit

FALSE_ALARMS = 1e-4
"""Of a fit whose residuals are noise, the odds that any effect seems to be there."""

MATTERS = 0.04
"""Share of the cost from which an effect matters, whatever it moves."""

LEAST = 0.01
"""Share of the cost below which none does: an error of another kind explains as much."""

_INTERVAL = 1.96  # deviations by which moving another parameter does


@dataclass(frozen=True, slots=True)
class Tested:
    """A score test, and where its linear step leads."""

    test: ScoreTest
    chance: float  # odds by which noise may pass for an effect, of each that is tested
    alone: float  # what the effect takes off the cost with no other beside it
    rigid: float  # and before that, not trusting what the rigid step says for lack of it
    values: Values  # of the unknowns, sizes and unusual shapes, after that step alone

    @property
    def one(self) -> NamedEffect:
        """The joint and the effect."""
        return self.test.joint, self.test.effect

    @property
    def promising(self) -> bool:
        """Whether it is beyond noise and worth a fit, which may explain more than a linear step."""
        return bool(self.test.shifts)


def score_tests_of(fit: Fit, arm: Arm) -> list[Tested]:
    """The effects that no joint's model has yet, the most significant first.

    Where residuals exceed the sensors' noise, an effect is tested at each of its sets of shapes,
    and the one that gains most alone is kept; else at the first of them.

    Returns: Each one's gain is beyond that of those before; empty where the arm with effects cannot
    be simulated.
    """
    candidates = _missing(fit, arm)
    if not candidates:
        return []
    hypotheses = _hypotheses(fit, arm, candidates)
    for steps in (in_long_steps(fit), fit):  # an effect may be too stiff for long steps
        try:
            return list(_chosen(EffectColumns.of(steps, arm, hypotheses), fit))
        except (InvalidInput, NumericalFailure):
            continue
    return []


def in_long_steps(fit: Fit) -> Fit:
    """The fit, with arms simulated in longer steps: derivatives by effects need no shorter ones."""
    objective = fit.objective.in_long_steps(fit.z)
    at = objective.linearise(fit.z)
    return fit if at is None else replace(fit, objective=objective, cost=at.cost)


def _missing(fit: Fit, arm: Arm) -> list[NamedEffect]:
    known = effects_in(fit.objective.space, arm)
    read = [channel for record in fit.objective.records for channel in record.channels]
    encoders = {channel.joint for channel in read if channel.quantity == "link_angle"}
    return [
        (number, effect.name)
        for number, joint in enumerate(arm.joints, start=1)
        for effect in all_effects()
        if joint.elastic
        and (number, effect.name) not in known
        and (number == 1 or not effect.first_joint_only)
        and not (number in encoders and effect.moves_link_encoder)
    ]


def _hypotheses(fit: Fit, arm: Arm, candidates: Sequence[NamedEffect]) -> dict[Hypothesis, Shapes]:
    """The sets of shapes at which effects are tested: one each where residuals are noise.

    Further ones have frequencies within the band in which records are compared. Beside an effect
    that the model has, every derivative takes a simulation of its own: there, too, one set is
    tested.
    """
    records, values = fit.objective.records, fit.objective.space.values(fit.z)
    band = max(record.cutoff_hz for record in records)
    loads = loads_of(records, values)
    once = bool(effects_in(fit.objective.space, arm)) or not exceed_noise(fit.objective, fit.z)
    found: dict[Hypothesis, Shapes] = {}
    for joint, name in candidates:
        effect = effect_named(name)
        first, *further = effect.tested_shapes(known_joint(arm, joint, values, loads))
        seen = [one for one in further if not once and _highest(effect, one) < band]
        for number, shapes in enumerate((first, *seen)):
            found[Hypothesis(joint, name, number)] = shapes
    return found


def _highest(effect: Effect, shapes: Shapes) -> float:
    """The highest frequency among shapes [Hz]."""
    found = (value for name, value in shapes.items() if effect.described(name).units[0] == "Hz")
    return max(found, default=0.0)


@dataclass(frozen=True, slots=True)
class _Step:
    """What one effect takes off the cost, and by which sizes."""

    candidate: Hypothesis
    names: tuple[str, ...]
    gain: float
    rigid: float  # what mistrust of the rigid step takes off before that
    size: FloatArray
    std: FloatArray
    shift: FloatArray  # of what that says

    def beyond(self, chance: float) -> float:
        """What the gain has beyond what as many sizes gain from noise with a chance."""
        return self.gain - chi_square_limit(chance, len(self.size))


def _chosen(columns: EffectColumns, fit: Fit) -> Iterator[Tested]:
    """One after the other, each given those before it as long as they are evident."""
    chance = FALSE_ALARMS / len(columns.sizes)
    taken = np.zeros((len(columns.target), 0))
    alone = _best_shapes([_step(columns, one, taken) for one in columns.sizes])
    left, steps = list(alone), list(alone.values())
    while left:
        best = max(steps, key=lambda step: step.beyond(chance))
        one = best.candidate
        found = _scored(best, fit, _moved(columns, best, fit), chance)
        reached = _reached(columns, alone[one], fit)
        yield Tested(found, chance, alone[one].gain, alone[one].rigid, reached)
        left.remove(one)
        if found.evident:
            taken = np.column_stack([taken, columns.seen(one), columns.shifts(one)])
            steps = [_step(columns, other, taken) for other in left]
        else:
            steps = [step for step in steps if step is not best]


def _best_shapes(steps: Sequence[_Step]) -> dict[Hypothesis, _Step]:
    """Of each effect, the step at the shapes that gain most."""
    best: dict[NamedEffect, _Step] = {}
    for step in steps:
        one = step.candidate.one
        if one not in best or step.gain > best[one].gain:
            best[one] = step
    return {step.candidate: step for step in best.values()}


def _moved(columns: EffectColumns, step: _Step, fit: Fit) -> Values:
    """The unknowns after the linear step that makes room for an effect."""
    move = columns.answer(step.candidate, step.size, step.shift)
    space = fit.objective.space
    return space.values(space.moved(fit.z, space.trusted(fit.z, move, 1.0)))


def _reached(columns: EffectColumns, step: _Step, fit: Fit) -> Values:
    """Those, and what a fit may start from: sizes, without sign above zero, and unusual shapes."""
    one = step.candidate
    joint, effect = one.joint, effect_named(one.effect)
    usual = columns.shapes[replace(one, number=0)]
    shapes: Values = {
        (name, joint): value for name, value in columns.shapes[one].items() if value != usual[name]
    }
    sizes: Values = {
        (name, joint): value
        for name, value in zip(step.names, step.size.tolist(), strict=True)
        if effect.is_signed(name) or value > 0.0
    }
    return _moved(columns, step, fit) | sizes | shapes


def _scored(step: _Step, fit: Fit, moved: Values, chance: float) -> ScoreTest:
    """A score test in words of the effect's parameters."""
    share = step.gain / max(fit.cost, 1e-300)
    significant = step.beyond(chance) > 0.0
    moves = tuple(shifts(fit, moved)) if significant and share > LEAST else ()
    return ScoreTest(
        joint=step.candidate.joint,
        effect=step.candidate.effect,
        sizes=dict(zip(step.names, step.size.tolist(), strict=True)),
        stds=dict(zip(step.names, step.std.tolist(), strict=True)),
        gain=step.gain,
        share=share,
        evident=significant and matters(share, moves),
        shifts=moves,
        limit=chi_square_limit(chance, len(step.size)),
    )


def matters(share: float, moves: Sequence[ParameterShift]) -> bool:
    """Whether an effect explains much, or something while a parameter leaves its 95 % interval.

    `share`: Of the cost.
    """
    moved = any(abs(move.deviations) > _INTERVAL for move in moves)
    return share > MATTERS or (share > LEAST and moved)


def shifts(fit: Fit, values: Values) -> Iterator[ParameterShift]:
    """By how much the arm's parameters differ from a fit's, the most significant first.

    `values`: (name, joint) -> value, in a model with one more effect.

    Yields: Of inertias, gravity, gears and Coulomb friction: what sensors do is no parameter of the
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


def _step(columns: EffectColumns, one: Hypothesis, taken: FloatArray) -> _Step:
    """The best sizes of one effect beside those taken already; none below nothing.

    What the rigid step says wrongly for lack of the effect is free.
    """
    parts = (columns.shifts(one), columns.seen(one), columns.target)
    shifts, seen, target = _beside(taken, *parts)
    own, left = _beside(shifts, seen, target)
    names = tuple(name for name, _ in columns.sizes[one])
    effect = effect_named(one.effect)
    size = least_squares(own, left, np.array([effect.is_signed(name) for name in names]))
    gain = float(np.sum(left**2) - np.sum((left + own @ size) ** 2))
    std = np.sqrt(np.diag(np.linalg.pinv(own.T @ own)))
    shift = np.asarray(np.linalg.lstsq(shifts, -(target + seen @ size))[0])
    rigid = float(np.sum(target**2) - np.sum(left**2))
    return _Step(one, names, gain, rigid, size, std, shift)


def _beside(taken: FloatArray, *others: FloatArray) -> Iterator[FloatArray]:
    """What a basis leaves of columns."""
    basis = np.linalg.qr(taken)[0]
    for columns in others:
        yield columns - basis @ (basis.T @ columns)


def least_squares(columns: FloatArray, target: FloatArray, signed: BoolArray) -> FloatArray:
    """Sizes that take most off the target; those without sign that come out negative are zero.

    `columns` (n_rows, n_sizes).
    `target` (n_rows,).
    `signed` (n_sizes,).

    Returns: (n_sizes,).
    """
    free, size = np.ones(len(signed), dtype=bool), np.zeros(len(signed))
    while free.any():
        size[free] = np.linalg.lstsq(columns[:, free], -target)[0]
        negative = ~signed & (size < 0.0)
        if not negative.any():
            break
        size[:], free = 0.0, free & ~negative
    return size
