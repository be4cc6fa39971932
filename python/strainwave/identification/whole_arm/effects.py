"""Effects of joints beyond a spring and dry friction, as unknowns of the whole-arm fit."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Diagnostic, EffectName, FloatArray
from strainwave.domain.effects import KnownJoint, RecordEffect, all_effects, effect_named
from strainwave.domain.parameter_table import base_name, of_record
from strainwave.domain.parameters import Values, unit_of
from strainwave.dynamics.arm import Arm
from strainwave.identification.closed_loop import with_known_effects
from strainwave.identification.whole_arm.dataset import Dataset
from strainwave.identification.whole_arm.loads import Loads
from strainwave.identification.whole_arm.parametrisation import (
    COULOMB,
    Key,
    ParameterSpace,
    Unknown,
)
from strainwave.numerics.distributions import chi_square_limit

NamedEffect = tuple[int, EffectName]
"""A joint, from 1, and an effect that it may have."""

RIGID = "rigid step"
"""Stands for the records of the rigid step in place of a record's name."""

SIGNIFICANCE_LEVEL = 2.7e-3  # of an effect's sizes: three standard deviations for one size
MAX_LOG_CHANGE = float(np.log(30.0))  # of a parameter from its start


def named_effects(arm: Arm) -> list[NamedEffect]:
    """The (joint, effect) pairs that a study names."""
    return [(j, effect) for j, joint in enumerate(arm.joints, 1) for effect in joint.named_effects]


def effects_in(space: ParameterSpace, arm: Arm) -> list[NamedEffect]:
    """The effects among the unknowns."""
    return effects_among(space.keys, arm.n_joints)


def effects_among(keys: Iterable[Key], n_joints: int) -> list[NamedEffect]:
    """The effects that have parameters among the keys."""
    known = {(base_name(name), joint) for name, joint in keys}
    return [
        (number, effect.name)
        for number in range(1, n_joints + 1)
        for effect in all_effects()
        if (effect.sizes[0], number) in known
    ]


def sizes_of(one: NamedEffect, records: Sequence[str] = ()) -> list[Key]:
    """The size parameters of an effect, which are zero without it; some are per record."""
    joint, effect = one
    return [(name, joint) for name in effect_named(effect).sizes_in(records)]


def with_effects(
    space: ParameterSpace,
    effects: Sequence[NamedEffect],
    arm: Arm,
    values: Values,
    loads: Loads,
    records: Sequence[str] = (),
) -> tuple[ParameterSpace, FloatArray]:
    """Add the unknowns of effects to a parameter space.

    `values` has the fit without the effects, and start values of effects that replace the typical
    ones. Returns the space and the start (n_unknowns,).
    """
    more: dict[Key, Unknown] = {}
    for one in effects:
        for unknown in _unknowns(one, arm, values, loads, records):
            more.setdefault(unknown.key, unknown)
    columns = dict.fromkeys(more, np.zeros(len(space.prior.rows)))
    for one in effects:
        for unknown, column in _sizes_in_rigid_records(one, arm, space, values, more):
            more[unknown.key], columns[unknown.key] = unknown, column
    rows = np.column_stack([space.prior.rows, *columns.values()])
    found = ParameterSpace(
        (*space.unknowns, *more.values()), space.fixed, replace(space.prior, rows=rows)
    )
    found = _with_prior_trust(found, arm)
    starts: Values = {key: unknown.start for key, unknown in more.items()}
    return found, found.coordinates(starts | values)


def _with_prior_trust(space: ParameterSpace, arm: Arm) -> ParameterSpace:
    """The space with the trust in the rigid step that its effects allow."""
    misled = {key for one in effects_in(space, arm) for key in misled_by(one, arm)}
    return replace(space, prior=space.prior.tightened().loosened(misled))


def known_joint(arm: Arm, joint: int, values: Values, loads: Loads) -> KnownJoint:
    """Quantities of a joint from which effects derive their starts; `values` is without effects."""
    own = arm.joints[joint - 1]
    stiffness = own.law.stiffness(own.law.of_joint(values, joint), np.zeros(1))
    return KnownJoint(
        gear_ratio=own.gear_ratio,
        coulomb_friction=values[COULOMB, joint],
        stiffness=float(stiffness[0]),
        largest_torque=loads.torque[joint - 1],
        largest_voltage=loads.voltage[joint - 1],
    )


def misled_by(one: NamedEffect, arm: Arm) -> set[Key]:
    """Rigid-step parameters that are biased if the joint has the effect."""
    joint, effect = one
    friction = rigid_friction(arm, joint)
    return friction | rigid_body(arm) if effect_named(effect).misleads_inertias else friction


def rigid_body(arm: Arm) -> set[Key]:
    """Parameters of the rigid model other than friction."""
    return {column.key for column in arm.rigid_columns[: arm.n_body]}


def rigid_friction(arm: Arm, joint: int) -> set[Key]:
    """Friction parameters of a joint in the rigid model."""
    return {column.key for column in arm.rigid_columns[arm.n_body :] if column.key[1] == joint}


def _unknowns(
    one: NamedEffect, arm: Arm, values: Values, loads: Loads, records: Sequence[str]
) -> Iterator[Unknown]:
    """An effect's parameters: signed ones around zero, all others by their logarithm."""
    number, effect = one[0], effect_named(one[1])
    joint, known = arm.joints[number - 1], known_joint(arm, number, values, loads)
    typical, starts = effect.typical_sizes(known), effect.starts(known)
    for name in (*effect.sizes_in(records), *effect.shapes):
        base = base_name(name)
        start, signed = starts[base], effect.is_signed(base)
        scale = typical.get(base, start) if signed else start
        std = effect.prior_std if base in effect.sizes else None
        unit = unit_of(name, joint)
        yield Unknown(name, number, unit, start, scale, signed, MAX_LOG_CHANGE, prior_std=std)


def _sizes_in_rigid_records(
    one: NamedEffect, arm: Arm, space: ParameterSpace, values: Values, known: Mapping[Key, Unknown]
) -> Iterator[tuple[Unknown, FloatArray]]:
    """An effect's sizes in the records of the rigid step, with their prior columns.

    Empty if the rigid step knows nothing that the effect changes.
    """
    number, effect = one[0], effect_named(one[1])
    if not (effect.by_record and isinstance(effect, RecordEffect)):
        return
    at = {key: k for k, key in enumerate(space.keys)}
    own = {name: value for (name, joint), value in values.items() if joint == number}
    for name in effect.sizes:
        like = next(u for u in known.values() if (base_name(u.name), u.joint) == (name, number))
        column = np.zeros(len(space.prior.rows))
        for changed in effect.inputs(own | effect.absent, arm.joints[number - 1].gear_ratio):
            if (changed.name, number) in at:
                slope = changed.slopes.get(name, 0.0)
                column = column + slope * space.prior.rows[:, at[changed.name, number]]
        if column.any():
            yield replace(like, name=of_record(name, RIGID)), column


def without(space: ParameterSpace, effects: Collection[NamedEffect], arm: Arm) -> ParameterSpace:
    """The parameter space without some effects."""
    gone = {(name, j) for j, effect in effects for name in effect_named(effect).names}
    kept = [k for k, (name, j) in enumerate(space.keys) if (base_name(name), j) not in gone]
    prior = replace(space.prior, rows=space.prior.rows[:, kept])
    left = ParameterSpace(tuple(space.unknowns[k] for k in kept), space.fixed, prior)
    return _with_prior_trust(left, arm)


def idle(space: ParameterSpace, z: FloatArray, covariance: FloatArray) -> Iterator[NamedEffect]:
    """The effects whose sizes do not differ significantly from zero."""
    values = space.parameters(z)
    for effect in all_effects():
        places: dict[int, list[int]] = {}
        for k, (name, joint) in enumerate(space.keys):
            if base_name(name) in effect.sizes and joint is not None:
                places.setdefault(joint, []).append(k)
        for joint, own in places.items():
            size = values[own]
            square = float(size @ np.linalg.solve(covariance[np.ix_(own, own)], size))
            if square < chi_square_limit(SIGNIFICANCE_LEVEL, len(own)):
                yield joint, effect.name


def left_out(space: ParameterSpace, arm: Arm) -> Iterator[Diagnostic]:
    """Warn about named effects that the fit removed."""
    known = set(named_effects(with_known_effects(arm, space.keys)))
    for joint, effect in named_effects(arm):
        if (joint, effect) not in known:
            text = f"{effect} was fitted and removed: its size does not differ significantly from"
            text += " zero in the records, and the other parameters are estimated without it;"
            text += f" remove it from the joint's effects, or add {effect_named(effect).record}"
            yield Diagnostic("effect-left-out", f"joint {joint}", text)


def records_with(
    records: Sequence[Dataset], arm: Arm, known: Collection[Key]
) -> tuple[Dataset, ...]:
    """The records on an arm with those of its effects whose parameters are known."""
    effects = [joint.named_effects for joint in with_known_effects(arm, known).joints]

    def given(record: Dataset) -> Dataset:
        pairs = zip(record.arm.joints, effects, strict=True)
        joints = (replace(joint, effects=own) for joint, own in pairs)
        return replace(record, arm=record.arm.with_joints(joints))

    return tuple(given(record) for record in records)
