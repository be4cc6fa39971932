"""Parameters of an arm as unknowns of the whole-arm fit, from the estimates of earlier stages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, Joint, JointModel, RigidModel
from strainwave.domain.arm import unit_in, unit_of
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.keys import Values
from strainwave.domain.parameter_table import COULOMB, SETTLING, parameter_table
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace, Unknown
from strainwave.identification.whole_arm.problem.prior import (
    largest_of_kind,
    reference_sizes,
    rigid_prior,
)
from strainwave.identification.whole_arm.problem.starting_values import starting_values_of

SETTLING_START = 1e-4
"""Starting value [s] of a friction settling time."""

# minimum starting Coulomb friction, as a share of the largest motor torque
_MIN_COULOMB_SHARE = 0.01
_INERTIA_LOG_RANGE = float(np.log(3.0))  # range of the logarithm of an inertia or a stiffness
# range of the logarithm of friction, damping and other gear parameters
_FRICTION_LOG_RANGE = float(np.log(30.0))


def space_of(
    model: RigidModel | None,
    joints: Sequence[JointModel],
    arm: Arm,
    *,
    largest_voltage: Sequence[float],
    floor: float,
) -> ParameterSpace:
    """Unknowns with starting values from the decoupled step, and the prior of the rigid step.

    All gears are linear; `add_stiffness_curves` adds stiffness curves. `joints` has one model per
    joint; `model` may be None for a single joint without gravity. `largest_voltage` [V] of each
    joint sets the minimum Coulomb friction. `floor` is the minimum relative standard deviation of
    the prior. Raises `NotIdentifiable` if a starting value is missing.
    """
    start = starting_values_of(model, joints, arm).values
    pairs = zip(arm.joints, largest_voltage, strict=True)
    for i, (joint, voltage) in enumerate(pairs, start=1):
        torque = _MIN_COULOMB_SHARE * voltage * joint.torque_per_command
        start[COULOMB, i] = max(start[COULOMB, i], torque)
    grouped = arm.base.independent_links if arm.base.has_groups else ()
    # link parameters that stand for combinations may be zero
    units = {key: unit_in(arm, key) for key in grouped}
    sizes = reference_sizes(start) | largest_of_kind(start, units)
    unknowns = []
    for (name, number), value in start.items():
        described = parameter_table()[name]
        signed = described.range == "any" or (name, number) in grouped
        scale = sizes[name, number] or float(signed)
        reach = _FRICTION_LOG_RANGE
        if described.family in ("inertia", "stiffness"):
            reach = float(np.expm1(_INERTIA_LOG_RANGE)) if signed else _INERTIA_LOG_RANGE
        unit = unit_in(arm, (name, number))
        unknowns.append(Unknown(name, number, unit, value, scale, signed, reach))
    keys = [unknown.key for unknown in unknowns]
    space = ParameterSpace(tuple(unknowns), {}, rigid_prior(model, keys, arm, floor))
    dependent = set(arm.base.links) - set(arm.base.independent_links)
    return space.fix_values({key: value for key, value in start.items() if key in dependent})


def add_stiffness_curves(
    space: ParameterSpace, arm: Arm, largest_torque: Sequence[float]
) -> ParameterSpace:
    """Replace the linear stiffness of each gear with a curve by the parameters of its law.

    `largest_torque` [N m] is that of each gear in the records.
    """
    unknowns: list[Unknown] = []
    columns: list[FloatArray] = []
    for k, unknown in enumerate(space.unknowns):
        joint = arm.joints[(unknown.joint or 1) - 1]
        column = space.prior.rows[:, k]
        if unknown.name != STIFFNESS or not joint.law.is_curved:
            unknowns.append(unknown)
            columns.append(column)
            continue
        curve = _curve(unknown, joint, largest_torque[(unknown.joint or 1) - 1])
        unknowns += curve
        columns += [np.zeros_like(column)] * len(curve)
    prior = replace(space.prior, rows=np.column_stack(columns))
    return ParameterSpace(tuple(unknowns), space.fixed, prior)


def replace_stiffness(
    space: ParameterSpace, arm: Arm, values: Values, largest_torque: Sequence[float]
) -> tuple[ParameterSpace, FloatArray]:
    """Replace the linear stiffness of gears by the parameters of the laws of `arm`.

    The laws start near the stiffness in `values`. Returns the space and the start (n_unknowns,).
    """
    at_values = replace(
        space,
        unknowns=tuple(
            replace(unknown, start=values[unknown.key], scale=values[unknown.key])
            if unknown.name == STIFFNESS and arm.joints[(unknown.joint or 1) - 1].law.is_curved
            else unknown
            for unknown in space.unknowns
        ),
    )
    curved = add_stiffness_curves(at_values, arm, largest_torque)
    return curved, curved.coordinates(curved.start_values | values)


def _curve(stiffness: Unknown, joint: Joint, largest_torque: float) -> list[Unknown]:
    """Unknowns of a gear law, starting near the linear law."""
    start = joint.law.starts(stiffness.start, largest_torque)
    unknowns = []
    for p in joint.law.parameters:
        value, unit = start[p.name], unit_of(p.name, joint)
        reach = stiffness.reach if p.is_slope else _FRICTION_LOG_RANGE
        positive = p.described.range == "positive"
        limits = (-1.0, float(np.exp(reach))) if p.described.range == "non-negative" else None
        scale = value - (start[p.above] if p.above is not None else 0.0)
        unknowns.append(
            Unknown(
                p.name, stiffness.joint, unit, value, scale, not positive, reach, limits, p.above
            )
        )
    return unknowns


def add_settling_unknowns(space: ParameterSpace) -> ParameterSpace:
    """Add the friction settling time of each joint."""
    joints = [unknown.joint for unknown in space.unknowns if unknown.name == COULOMB]
    return space.add(
        Unknown(SETTLING, j, "s", SETTLING_START, SETTLING_START, False, _FRICTION_LOG_RANGE)
        for j in joints
    )
