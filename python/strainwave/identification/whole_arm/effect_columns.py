"""What effects that a model lacks would do to a fit, as columns beside its own derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.effects import all_effects, effect_named, names
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.effects import (
    NamedEffect,
    records_with,
    rigid_body,
    rigid_friction,
    sizes_of,
)
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import Evaluated
from strainwave.identification.whole_arm.parametrisation import Key

_ROUNDING = 1e-7  # of a column: less is nothing that the unknowns could not imitate


@dataclass(frozen=True, slots=True)
class EffectColumns:
    """R of [unknowns sizes shifts residual], then the priors of sizes and shifts.

    Sizes are those of effects, where they are zero; shifts those of what the rigid step says, first
    of inertias and gravity and then of each joint's friction.
    """

    factor: FloatArray  # (n_rows, n_unknowns + n_sizes + n_shifts + 1)
    n_unknowns: int
    sizes: Mapping[NamedEffect, Sequence[Key]]
    n_shifts: Sequence[int]  # of inertias and gravity, and of each joint

    @classmethod
    def of(cls, fit: Fit, arm: Arm, candidates: Sequence[NamedEffect]) -> EffectColumns:
        """The columns of effects beside those of a fit.

        Parameters
        ----------
        fit : Fit
        arm : Arm
        candidates : sequence of (joint, effect)

        Returns
        -------
        EffectColumns

        Raises
        ------
        InvalidInput, NumericalFailure
            The arm with effects cannot be simulated.
        """
        objective, n = fit.objective, len(fit.objective.space.unknowns)
        numbers = range(1, arm.n_joints + 1)
        sizes = {one: sizes_of(one, fit.records) for one in candidates}
        keys = [key for own in sizes.values() for key in own]
        groups = [rigid_body(arm), *(rigid_friction(arm, j) for j in numbers)]
        shifts = [objective.space.prior.by_shifts(group) for group in groups]
        beforehand = np.concatenate([np.zeros((len(shifts[0]), len(keys))), *shifts], axis=1)
        width = beforehand.shape[1]
        absent = {name: value for effect in all_effects() for name, value in effect.absent.items()}
        nothing = {(name, j): value for name, value in absent.items() for j in numbers}
        values: Values = nothing | objective.space.values(fit.z)
        joints = tuple(replace(joint, effects=names()) for joint in arm.joints)
        rich = records_with(objective.records, arm.with_joints(joints), values)

        def tangent(k: int, _: Evaluated) -> FloatArray:
            begun = objective.memory.own[k][: len(rich[k].local)]
            found = rich[k].linearised(values, begun, keys)[1]
            columns = np.zeros((*found.shape[:2], width))
            columns[..., : len(keys)] = found[..., : len(keys)]
            return columns

        whole = objective.bordered(fit.z, width, tangent, beforehand)
        stds = [effect_named(one[1]).prior_std for one, own in sizes.items() for _ in own]
        stds += [1.0] * (width - len(keys))
        known = [k for k, std in enumerate(stds) if std is not None]
        prior = np.zeros((len(known), whole.shape[1]))
        prior[range(len(known)), [n + k for k in known]] = [1.0 / (stds[k] or 1.0) for k in known]
        factor = np.concatenate([whole, prior])
        return cls(factor, n, sizes, [one.shape[1] for one in shifts])

    @property
    def target(self) -> FloatArray:
        """The residual that the unknowns leave."""
        return self.factor[self.n_unknowns :, -1]

    def seen(self, one: NamedEffect) -> FloatArray:
        """What the unknowns leave of an effect's columns: zero where that is rounding."""
        place = self._place(one)
        left = self.factor[self.n_unknowns :, place].copy()
        size = np.linalg.norm(self.factor[:, place], axis=0)
        left[:, np.linalg.norm(left, axis=0) <= _ROUNDING * size] = 0.0
        return left

    def shifts(self, one: NamedEffect) -> FloatArray:
        """What they leave of shifts of what the rigid step says wrongly for lack of an effect."""
        return self.factor[self.n_unknowns :, self._shifts(one)]

    def answer(self, one: NamedEffect, size: FloatArray, shift: FloatArray) -> FloatArray:
        """How the unknowns make room for an effect and for shifts of what the rigid step says.

        Parameters
        ----------
        one : (joint, effect)
        size : (n_sizes,)
        shift : (n_shifts,)

        Returns
        -------
        (n_unknowns,)
            In coordinates.
        """
        n = self.n_unknowns
        by_effect = self.factor[:n, self._place(one)] @ size
        by_effect = by_effect + self.factor[:n, self._shifts(one)] @ shift
        return np.asarray(-np.linalg.lstsq(self.factor[:n, :n], by_effect)[0])

    def _place(self, one: NamedEffect) -> slice:
        counts = {key: len(own) for key, own in self.sizes.items()}
        at = self.n_unknowns
        for key, count in counts.items():
            if key == one:
                return slice(at, at + count)
            at += count
        raise KeyError(one)

    def _shifts(self, one: NamedEffect) -> list[int]:
        first = self.n_unknowns + sum(map(len, self.sizes.values()))
        ends = first + np.cumsum([0, *self.n_shifts])
        groups = [0, one[0]] if effect_named(one[1]).misleads_inertias else [one[0]]
        return [k for group in groups for k in range(ends[group], ends[group + 1])]
