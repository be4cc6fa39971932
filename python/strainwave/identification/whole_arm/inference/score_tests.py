"""Score tests for effects that the model lacks.

The derivatives of all channels with respect to the sizes of an effect, at size zero, extend the
Jacobian of the fit. The cost reduction of one linear step is the test statistic, so that no model
with the effect needs to be fitted.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, EffectName, FloatArray, ParameterShift
from strainwave.domain.arm.effects import (
    STIFFNESS_CURVE,
    all_effects,
    effect_named,
    names,
    possible_causes,
)
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.domain.arm.link_sensors import constant_of
from strainwave.domain.arm.link_sensors.single_axis import LinkEncoder
from strainwave.domain.arm.parameter_table import OFFSET, SETTLING, VISCOUS, base_name
from strainwave.domain.keys import JointNumber, Key, Values
from strainwave.domain.results.distributions import chi_square_limit
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.inference.fit_tests import (
    MIN_WARNING_RATIO,
    has_excess_residuals,
)
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    NamedEffect,
    body_parameters,
    effects_among,
    friction_parameters,
    known_joint,
    set_record_effects,
    sizes_of,
)
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.starting_values import loads_of
from strainwave.identification.whole_arm.problem.weighted_rows import Evaluation
from strainwave.identification.whole_arm.records.dataset import Dataset, Variant
from strainwave.identification.whole_arm.search import Fit

FALSE_ALARMS = 1e-4
"""Probability that any effect is significant if the residuals are noise."""

RELEVANT_COST_SHARE = 0.04
"""Cost reduction, relative, from which an effect is relevant in any case."""

MIN_COST_SHARE = 0.01
"""Cost reduction, relative, below which no effect is relevant: other errors explain as much."""


@dataclass(frozen=True, slots=True)
class TestedEffect:
    """Linear step by an effect that the model lacks."""

    named_effect: NamedEffect
    gain: float  # cost reduction by the effect
    share: float  # of the cost
    limit: float  # chi-square limit of the gain
    rigid: float  # preceding cost reduction by the shifts of the rigid-step estimates
    sizes: Mapping[str, float]
    stds: Mapping[str, float]  # of the sizes
    values: Values  # of unknowns, admissible sizes and non-default shapes, after the step
    shapes: Values  # non-default ones
    other_shapes: tuple[Values, ...] = ()  # of less significant tests, the most significant first

    @property
    def is_promising(self) -> bool:
        """Whether the effect is significant and explains enough to justify a fit."""
        return self.gain > self.limit and self.share > MIN_COST_SHARE


def score_tests_of(fit: Fit, arm: Arm) -> list[TestedEffect]:
    """Test the effects that the model lacks, the most significant first.

    If residuals exceed the sensor noise, each effect is tested at all its sets of shapes, and the
    set with the largest cost reduction is kept. Otherwise only the first set is tested. Returns an
    empty list if the arm cannot be simulated with the effects.
    """
    candidates = _missing_effects(fit, arm)
    if not candidates:
        return []
    hypotheses = _hypotheses(fit, arm, candidates)
    starts = (lengthen_steps(fit), fit)  # some effects are too stiff for long steps
    return next(filter(None, (_tested(one, fit, arm, hypotheses) for one in starts)), [])


def curve_tests_of(fit: Fit, arm: Arm, joints: Collection[int]) -> list[TestedEffect]:
    """Test a coarse fit for stiffness curves of joints, the most significant first."""
    curves = [one for one in _missing_effects(fit, arm) if one[1] == STIFFNESS_CURVE.name]
    hypotheses: dict[EffectHypothesis, Shapes] = {
        EffectHypothesis(joint, name, 0): {} for joint, name in curves if joint in joints
    }
    return _tested(fit, fit, arm, hypotheses) if hypotheses else []


def _tested(
    steps: Fit, fit: Fit, arm: Arm, hypotheses: Mapping[EffectHypothesis, Shapes]
) -> list[TestedEffect]:
    """Score tests of a fit by the derivatives of `steps`; none if these do not exist."""
    try:
        columns = EffectColumns.of(steps, arm, hypotheses)
    except (InvalidInput, NumericalFailure):
        return []
    tested: dict[NamedEffect, list[TestedEffect]] = {}
    for hypothesis in columns.sizes:
        test = _test(columns, hypothesis, fit)
        tested.setdefault(hypothesis.named_effect, []).append(test)
    best = []
    for tests in tested.values():
        first, *others = sorted(tests, key=lambda one: -one.gain)
        best.append(replace(first, other_shapes=tuple(one.shapes for one in others)))
    return sorted(best, key=lambda one: one.limit - one.gain)


def lengthen_steps(fit: Fit) -> Fit:
    """The fit with long integrator steps, which are sufficient for derivatives by effects."""
    objective = fit.objective.lengthen_steps(fit.z)
    # long steps may end a row earlier, so the cost differs
    cost = None if objective is fit.objective else objective.cost(fit.z)
    return fit if cost is None else replace(fit, objective=objective, cost=cost)


def _missing_effects(fit: Fit, arm: Arm) -> list[NamedEffect]:
    """Effects that the model lacks and that the channels of the records permit."""
    present = effects_among(fit.space.keys, arm.n_joints)
    channels = [channel for record in fit.objective.records for channel in record.channels]
    encoders = {c.joint for c in channels if isinstance(c.sensor, LinkEncoder)}
    curved = {number for number, joint in enumerate(arm.joints, start=1) if joint.law.is_curved}
    stiffnesses = {key for key in fit.space.keys if key[1] not in curved}
    return [
        (number, effect.name)
        for number, joint in enumerate(arm.joints, start=1)
        for effect in possible_causes()
        if joint.elastic
        and (effect.tested_law is None or (STIFFNESS, number) in stiffnesses)
        and (number, effect.name) not in present
        and (number == 1 or not effect.first_joint_only)
        and not (number in encoders and effect.moves_link_encoder)
    ]


def _hypotheses(
    fit: Fit, arm: Arm, candidates: Sequence[NamedEffect]
) -> dict[EffectHypothesis, Shapes]:
    """Sets of shapes at which the effects are tested.

    Only one set per effect is tested if the residuals are noise. The same holds if the model has
    an effect already, because each derivative then requires a separate simulation. The frequencies
    of further sets lie within the band of the low-pass.
    """
    records, values = fit.objective.records, fit.values
    band_hz = max(record.cutoff_hz for record in records)
    loads = loads_of(records, values)
    single_set = bool(effects_among(fit.space.keys, arm.n_joints)) or not has_excess_residuals(
        fit.objective, fit.z
    )
    hypotheses: dict[EffectHypothesis, Shapes] = {}
    for joint, name in candidates:
        effect = effect_named(name)
        first, *further = effect.tested_shapes(known_joint(arm, joint, values, loads))
        frequencies = [name for name in first if effect.described(name).units[0] == "Hz"]
        in_band = [
            one
            for one in further
            if not single_set and all(one[name] < band_hz for name in frequencies)
        ]
        for number, shapes in enumerate((first, *in_band)):
            hypotheses[EffectHypothesis(joint, name, number)] = shapes
    return hypotheses


def min_relevant_share(objective: Objective, z: FloatArray) -> float:
    """Share of the cost from which an effect is relevant.

    Near the sensor noise, small effects imitate the errors of integrator and friction corner.
    """
    is_above_noise = has_excess_residuals(objective, z, MIN_WARNING_RATIO)
    return MIN_COST_SHARE if is_above_noise else RELEVANT_COST_SHARE


def shifts(fit: Fit, values: Values) -> list[ParameterShift]:
    """Shifts of the arm parameters due to an additional effect, the most significant first.

    `values` maps (name, joint) to the values of the model with the effect. The shifts are those of
    inertias, gravity, gears and Coulomb friction. Sensor constants are not parameters of the arm,
    and only sums of viscous frictions are identifiable.
    """
    estimates = fit.values
    stds = np.sqrt(np.diag(confidence_of(fit).combined))
    parameter_shifts = []
    for (name, joint), std in zip(fit.space.keys, stds.tolist(), strict=True):
        if is_primary((name, joint)) and std > 0.0:
            shift = values[name, joint] - estimates[name, joint]
            parameter_shifts.append(
                ParameterShift(name, joint, estimates[name, joint], shift, shift / std)
            )
    return sorted(parameter_shifts, key=lambda move: -abs(move.deviations))


def is_primary(key: Key) -> bool:
    """Whether a parameter is an inertia, gravity torque, gear parameter or Coulomb friction."""
    excluded = (*VISCOUS, OFFSET, SETTLING)
    of_effects = {name for effect in all_effects() for name in effect.names}
    name = base_name(key[0])
    return not (name in excluded or name in of_effects or constant_of(key))


def _test(columns: EffectColumns, one: EffectHypothesis, fit: Fit) -> TestedEffect:
    """Optimal sizes of one effect, and the values after the step.

    Sizes without sign are not negative. Errors of the rigid-step estimates due to the missing
    effect are free.
    """
    joint, effect = one.joint, effect_named(one.effect)
    names = [name for name, _ in columns.sizes[one]]
    n, (place, shift_places) = columns.n_unknowns, columns.places(one)
    above, below = columns.factor[:n], columns.factor[n:]  # below, unknowns explain nothing more
    target, shifts, columns_of_effect = below[:, -1], below[:, shift_places], below[:, place].copy()
    rounding = COLUMN_ROUNDING * np.linalg.norm(columns.factor[:, place], axis=0)
    columns_of_effect[:, np.linalg.norm(columns_of_effect, axis=0) <= rounding] = 0.0
    basis = np.linalg.qr(shifts)[0]
    projected, remaining = (part - basis @ (basis.T @ part) for part in (columns_of_effect, target))
    size = least_squares(projected, remaining, np.array([effect.is_signed(n) for n in names]))
    std = np.sqrt(np.diag(np.linalg.pinv(projected.T @ projected)))
    shift = np.asarray(np.linalg.lstsq(shifts, -(target + columns_of_effect @ size))[0])
    gain = float(np.sum(remaining**2) - np.sum((remaining + projected @ size) ** 2))
    by_effect = above[:, place] @ size + above[:, shift_places] @ shift
    change = np.asarray(-np.linalg.lstsq(above[:, :n], by_effect)[0])
    space = fit.space
    values = space.values(space.move(fit.z, space.limit_step(fit.z, change, 1.0)))
    usual = columns.shapes[replace(one, number=0)]
    sizes = dict(zip(names, size.tolist(), strict=True))
    admissible = {name: v for name, v in sizes.items() if effect.is_signed(name) or v > 0.0}
    shapes: Values = {
        (name, joint): v for name, v in columns.shapes[one].items() if v != usual[name]
    }
    return TestedEffect(
        one.named_effect,
        gain,
        gain / max(fit.cost, 1e-300),
        chi_square_limit(FALSE_ALARMS / len(columns.sizes), len(size)),
        float(np.sum(target**2) - np.sum(remaining**2)),
        sizes,
        dict(zip(names, std.tolist(), strict=True)),
        values | {(name, joint): value for name, value in admissible.items()} | shapes,
        shapes,
    )


def least_squares(columns: FloatArray, target: FloatArray, signed: BoolArray) -> FloatArray:
    """Least squares for sizes (n_sizes,) that minimise |target + columns size|.

    `columns` is (n_rows, n_sizes), `target` (n_rows,) and `signed` (n_sizes,). Sizes without sign
    that would be negative are zero.
    """
    free, size = np.ones(len(signed), dtype=bool), np.zeros(len(signed))
    while free.any():
        size[free] = np.linalg.lstsq(columns[:, free], -target)[0]
        negative = ~signed & (size < 0.0)
        if not negative.any():
            break
        size[:], free = 0.0, free & ~negative
    return size


COLUMN_ROUNDING = 1e-7  # of a column's norm; a smaller projection is rounding

Shapes = Mapping[str, float]
"""Those of an effect: name -> value."""


@dataclass(frozen=True, slots=True)
class EffectHypothesis:
    """The presence of an effect of given shapes in a joint."""

    joint: JointNumber
    effect: EffectName
    number: int  # of the set of shapes among those that are tested, from 0

    @property
    def named_effect(self) -> NamedEffect:
        """The joint and the effect."""
        return self.joint, self.effect


@dataclass(frozen=True, slots=True)
class EffectColumns:
    """R of [unknowns sizes shifts residual], then the priors of sizes and shifts.

    Sizes are those of effects, at zero. Shifts are errors of the rigid step: first of inertias and
    gravity, then of each joint's friction.
    """

    factor: FloatArray  # (n_rows, n_unknowns + n_sizes + n_shifts + 1)
    n_unknowns: int
    sizes: Mapping[EffectHypothesis, Sequence[Key]]
    shapes: Mapping[EffectHypothesis, Shapes]
    n_shifts: Sequence[int]  # of inertias and gravity, and of each joint

    @classmethod
    def of(cls, fit: Fit, arm: Arm, tested: Mapping[EffectHypothesis, Shapes]) -> EffectColumns:
        """The columns of effects in addition to those of a fit.

        All effects at the first of their shapes share one simulation, and so do those at all
        further ones; other gear laws have their own. Raises `InvalidInput` or `NumericalFailure` if
        the arm with effects cannot be simulated with finite derivatives.
        """
        objective, n = fit.objective, len(fit.space.unknowns)
        # By number of the shapes, because a joint has an effect once; then effect by effect: blocks
        # of directions with effects of the drive take longer.
        groups: dict[tuple[bool, bool], dict[int, dict[EffectHypothesis, Shapes]]] = {}
        for one in sorted(tested, key=lambda one: (one.number, one.effect)):
            simulation = effect_named(one.effect).tested_law is not None, one.number > 0
            groups.setdefault(simulation, {}).setdefault(one.number, {})[one] = tested[one]
        sizes = {
            one: sizes_of(one.named_effect, fit.records)
            for group in groups.values()
            for numbered in group.values()
            for one in numbered
        }
        runs = [_run_of(fit, arm, group, sizes) for group in groups.values()]
        n_sizes = sum(map(len, sizes.values()))
        frictions = (friction_parameters(arm, joint) for joint in range(1, arm.n_joints + 1))
        shifts = [
            objective.space.prior.by_shifts(group) for group in (body_parameters(arm), *frictions)
        ]
        prior_rows = np.concatenate([np.zeros((len(shifts[0]), n_sizes)), *shifts], axis=1)
        width = prior_rows.shape[1]

        def tangents(k: int, _: Evaluation) -> list[FloatArray]:
            initial, columns = objective.initial_states(k), []
            for records, ((values, keys), *variants) in runs:
                tangent = records[k].linearise(values, initial, keys, variants=variants)[1]
                columns.append(tangent[..., len(initial) :])
            return columns

        whole = objective.factor_with_columns(fit.z, width, tangents, prior_rows)
        if not np.isfinite(whole).all():
            raise NumericalFailure("the derivative by an effect's size overflows")
        stds = [effect_named(one.effect).prior_std for one, keys in sizes.items() for _ in keys]
        stds += [1.0] * (width - n_sizes)
        known = [k for k, std in enumerate(stds) if std is not None]
        prior = np.zeros((len(known), whole.shape[1]))
        prior[range(len(known)), [n + k for k in known]] = [1.0 / (stds[k] or 1.0) for k in known]
        factor = np.concatenate([whole, prior])
        return cls(factor, n, sizes, tested, [one.shape[1] for one in shifts])

    def places(self, one: EffectHypothesis) -> tuple[slice, list[int]]:
        """Columns of the sizes of an effect, and of the shifts that its absence causes."""
        before = list(self.sizes)[: list(self.sizes).index(one)]
        start = self.n_unknowns + sum(len(self.sizes[key]) for key in before)
        first = self.n_unknowns + sum(map(len, self.sizes.values()))
        ends = first + np.cumsum([0, *self.n_shifts])
        groups = [0, one.joint] if effect_named(one.effect).misleads_inertias else [one.joint]
        shifts = [k for group in groups for k in range(ends[group], ends[group + 1])]
        return slice(start, start + len(self.sizes[one])), shifts


def _run_of(
    fit: Fit,
    arm: Arm,
    by_number: Mapping[int, Mapping[EffectHypothesis, Shapes]],
    sizes: Mapping[EffectHypothesis, Sequence[Key]],
) -> tuple[Sequence[Dataset], Sequence[Variant]]:
    """The records with effects of size zero, and the values and sizes for each set of shapes."""
    tested = [one for numbered in by_number.values() for one in numbered]
    laws = {one.joint: effect_named(one.effect).tested_law for one in tested}
    joints = tuple(
        replace(joint, spring=laws.get(number) or joint.spring, effects=names())
        for number, joint in enumerate(arm.joints, start=1)
    )
    values, variants = Values(), []
    for numbered in by_number.values():
        for one, shapes in numbered.items():
            absent = {**effect_named(one.effect).absent, **shapes}
            values |= {(name, one.joint): value for name, value in absent.items()}
        variants.append((values | fit.values, [key for one in numbered for key in sizes[one]]))
    records = set_record_effects(
        fit.objective.records, arm.with_joints(joints), values | fit.values
    )
    return records, variants
