"""Unknowns of the whole-arm fit and their starting values, from the preceding stages.

Curves and effects start from the loads of the joints in the records: torques of the gears, by
simulation, and voltages. A physically impossible estimate, such as negative gear damping, indicates
an error in the data or the study. A typical value replaces it, with a warning, so that the fit can
locate the error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, Joint, JointModel, Place, RigidModel
from strainwave.domain.arm.assumed_values import TYPICAL_ANTI_RESONANCE_HZ, TYPICAL_DAMPING_RATIO
from strainwave.domain.arm.combinations import change_from, value_of
from strainwave.domain.arm.description import unit_in, unit_of
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.kinds.base import StageInertias, is_positive
from strainwave.domain.arm.parameter_table import (
    COULOMB,
    OFFSET,
    SETTLING,
    VISCOUS,
    parameter_table,
)
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.problem.parameter_space import (
    ParameterSpace,
    Unknown,
    largest_of_kind,
    reference_sizes,
    rigid_prior,
)
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.prepared_record import prepare_record

_MIN_FRICTION_SHARE = 0.05  # minimum share of the total viscous friction, motor or link
# range of starting damping ratios, as search ranges are relative to them
_DAMPING_RATIO_RANGE = (0.01, 0.5)


@dataclass(frozen=True, slots=True)
class StartingValues:
    """Starting values, and the physically impossible estimates of preceding stages."""

    values: Values
    rejected: Mapping[Key, float]


def starting_values_of(
    model: RigidModel | None, joints: Sequence[JointModel], arm: Arm
) -> StartingValues:
    """Starting values of all parameters of an arm with linear gears.

    `joints` has one model per joint. `model` may be None for a single joint without gravity. Raises
    `NotIdentifiable` if a joint has no model, or if the rigid model lacks an estimate for which no
    typical value exists.
    """
    models = {joint.joint: joint for joint in joints}
    for number, joint in enumerate(arm.joints, start=1):
        if not joint.elastic or number not in models:
            raise NotIdentifiable(
                f"the whole-arm fit starts from a model of each elastic joint, and joint {number}"
                ' has none: record it with use = "frequency"'
            )
    rigid = {p.key: p.value for p in model.parameters} if model else {}
    estimates = StageInertias(
        motor={number: joint.values["motor_inertia"] for number, joint in models.items()},
        link={number: _link_inertia(joint, rigid, arm) for number, joint in models.items()},
        rigid=rigid,
        rigid_std={p.key: p.std or 0.0 for p in model.parameters} if model else {},
        combinations={column.key: column.parts for column in arm.base.columns},
    )
    start, rejected = kind_of(arm).starting_inertias(arm, estimates)
    for key in (key for key in arm.base.separate_links if key not in start):
        start[key] = estimates.require_rigid(key[0])
    for number in sorted(models):
        values = models[number].values
        stiffness, damping = values["gear_stiffness"], values["gear_damping"]
        link_inertia = value_of(arm.link_inertia(number), start)
        if not is_positive(stiffness):
            rejected["gear_stiffness", number] = stiffness
            stiffness = (2.0 * np.pi * TYPICAL_ANTI_RESONANCE_HZ) ** 2 * link_inertia
        critical = 2.0 * float(np.sqrt(stiffness * link_inertia))
        if not is_positive(damping):
            rejected["gear_damping", number] = damping
            damping = TYPICAL_DAMPING_RATIO * critical
        low, high = _DAMPING_RATIO_RANGE
        damping = min(max(damping, low * critical), high * critical)
        friction = _friction(rigid, models[number], float(arm.gear_ratios[number - 1]))
        start |= {(name, number): value for name, value in friction.items()}
        start["gear_stiffness", number], start["gear_damping", number] = stiffness, damping
    return StartingValues(start, rejected)


def warn_rejected_starts(starts: StartingValues, arm: Arm) -> Iterator[Diagnostic]:
    """Warn of each estimate that a typical value replaces."""
    for (name, joint), value in starts.rejected.items():
        place, unit = Place(joint=joint, parameter=name), unit_in(arm, (name, joint))
        typical = starts.values[name, joint]
        yield Diagnostic("start-rejected", place, value=value, unit=unit, typical=typical)


def _link_inertia(joint: JointModel, rigid: Mapping[Key, float | None], arm: Arm) -> float:
    """`link_inertia` of a joint model at zero angles, with the change by the rigid model."""
    known = {key: value or 0.0 for key, value in rigid.items()}
    row = arm.base.weights(change_from(arm, joint.joint, joint.posture)) if joint.posture else {}
    return joint.values["link_inertia"] + value_of(row, known)


def _friction(
    rigid: Mapping[Key, float | None], model: JointModel, gear_ratio: float
) -> dict[str, float]:
    """Viscous friction of the joint model; Coulomb friction and offset of the rigid model.

    The total viscous friction is split so that neither motor nor link has a negative share.
    """
    motor, link = (model.values[name] for name in VISCOUS)
    square = gear_ratio**2
    minimum = _MIN_FRICTION_SHARE * abs(motor + square * link)
    if motor < minimum:
        motor, link = minimum, max(link + (motor - minimum) / square, minimum / square)
    elif square * link < minimum:
        motor, link = max(motor + square * link - minimum, minimum), minimum / square
    coulomb = rigid.get((COULOMB, model.joint))  # some joint models have no Coulomb friction
    return {
        **dict(zip(VISCOUS, (motor, link), strict=True)),
        OFFSET: rigid.get((OFFSET, model.joint)) or 0.0,
        COULOMB: model.values.get(COULOMB, 0.0) if coulomb is None else coulomb,
    }


def gear_torques(records: Sequence[Dataset], values: dict[Key, float]) -> FloatArray:
    """Largest torque of each gear (n_joints,) [N m], at the 99.9 % quantile of a record."""
    return largest_of(gear_torque_samples(records, values))


def gear_torque_samples(records: Sequence[Dataset], values: dict[Key, float]) -> list[FloatArray]:
    """Absolute torque of each gear in each record: arrays (n_samples, n_joints) [N m]."""

    def of_record(record: Dataset) -> FloatArray:
        return np.abs(record.run(values, record.start(), ["gear_torque"])["gear_torque"])

    return run_parallel([partial(of_record, r) for r in records])


@dataclass(frozen=True, slots=True)
class Loads:
    """Largest absolute values over all records, one entry per joint."""

    torque: Sequence[float]  # [N m] of the gear, 99.9 % quantile
    voltage: Sequence[float]  # [V] of the drive


def loads_of(records: Sequence[Dataset], values: dict[Key, float]) -> Loads:
    """Largest gear torque and voltage of each joint over all records."""
    voltages = [np.abs(prepare_record(r.log, r.arm).voltage).max(axis=0) for r in records]
    return Loads(gear_torques(records, values).tolist(), np.max(voltages, axis=0).tolist())


def largest_of(gear_loads: Sequence[FloatArray]) -> FloatArray:
    """The largest of each gear, but for one sample in a thousand of a record: (n_joints,) [N m]."""
    return np.asarray(np.max([np.quantile(torque, 0.999, axis=0) for torque in gear_loads], axis=0))


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
