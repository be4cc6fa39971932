"""Derivatives of the channels by the sizes of effects that the model lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import EffectName, FloatArray
from strainwave.domain.effects import effect_named, names
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import NumericalFailure
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    NamedEffect,
    body_parameters,
    friction_parameters,
    set_record_effects,
    sizes_of,
)
from strainwave.identification.whole_arm.problem.weighted_rows import Evaluation
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.search.fit import Fit

COLUMN_ROUNDING = 1e-7  # of a column's norm; a smaller projection is rounding

Shapes = Mapping[str, float]
"""Those of an effect: name -> value."""


@dataclass(frozen=True, slots=True)
class EffectHypothesis:
    """The presence of an effect of given shapes in a joint."""

    joint: int  # from 1
    effect: EffectName
    number: int  # of the set of shapes among those that are tested, from 0

    @property
    def named_effect(self) -> NamedEffect:
        """The joint and the effect."""
        return self.joint, self.effect


@dataclass(frozen=True, slots=True)
class _Pass:
    """A simulation of the records with effects of size zero, one set of shapes each."""

    records: Sequence[Dataset]
    values: Values
    sizes: Mapping[EffectHypothesis, Sequence[Key]]

    @classmethod
    def of(cls, fit: Fit, arm: Arm, tested: Mapping[EffectHypothesis, Shapes]) -> _Pass:
        """A pass over effects of which no two are the same effect of one joint."""
        values = fit.values
        absent = {
            (name, one.joint): value
            for one, shapes in tested.items()
            for name, value in {**effect_named(one.effect).absent, **shapes}.items()
        }
        values = absent | values
        laws = {one.joint: effect_named(one.effect).tested_law for one in tested}
        joints = tuple(
            replace(joint, spring=laws.get(number) or joint.spring, effects=names())
            for number, joint in enumerate(arm.joints, start=1)
        )
        records = set_record_effects(fit.objective.records, arm.with_joints(joints), values)
        return cls(
            records, values, {one: sizes_of(one.named_effect, fit.records) for one in tested}
        )

    def columns(self, k: int, initial: FloatArray) -> FloatArray:
        """Derivatives by sizes in a record: (n_rows, n_channels, n_sizes)."""
        keys = [key for sizes in self.sizes.values() for key in sizes]
        return self.records[k].linearise(self.values, initial, keys)[1][..., : len(keys)]


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

        All effects at the first of their shapes share one simulation, and so do those of each
        further number; effects that move several joints and other gear laws have their own. Raises
        `InvalidInput` or `NumericalFailure` if the arm with effects cannot be simulated with finite
        derivatives.
        """
        objective, n = fit.objective, len(fit.space.unknowns)
        passes: dict[tuple[int, bool, bool], dict[EffectHypothesis, Shapes]] = {}
        for one, shapes in tested.items():
            effect = effect_named(one.effect)
            moves_joints = one.joint in arm.coupled_joints and effect.moves_output
            key = one.number, moves_joints, effect.tested_law is not None
            passes.setdefault(key, {})[one] = shapes
        each = [_Pass.of(fit, arm, passes[key]) for key in sorted(passes)]
        sizes = {one: keys for run in each for one, keys in run.sizes.items()}
        n_sizes = sum(map(len, sizes.values()))
        frictions = (friction_parameters(arm, joint) for joint in range(1, arm.n_joints + 1))
        shifts = [
            objective.space.prior.by_shifts(group) for group in (body_parameters(arm), *frictions)
        ]
        prior_rows = np.concatenate([np.zeros((len(shifts[0]), n_sizes)), *shifts], axis=1)
        width = prior_rows.shape[1]

        def tangent(k: int, _: Evaluation) -> FloatArray:
            initial = objective.initial_states(k)
            return np.concatenate([run.columns(k, initial) for run in each], axis=2)

        whole = objective.factor_with_columns(fit.z, width, tangent, prior_rows)
        if not np.isfinite(whole).all():
            raise NumericalFailure("the derivative by an effect's size overflows")
        stds = [effect_named(one.effect).prior_std for one, keys in sizes.items() for _ in keys]
        stds += [1.0] * (width - n_sizes)
        known = [k for k, std in enumerate(stds) if std is not None]
        prior = np.zeros((len(known), whole.shape[1]))
        prior[range(len(known)), [n + k for k in known]] = [1.0 / (stds[k] or 1.0) for k in known]
        factor = np.concatenate([whole, prior])
        return cls(factor, n, sizes, tested, [one.shape[1] for one in shifts])

    @property
    def target(self) -> FloatArray:
        """The residual that the unknowns do not explain."""
        return self.factor[self.n_unknowns :, -1]

    def effect_columns(self, one: EffectHypothesis) -> FloatArray:
        """An effect's columns after projection, zero where only rounding remains."""
        place = self._place(one)
        projection = self.factor[self.n_unknowns :, place].copy()
        size = np.linalg.norm(self.factor[:, place], axis=0)
        projection[:, np.linalg.norm(projection, axis=0) <= COLUMN_ROUNDING * size] = 0.0
        return projection

    def shifts(self, one: EffectHypothesis) -> FloatArray:
        """Residual effect of errors in the rigid-step estimates due to the missing effect."""
        return self.factor[self.n_unknowns :, self._shifts(one)]

    def change_of_unknowns(
        self, one: EffectHypothesis, size: FloatArray, shift: FloatArray
    ) -> FloatArray:
        """Change of the unknowns (n_unknowns,) for sizes of an effect and rigid-step shifts."""
        n = self.n_unknowns
        by_effect = self.factor[:n, self._place(one)] @ size
        by_effect = by_effect + self.factor[:n, self._shifts(one)] @ shift
        return np.asarray(-np.linalg.lstsq(self.factor[:n, :n], by_effect)[0])

    def _place(self, one: EffectHypothesis) -> slice:
        before = list(self.sizes)[: list(self.sizes).index(one)]
        start = self.n_unknowns + sum(len(self.sizes[key]) for key in before)
        return slice(start, start + len(self.sizes[one]))

    def _shifts(self, one: EffectHypothesis) -> list[int]:
        first = self.n_unknowns + sum(map(len, self.sizes.values()))
        ends = first + np.cumsum([0, *self.n_shifts])
        groups = [0, one.joint] if effect_named(one.effect).misleads_inertias else [one.joint]
        return [k for group in groups for k in range(ends[group], ends[group + 1])]
