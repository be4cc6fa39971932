"""Effects of joints beyond a spring and dry friction, as unknowns of the whole-arm fit."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Diagnostic, EffectName, FloatArray, Place
from strainwave.domain.arm.description import unit_of
from strainwave.domain.arm.effects import KnownJoint, RecordEffect, all_effects, effect_named
from strainwave.domain.arm.link_sensors.interface import MOTOR_ENCODER_DELAY, TORQUE_HOLD
from strainwave.domain.arm.parameter_table import COULOMB, base_name, of_record
from strainwave.domain.keys import Key, Values
from strainwave.domain.results.distributions import chi_square_limit
from strainwave.dynamics.arm import Arm
from strainwave.identification.closed_loop import keep_known_effects
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace, Unknown
from strainwave.identification.whole_arm.problem.starting_values import Loads
from strainwave.identification.whole_arm.records.dataset import Dataset

NamedEffect = tuple[int, EffectName]
"""A joint, from 1, and an effect that it may have."""

RIGID_STEP_RECORD = "rigid step"
"""Name of all records of the rigid step together, in names of parameters by record."""

SIGNIFICANCE_LEVEL = 2.7e-3  # of an effect's sizes: three standard deviations for one size
MAX_LOG_CHANGE = float(np.log(30.0))  # of a parameter from its start


def named_effects(arm: Arm) -> list[NamedEffect]:
    """The (joint, effect) pairs that a study names."""
    return [(j, effect) for j, joint in enumerate(arm.joints, 1) for effect in joint.named_effects]


def effects_among(keys: Iterable[Key], n_joints: int) -> list[NamedEffect]:
    """The effects that have parameters among the keys."""
    bases = {(base_name(name), joint) for name, joint in keys}
    return [
        (number, effect.name)
        for number in range(1, n_joints + 1)
        for effect in all_effects()
        if (effect.sizes[0], number) in bases
    ]


def sizes_of(one: NamedEffect, records: Sequence[str] = ()) -> list[Key]:
    """The size parameters of an effect, which are zero without it; some are per record."""
    joint, effect = one
    return [(name, joint) for name in effect_named(effect).sizes_in(records)]


def add_effects(
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
    additions: dict[Key, Unknown] = {}
    for one in effects:
        for unknown in _unknowns(one, arm, values, loads, records):
            additions.setdefault(unknown.key, unknown)
    columns = dict.fromkeys(additions, np.zeros(len(space.prior.rows)))
    for one in effects:
        for unknown, column in _sizes_in_rigid_records(one, arm, space, values, additions):
            additions[unknown.key], columns[unknown.key] = unknown, column
    extended = update_prior_trust(space.add(additions.values(), columns.values()), arm)
    starts: Values = {key: unknown.start for key, unknown in additions.items()}
    return extended, extended.coordinates(starts | values)


def update_prior_trust(space: ParameterSpace, arm: Arm) -> ParameterSpace:
    """Trust the rigid-step estimates as far as the effects of the space allow.

    The rigid step does not know how logged torques continue between samples, and when they act.
    """
    biased = set[Key]()
    for joint, effect in effects_among(space.keys, arm.n_joints):
        biased |= friction_parameters(arm, joint)
        biased |= body_parameters(arm) if effect_named(effect).misleads_inertias else set()
    for name, of_joint in space.keys:
        if of_joint is not None and name in (MOTOR_ENCODER_DELAY, TORQUE_HOLD):
            biased |= friction_parameters(arm, of_joint)
    return replace(space, prior=space.prior.restore().relax(biased))


def known_joint(arm: Arm, joint: int, values: Values, loads: Loads) -> KnownJoint:
    """Quantities of a joint from which effects derive their starts; `values` is without effects."""
    known = arm.joints[joint - 1]
    stiffness = known.law.stiffness(known.law.of_joint(values, joint), np.zeros(1))
    return KnownJoint(
        gear_ratio=known.gear_ratio,
        coulomb_friction=values[COULOMB, joint],
        stiffness=float(stiffness[0]),
        largest_torque=loads.torque[joint - 1],
        largest_voltage=loads.voltage[joint - 1],
    )


def whole_inertia_of(one: NamedEffect, arm: Arm) -> Key | None:
    """The inertia that includes the size of an effect in slow motion; None for other effects."""
    joint, effect = one
    return next(iter(arm.link_inertia(joint))) if effect_named(effect).is_part_of_link else None


def body_parameters(arm: Arm) -> set[Key]:
    """Parameters of the rigid model other than friction."""
    return {column.key for column in arm.rigid_columns[: arm.n_body]}


def friction_parameters(arm: Arm, joint: int) -> set[Key]:
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
    one: NamedEffect,
    arm: Arm,
    space: ParameterSpace,
    values: Values,
    unknowns: Mapping[Key, Unknown],
) -> Iterator[tuple[Unknown, FloatArray]]:
    """An effect's sizes in the records of the rigid step, with their prior columns.

    Empty if the effect changes no parameter of the rigid step.
    """
    number, effect = one[0], effect_named(one[1])
    whole = whole_inertia_of(one, arm)
    if whole in space.keys:
        unknown = unknowns[effect.sizes[0], number]
        yield unknown, space.prior.rows[:, space.keys.index(whole)]
    if not (effect.by_record and isinstance(effect, RecordEffect)):
        return
    indices = {key: k for k, key in enumerate(space.keys)}
    joint_values = {name: value for (name, joint), value in values.items() if joint == number}
    for name in effect.sizes:
        unknown = next(
            u for u in unknowns.values() if (base_name(u.name), u.joint) == (name, number)
        )
        column = np.zeros(len(space.prior.rows))
        for changed in effect.inputs(
            joint_values | effect.absent, arm.joints[number - 1].gear_ratio
        ):
            if (changed.name, number) in indices:
                slope = changed.slopes.get(name, 0.0)
                column = column + slope * space.prior.rows[:, indices[changed.name, number]]
        if column.any():
            yield replace(unknown, name=of_record(name, RIGID_STEP_RECORD)), column


def remove_effects(
    space: ParameterSpace, effects: Collection[NamedEffect], arm: Arm
) -> ParameterSpace:
    """Remove effects from a parameter space."""
    removed = {(name, j) for j, effect in effects for name in effect_named(effect).names}
    kept = [k for k, (name, j) in enumerate(space.keys) if (base_name(name), j) not in removed]
    return update_prior_trust(space.select(kept), arm)


def insignificant_effects(
    space: ParameterSpace, z: FloatArray, covariance: FloatArray
) -> Iterator[NamedEffect]:
    """The effects whose sizes do not differ significantly from zero."""
    values = space.parameters(z)
    for effect in all_effects():
        indices: dict[int, list[int]] = {}
        for k, (name, joint) in enumerate(space.keys):
            if base_name(name) in effect.sizes and joint is not None:
                indices.setdefault(joint, []).append(k)
        for joint, sizes in indices.items():
            size = values[sizes]
            square = float(size @ np.linalg.solve(covariance[np.ix_(sizes, sizes)], size))
            if square < chi_square_limit(SIGNIFICANCE_LEVEL, len(sizes)):
                yield joint, effect.name


def warn_removed_effects(space: ParameterSpace, arm: Arm) -> Iterator[Diagnostic]:
    """Warn about named effects that the fit removed."""
    remaining = set(named_effects(keep_known_effects(arm, space.keys)))
    for joint, effect in named_effects(arm):
        if (joint, effect) not in remaining:
            place, needed = Place(joint=joint), effect_named(effect).record
            yield Diagnostic("effect-left-out", place, effect=effect, needed=needed)


def set_record_effects(
    records: Sequence[Dataset], arm: Arm, keys: Collection[Key]
) -> tuple[Dataset, ...]:
    """Set gear laws and effects of the records' arm to those of `arm`.

    Only effects with parameters among `keys` are set.
    """
    known = keep_known_effects(arm, keys).joints
    joints = (
        [
            replace(joint, spring=each.spring, effects=each.named_effects)
            for joint, each in zip(record.arm.joints, known, strict=True)
        ]
        for record in records
    )
    pairs = zip(records, joints, strict=True)
    return tuple(replace(record, arm=record.arm.with_joints(own)) for record, own in pairs)


def with_effects(objective: Objective, space: ParameterSpace, arm: Arm) -> Objective:
    """The objective for other unknowns, with their effects in the arm."""
    records = set_record_effects(objective.records, arm, space.keys)
    return replace(objective.replace_unknowns(space), records=records)
