"""What a joint may have beyond a spring and dry friction, as unknowns of the whole-arm fit."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Diagnostic, EffectName, FloatArray
from strainwave.domain.effects import KnownJoint, all_effects, effect_named
from strainwave.domain.parameters import Values, unit_of
from strainwave.dynamics.arm import Arm
from strainwave.identification.closed_loop import with_known_effects
from strainwave.identification.whole_arm.dataset import Dataset
from strainwave.identification.whole_arm.parametrisation import (
    COULOMB,
    Key,
    ParameterSpace,
    Unknown,
)

NamedEffect = tuple[int, EffectName]
"""A joint, from 1, and an effect that it may have."""

_EVIDENT = 3.0  # deviations from nothing that an effect must have
_FAR = float(np.log(30.0))  # how far a parameter may go from its start


def named_effects(arm: Arm) -> list[NamedEffect]:
    """The effects that a study names.

    Parameters
    ----------
    arm : Arm

    Returns
    -------
    list of (joint, effect)
    """
    return [(j, effect) for j, joint in enumerate(arm.joints, 1) for effect in joint.effects]


def sizes_of(one: NamedEffect) -> list[Key]:
    """The parameters that are zero where an effect is not there.

    Parameters
    ----------
    one : (joint, effect)

    Returns
    -------
    list of (name, joint)
    """
    joint, effect = one
    return [(name, joint) for name in effect_named(effect).sizes]


def with_effects(
    space: ParameterSpace, arm: Arm, values: Values, largest_torque: Sequence[float]
) -> tuple[ParameterSpace, FloatArray]:
    """The unknowns of every effect that a study names beside those there are.

    Parameters
    ----------
    search : ParameterSpace
    arm : Arm
    values : dict
        Where the fit without effects ended.
    largest_torque : sequence of float [N m]
        That each gear carries in the records.

    Returns
    -------
    ParameterSpace
    (n_unknowns,)
        Where to start.
    """
    more: dict[Key, Unknown] = {}
    for one in named_effects(arm):
        for unknown in _unknowns(one, arm, values, largest_torque[one[0] - 1]):
            more.setdefault(unknown.key, unknown)
    rows = np.pad(space.prior.rows, ((0, 0), (0, len(more))))
    unknowns = (*space.unknowns, *more.values())
    found = ParameterSpace(unknowns, space.fixed, replace(space.prior, rows=rows))
    starts: Values = {key: unknown.start for key, unknown in more.items()}
    return found, found.coordinates(values | starts)


def _unknowns(
    one: NamedEffect, arm: Arm, values: Values, largest_torque: float
) -> Iterator[Unknown]:
    """An effect's parameters: signed ones about zero, all others by their logarithm."""
    number, effect = one[0], effect_named(one[1])
    joint = arm.joints[number - 1]
    stiffness = joint.law.stiffness(joint.law.of_joint(values, number), np.zeros(1))
    known = KnownJoint(
        gear_ratio=joint.gear_ratio,
        coulomb_friction=values[COULOMB, number],
        stiffness=float(stiffness[0]),
        largest_torque=largest_torque,
    )
    typical, starts = effect.typical_sizes(known), effect.starts(known)
    for name, start in starts.items():
        signed = effect.is_signed(name)
        scale = typical.get(name, start) if signed else start
        yield Unknown(name, number, unit_of(name, joint), start, scale, signed, _FAR)


def without(space: ParameterSpace, effects: Collection[NamedEffect]) -> ParameterSpace:
    """The unknowns less those of some effects.

    Parameters
    ----------
    search : ParameterSpace
    effects : collection of (joint, effect)

    Returns
    -------
    ParameterSpace
    """
    gone = {(name, j) for j, effect in effects for name in effect_named(effect).names}
    kept = [k for k, key in enumerate(space.keys) if key not in gone]
    prior = replace(space.prior, rows=space.prior.rows[:, kept])
    return ParameterSpace(tuple(space.unknowns[k] for k in kept), space.fixed, prior)


def idle(space: ParameterSpace, z: FloatArray, covariance: FloatArray) -> Iterator[NamedEffect]:
    """The effects whose size is nothing as far as the records show.

    Parameters
    ----------
    search : ParameterSpace
    z : (n_unknowns,)
    covariance : (n_unknowns, n_unknowns)
        Of the parameters.

    Yields
    ------
    (joint, effect)
    """
    values = space.parameters(z)
    at: dict[Key, int] = {key: k for k, key in enumerate(space.keys)}
    for effect in all_effects():
        for name, joint in list(at):
            if name == effect.sizes[0] and joint is not None:
                own = [at[key] for key in sizes_of((joint, effect.name))]
                size = values[own]
                if size @ np.linalg.solve(covariance[np.ix_(own, own)], size) < _EVIDENT**2:
                    yield joint, effect.name


def left_out(space: ParameterSpace, arm: Arm) -> Iterator[Diagnostic]:
    """What a reader must know of the effects that a study names and a fit does without.

    Parameters
    ----------
    search : ParameterSpace
        Of the fit.
    arm : Arm

    Yields
    ------
    Diagnostic
    """
    known = set(named_effects(with_known_effects(arm, space.keys)))
    for joint, effect in named_effects(arm):
        if (joint, effect) not in known:
            text = f"{effect} was tried and left out: the records do not show it; take it out of"
            text += " this joint's effects, or record slow motions and reversals"
            yield Diagnostic("effect-left-out", f"joint {joint}", text)


def records_with(
    records: Sequence[Dataset], arm: Arm, known: Collection[Key]
) -> tuple[Dataset, ...]:
    """The records on an arm with those of an arm's effects whose parameters are known.

    Parameters
    ----------
    records : sequence of Dataset
    arm : Arm
    known : collection of (name, joint)

    Returns
    -------
    tuple of `Dataset`
    """
    effects = [joint.effects for joint in with_known_effects(arm, known).joints]

    def given(record: Dataset) -> Dataset:
        pairs = zip(record.arm.joints, effects, strict=True)
        joints = (replace(joint, effects=own) for joint, own in pairs)
        return replace(record, arm=record.arm.with_joints(joints))

    return tuple(given(record) for record in records)
