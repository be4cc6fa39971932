"""What models with one more effect would explain of what a fit left, without fitting them.

A score test: the derivative of every channel by an effect's size, at size nothing, joins the fit's
own derivatives as one more column. What it takes off the cost in one linear step is the evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, Diagnostic, FloatArray, ScoreTest
from strainwave.domain.effects import all_effects, effect_named, names
from strainwave.domain.parameter_table import base_name
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.effects import (
    NamedEffect,
    named_effects,
    records_with,
    sizes_of,
)
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import Evaluated
from strainwave.identification.whole_arm.parametrisation import Key
from strainwave.numerics.distributions import chi_square_limit

_CHANCE = 6e-7  # odds that noise does as well: five deviations, of one size
_MATTERS = 0.1  # and share of the cost: below, an error of another kind explains as much


def score_tests_of(fit: Fit, arm: Arm) -> list[ScoreTest]:
    """The effects that no joint's model has yet, the most significant first.

    Parameters
    ----------
    fit : Fit
    arm : Arm

    Returns
    -------
    list of ScoreTest
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
    sizes = {one: sizes_of(one, _names(fit)) for one in candidates}
    return list(_chosen(sizes, factor, fit.cost))


def _names(fit: Fit) -> list[str]:
    """Of the records."""
    return [record.log.name for record in fit.objective.records]


def _missing(fit: Fit, arm: Arm) -> list[NamedEffect]:
    known = {(base_name(name), joint) for name, joint in fit.objective.space.keys}
    return [
        (number, effect.name)
        for number, joint in enumerate(arm.joints, start=1)
        for effect in all_effects()
        if joint.elastic and (effect.sizes[0], number) not in known
    ]


def _bordered(fit: Fit, arm: Arm, candidates: Sequence[NamedEffect]) -> FloatArray:
    """R of [effects residual] in what the fit's unknowns cannot imitate, then the sizes' priors.

    (n_keys + 1 + n_priors, n_keys + 1)
    """
    objective = fit.objective
    pairs = [(one, key) for one in candidates for key in sizes_of(one, _names(fit))]
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

    known = [k for k, std in enumerate(stds) if std is not None]
    prior = np.eye(len(keys) + 1)[known] / np.array([stds[k] for k in known], dtype=float)[:, None]
    return np.concatenate([objective.bordered(fit.z, len(keys), tangent), prior])


@dataclass(frozen=True, slots=True)
class _Step:
    """What one effect takes off the cost, and by which sizes."""

    candidate: NamedEffect
    gain: float
    size: FloatArray
    std: FloatArray

    @property
    def beyond(self) -> float:
        """What the gain has beyond that of an evident effect of as many sizes."""
        return self.gain - chi_square_limit(_CHANCE, len(self.size))


def _chosen(
    sizes: Mapping[NamedEffect, Sequence[Key]], factor: FloatArray, cost: float
) -> Iterator[ScoreTest]:
    """One after the other, each given those before it as long as they are evident."""
    columns, at = {}, 0
    for one, own in sizes.items():
        columns[one] = factor[:, at : at + len(own)]
        at += len(own)
    left, target = list(sizes), factor[:, -1]
    taken = np.zeros((len(target), 0))
    while left:
        steps = [_step(one, sizes[one], columns[one], taken, target) for one in left]
        best = max(steps, key=lambda step: step.beyond)
        share = best.gain / max(cost, 1e-300)
        evident = best.beyond > 0.0 and share > _MATTERS
        joint, effect = best.candidate
        names = [name for name, _ in sizes[best.candidate]]
        yield ScoreTest(
            joint=joint,
            effect=effect,
            sizes=dict(zip(names, best.size.tolist(), strict=True)),
            stds=dict(zip(names, best.std.tolist(), strict=True)),
            gain=best.gain,
            share=share,
            evident=evident,
        )
        left.remove(best.candidate)
        if evident:
            taken = np.column_stack([taken, columns[best.candidate]])


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
    return _Step(candidate, gain, size, std)


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


def effect_warnings(score_tests: Sequence[ScoreTest], arm: Arm) -> Iterator[Diagnostic]:
    """The effect that the residuals speak for most, and the experiment that would settle it.

    One at a time: what the others would explain is known only with this one in the model. Effects
    that the study names were fitted, and stay out if the records do not show them.

    Parameters
    ----------
    score_tests : sequence of ScoreTest
        The most significant first.
    arm : Arm

    Yields
    ------
    Diagnostic
    """
    named = named_effects(arm)
    for one in score_tests:
        if not one.evident or (one.joint, one.effect) in named:
            continue
        effect = effect_named(one.effect)
        sizes = ", ".join(
            f"{name} {size:.2g} +- {one.stds[name]:.1g}" for name, size in one.sizes.items()
        )
        text = f"{one.effect} would explain {100.0 * one.share:.2g} % of the residuals ({sizes}),"
        text += f' more than any other effect; give the joint effects = ["{one.effect}"] to fit it;'
        text += f" to be sure, {effect.experiment}"
        yield Diagnostic(effect.warning_code, f"joint {one.joint}", text)
        return
