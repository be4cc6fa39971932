"""Start of a whole-arm fit: records, unknowns and starting values."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, JointModel, Log, RigidModel, WholeArmOptions
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.effects import effect_named
from strainwave.domain.arm.gear_laws import STIFFNESS, is_slope
from strainwave.domain.arm.link_sensors import constant_of
from strainwave.domain.arm.link_sensors.imu import IMU_START_ATTITUDE
from strainwave.domain.arm.link_sensors.single_axis import LinkEncoder
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.closed_loop import keep_known_effects
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.parameter_space import (
    ParameterSpace,
    Unknown,
    restrict_space,
)
from strainwave.identification.whole_arm.problem.starting_values import (
    TYPICAL_ANTI_RESONANCE_HZ,
    StartingValues,
    add_stiffness_curves,
    space_of,
    starting_values_of,
    warn_rejected_starts,
)
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.loads import gear_torques
from strainwave.identification.whole_arm.records.preparation import (
    STEPS_PER_PERIOD,
    coarsen_steps,
    cutoff_of,
    dataset_of,
    select_usable_records,
)
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.published import published_records
from strainwave.identification.whole_arm.search.start_comparison import (
    SelectedCandidate,
    select_candidate,
)
from strainwave.identification.whole_arm.selection.mountings import select_mountings
from strainwave.identification.whole_arm.selection.sensor_constants import add_sensor_constants
from strainwave.signals.mounting_start import estimate_mounting_starts

# an unknown stiffness is searched in steps from a share of the joint stage's value, or of a typical
# value if that is less
_SOFTEST, _STIFFNESS_STEP = 1.0 / 9.0, 1.22
_MAX_ANTI_RESONANCE = 2.0  # times the cutoff; the records do not distinguish stiffer gears
_REFINEMENT = np.geomspace(1.0 / _STIFFNESS_STEP, _STIFFNESS_STEP, 9).tolist()
_INFEASIBLE_START = (
    "the arm cannot be simulated with the estimates of the earlier stages. Check the signs, units"
    " and assignment of the channels, gear_ratio and torque_per_volt"
)


@dataclass(frozen=True, slots=True)
class Start:
    """Records, objective and starting values of a fit."""

    logs: list[Log]
    records: tuple[Dataset, ...]
    coarse: Fit  # start of the search on the same records in long integrator steps
    initial: FloatArray  # (n_unknowns,) from the preceding stages, without comparison of starts
    rejected: tuple[Diagnostic, ...]  # warnings about physically impossible starting values


def prepare_start(
    logs: Sequence[Log],
    model: RigidModel | None,
    candidates: Sequence[Sequence[JointModel]],
    arm: Arm,
    options: WholeArmOptions,
    given: Mapping[Key, float] | None,
) -> Start:
    """Prepare the records and choose the starting values of a fit.

    `logs` that the whole-arm fit does not use are ignored. `candidates` are alternative sets of
    joint models; the one of lowest cost starts the fit. `given` maps (name, joint) to values
    that replace those of the preceding stages.

    Raises `NotIdentifiable` if there is no record to fit or no feasible start, and `InvalidInput`
    if a record lacks data for its simulation.
    """
    used = _select_logs(logs, arm, options)
    records = _records(used, [joint for joints in candidates for joint in joints], arm, options)
    placed = estimate_mounting_starts(logs, arm, used)
    starts = {**placed, **(given or {})}

    def space_at(records: _Records, joints: Sequence[JointModel]) -> ParameterSpace:
        keys = [key for key in placed if key[0] not in IMU_START_ATTITUDE]
        space = _space(records.short_steps, model, joints, arm, options)
        return add_sensor_constants(space, keys, starts)

    best = select_candidate(
        candidates,
        lambda joints: Objective.of(space_at(records, joints), records.long_steps),
        options,
    )
    if len(candidates) > 1:  # the best candidate determines the band
        records = _records(used, best.joints, arm, options)
    space = space_at(records, best.joints)
    coarse, initial = _start_search(space, records, best, starts, options)
    if placed:
        coarse = select_mountings(coarse, arm, options)
    stages = starting_values_of(model, best.joints, arm)
    given_joints = {joint for name, joint in starts if is_slope(name)}
    coarse = _scan_uncertain(coarse, stages, best.joints, given_joints)
    if best.end_values is None or placed:
        initial = coarse.z
    rejected = tuple(warn_rejected_starts(stages, arm))
    return Start(used, records.short_steps, coarse, initial, rejected)


def _select_logs(logs: Sequence[Log], arm: Arm, options: WholeArmOptions) -> list[Log]:
    used = select_usable_records(logs, arm)
    if options.as_published:
        used = published_records(used, arm)
    if not used:
        raise NotIdentifiable(
            'the whole-arm fit needs records with use = "frequency", "sweep" or "tuning", with the'
            " angle and the voltage of every motor"
        )
    return used


def _start_search(
    space: ParameterSpace,
    records: _Records,
    best: SelectedCandidate,
    given: Values,
    options: WholeArmOptions,
) -> tuple[Fit, FloatArray]:
    """The start of the search, and the coordinates of the values of the earlier stages.

    Raises `NotIdentifiable` if the arm cannot be simulated there.
    """
    measured = {key for record in records.short_steps for key in record.sensor_constants()}
    space = add_sensor_constants(space, [key for key in given if key in measured])
    optional = {k: c for k in space.keys if (c := constant_of(k)) and c.is_optional}
    nominal_values = {key: constant.kind.nominal for key, constant in optional.items()}
    initial = start = space.coordinates(space.start_values | nominal_values | given)
    if best.end_values is not None:
        start = space.coordinates(space.values(start) | best.end_values | given)
    restricted = restrict_space(space, options, start)
    keys = set(restricted.keys)
    kept = [key in keys for key in space.keys]
    fit = Fit.at(Objective.of(restricted, records.long_steps), start[kept])
    if fit.objective.linearise(fit.z) is None:
        raise NotIdentifiable(_INFEASIBLE_START)
    return fit, initial[kept]


@dataclass(frozen=True, slots=True)
class _Records:
    """The same records in short and in long integrator steps."""

    short_steps: tuple[Dataset, ...]
    long_steps: list[Dataset]


def _records(
    used: Sequence[Log], joints: Sequence[JointModel], arm: Arm, options: WholeArmOptions
) -> _Records:
    """Prepare the records in the band of the joints' resonances."""
    resonances = [joint.resonance.frequency_hz for joint in joints if joint.resonance]
    cutoff = options.cutoff_hz or cutoff_of(used, arm, max(resonances, default=None))
    plain = keep_known_effects(arm, ())
    records = tuple(dataset_of(log, plain, cutoff, closed_loop=options.closed_loop) for log in used)
    for record in records:
        _check_link_encoders(record, arm)
    step = 1.0 / (STEPS_PER_PERIOD * cutoff)
    return _Records(records, [coarsen_steps(record, step) for record in records])


def _scan_uncertain(
    start: Fit,
    stages: StartingValues,
    joints: Sequence[JointModel],
    given: Collection[int | None],
) -> Fit:
    """Scan the stiffness of joints without a plausible model; twice, as they affect each other.

    So is a stiffness whose interval contains zero. The stiffness of the joints in `given` is known.
    """
    uncertain: set[int | None] = {j for name, j in stages.rejected if name == STIFFNESS and j}
    uncertain |= {model.joint for model in joints if model.status == "implausible"}
    stiffnesses = [p for model in joints for p in model.parameters if p.name == STIFFNESS]
    uncertain |= {p.joint for p in stiffnesses if p.ci95 and p.ci95[0] <= 0.0 <= p.ci95[1]}
    uncertain -= set(given)
    for joint in sorted(filter(None, uncertain)) * (2 if len(uncertain) > 1 else 1):
        start = _scan_stiffness(start, joint)
    return start


def _scan_stiffness(start: Fit, joint: int) -> Fit:
    """Scan an unknown stiffness for the minimum of the cost, on the records of its joint.

    A typical stiffness may be wrong by a factor of a hundred, as of a light wrist. A resonance is
    about 10 % wide, and a search that starts further away ends in a local minimum.
    """
    records = start.objective.records
    own = [k for k, record in enumerate(records) if record.log.experiment.joint in (None, joint)]
    part = start.objective.select_records(*own) if own else start.objective
    ratio = 1.0
    for grid in (_stiffness_ratios(part, start.z, joint), _REFINEMENT):
        ratios = [ratio * one for one in grid]
        scaled = (part.replace_unknowns(_scale_stiffness(part.space, joint, r)) for r in ratios)
        costs = [each.cost(start.z) for each in scaled]
        ratio = ratios[int(np.argmin([np.inf if cost is None else cost for cost in costs]))]
    return start.restart(
        start.objective.replace_unknowns(_scale_stiffness(start.space, joint, ratio)), start.z
    )


def _stiffness_ratios(objective: Objective, z: FloatArray, joint: int) -> list[float]:
    """Ratios to the stiffness of a joint, up to an anti-resonance well above the band."""
    record, values = objective.records[0], objective.space.values(z)
    stiffness = max(x for (name, i), x in values.items() if i == joint and is_slope(name))
    inertia = value_of(record.arm.link_inertia(joint), values)
    typical, highest = (
        (2.0 * np.pi * frequency) ** 2 * inertia / stiffness
        for frequency in (TYPICAL_ANTI_RESONANCE_HZ, _MAX_ANTI_RESONANCE * record.cutoff_hz)
    )
    softest, stiffest = _SOFTEST * min(1.0, typical), max(highest, 1.0 / _SOFTEST)
    n = int(np.log(stiffest / softest) / np.log(_STIFFNESS_STEP)) + 2
    return [float(ratio) for ratio in np.geomspace(softest, stiffest, n)]


def _scale_stiffness(space: ParameterSpace, joint: int | None, ratio: float) -> ParameterSpace:
    """Unknowns around a multiple of the stiffness of a joint, with the same damping ratio."""

    def scaled(unknown: Unknown) -> Unknown:
        factor = 1.0
        if unknown.joint == joint and is_slope(unknown.name):
            factor = ratio
        elif unknown.key == ("gear_damping", joint):
            factor = ratio**0.5
        return replace(unknown, start=factor * unknown.start, scale=factor * unknown.scale)

    return replace(space, unknowns=tuple(map(scaled, space.unknowns)))


def _check_link_encoders(record: Dataset, arm: Arm) -> None:
    """Raise `InvalidInput` if an effect moves a link encoder relative to the ground."""
    for channel in record.channels:
        for effect in arm.joints[channel.joint - 1].named_effects:
            is_encoder = isinstance(channel.sensor, LinkEncoder)
            if is_encoder and effect_named(effect).moves_link_encoder:
                raise InvalidInput(
                    f"{channel.channel} does not measure the angle in space: the joint has"
                    f" a {effect.replace('-', ' ')}",
                    where=record.log.name,
                    remedy=f"log an accelerometer on that link, or remove the effect '{effect}'",
                )


def _space(
    records: Sequence[Dataset],
    model: RigidModel | None,
    joints: Sequence[JointModel],
    arm: Arm,
    options: WholeArmOptions,
) -> ParameterSpace:
    """Unknowns with starting values from the joint models, gear curves included."""
    voltage = np.max([np.max(np.abs(r.drive.voltage), axis=0) for r in records], axis=0)
    space = space_of(
        model, joints, arm, largest_voltage=voltage.tolist(), floor=options.least_deviation
    )
    if any(joint.law.is_curved for joint in arm.joints):
        values = space.start_values
        try:
            space = add_stiffness_curves(space, arm, gear_torques(records, values).tolist())
        except NumericalFailure as failure:
            raise NotIdentifiable(_INFEASIBLE_START) from failure
    return space
