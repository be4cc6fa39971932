"""Start of a whole-arm fit: records, unknowns and starting values."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, JointModel, Log, RigidModel, WholeArmOptions
from strainwave.domain.arm.assumed_values import TYPICAL_ANTI_RESONANCE_HZ
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.effects import effect_named
from strainwave.domain.arm.gear_laws import STIFFNESS, gear_parameters, is_slope
from strainwave.domain.arm.link_sensors import constant_of
from strainwave.domain.arm.link_sensors.imu import IMU_START_ATTITUDE
from strainwave.domain.arm.link_sensors.single_axis import LinkEncoder
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.closed_loop import keep_known_effects
from strainwave.identification.whole_arm.problem.objective import Objective, costs_of
from strainwave.identification.whole_arm.problem.parameter_space import (
    ParameterSpace,
    Unknown,
    restrict_space,
)
from strainwave.identification.whole_arm.problem.starting_values import (
    StartingValues,
    add_stiffness_curves,
    gear_torques,
    space_of,
    starting_values_of,
    warn_rejected_starts,
)
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.preparation import (
    STEPS_PER_PERIOD,
    coarsen_steps,
    cutoff_of,
    dataset_of,
    select_usable_records,
)
from strainwave.identification.whole_arm.search import Fit, search_minimum
from strainwave.identification.whole_arm.selection.mountings import select_mountings
from strainwave.identification.whole_arm.selection.sensor_constants import (
    add_sensor_constants,
    constants_of,
)
from strainwave.numerics.parallel import run_parallel
from strainwave.numerics.search import Choice, CoordinateSearch
from strainwave.signals.channels import resolutions_of
from strainwave.signals.mounting_start import estimate_mounting_starts
from strainwave.signals.recorded_input import missing_recorded_input

# an unknown stiffness is searched in steps from a share of the joint stage's value, or of a typical
# value if that is less
_SOFTEST, _STIFFNESS_STEP = 1.0 / 9.0, 1.22
_MAX_ANTI_RESONANCE = 2.0  # times the cutoff; the records do not distinguish stiffer gears
# gain of a scan, relative to its least cost, below which the stiffness stays: the cost then depends
# on the errors of other parameters
_FLAT_COST_SHARE = 0.05
_RUNS_AT_ONCE = 32  # of a scan: enough for the registers of several cores
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
    cutoff = _cutoff(used, [one for joints in candidates for one in joints], arm, options)
    short, long = _records(used, cutoff, arm, options)
    placed = estimate_mounting_starts(logs, arm, used)
    starts = {**placed, **(given or {})}

    def space_at(joints: Sequence[JointModel]) -> ParameterSpace:
        keys = [key for key in placed if key[0] not in IMU_START_ATTITUDE]
        space = _space(short, model, joints, arm, options)
        return add_sensor_constants(space, keys, starts)

    best, end_values = select_candidate(
        candidates, lambda joints: Objective.of(space_at(joints), long), options
    )
    if (of_best := _cutoff(used, best, arm, options)) != cutoff:  # which determines the band
        short, long = _records(used, of_best, arm, options)
    measured = {key for record in short for key in constants_of(record)}
    space = add_sensor_constants(space_at(best), [key for key in starts if key in measured])
    coarse, initial = _start_search(space, long, end_values, starts, options)
    if placed:
        coarse = select_mountings(coarse, arm, options)
    stages = starting_values_of(model, best, arm)
    given_joints = {joint for name, joint in starts if is_slope(name)}
    coarse = _scan_uncertain(coarse, stages, best, given_joints)
    if end_values is None or placed:
        initial = coarse.z
    return Start(used, short, coarse, initial, tuple(warn_rejected_starts(stages, arm)))


def _select_logs(logs: Sequence[Log], arm: Arm, options: WholeArmOptions) -> list[Log]:
    """The records of the fit; those of tuning as published are steps in closed loop.

    Raises `NotIdentifiable` if there is none, or if a record of tuning as published lacks data for
    a closed-loop simulation.
    """
    used = select_usable_records(logs, arm)
    needed = (
        'the whole-arm fit needs records with use = "frequency", "sweep" or "tuning", with the'
        " angle and the voltage of every motor"
    )
    if options.as_published:
        used = [log for log in used if log.experiment.use == "tuning" and not log.is_continuation]
        needed = 'tuning as published needs records with use = "tuning": steps under servo'
    if not used:
        raise NotIdentifiable(needed)
    for log in used if options.as_published else ():
        missing = missing_recorded_input(arm, log)
        if missing is not None:
            raise NotIdentifiable(
                f"tuning as published simulates {log.name} in closed loop, but {missing}: add the "
                "missing data, or set tuning.as_published = false"
            )
    return used


def _start_search(
    space: ParameterSpace,
    records: Sequence[Dataset],
    end_values: Values | None,
    given: Values,
    options: WholeArmOptions,
) -> tuple[Fit, FloatArray]:
    """The start of the search, and the coordinates of the values of the earlier stages.

    `end_values` are those of the comparison of starts. Raises `NotIdentifiable` if the arm cannot
    be simulated there.
    """
    optional = {k: c for k in space.keys if (c := constant_of(k)) and c.is_optional}
    nominal_values = {key: constant.kind.nominal for key, constant in optional.items()}
    initial = start = space.coordinates(space.start_values | nominal_values | given)
    if end_values is not None:
        start = space.coordinates(space.values(start) | end_values | given)
    restricted = restrict_space(space, options, start)
    keys = set(restricted.keys)
    kept = [key in keys for key in space.keys]
    fit = Fit.at(Objective.of(restricted, records), start[kept])
    if fit.objective.cost(fit.z) is None:
        raise NotIdentifiable(_INFEASIBLE_START)
    return fit, initial[kept]


def _cutoff(
    used: Sequence[Log], joints: Sequence[JointModel], arm: Arm, options: WholeArmOptions
) -> float:
    """Upper edge [Hz] of the band, above the joints' resonances."""
    resonances = [joint.resonance.frequency_hz for joint in joints if joint.resonance]
    return options.cutoff_hz or cutoff_of(used, arm, max(resonances, default=None))


def _records(
    used: Sequence[Log], cutoff: float, arm: Arm, options: WholeArmOptions
) -> tuple[tuple[Dataset, ...], list[Dataset]]:
    """The records in a band, in short and in long integrator steps."""
    plain = keep_known_effects(arm, ())
    resolutions = resolutions_of(used)
    prepare = partial(
        dataset_of,
        arm=plain,
        cutoff_hz=cutoff,
        closed_loop=options.closed_loop,
        resolutions=resolutions,
    )
    records = tuple(run_parallel([partial(prepare, log) for log in used]))
    for record in records:
        _check_link_encoders(record, arm)
    step = 1.0 / (STEPS_PER_PERIOD * cutoff)
    return records, [coarsen_steps(record, step) for record in records]


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
    at_start = part.cost(start.z)
    ratio = 1.0
    for grid in (_stiffness_ratios(part, start.z, joint), _REFINEMENT):
        ratios = [ratio * one for one in grid]
        scaled = [part.replace_unknowns(_scale_stiffness(part.space, joint, r)) for r in ratios]
        at_once = max(1, _RUNS_AT_ONCE // len(part.records))
        batches = (scaled[k : k + at_once] for k in range(0, len(scaled), at_once))
        found = (cost for batch in batches for cost in costs_of(batch, start.z))
        costs = [np.inf if cost is None else cost for cost in found]
        if at_start is not None and at_start < (1.0 + _FLAT_COST_SHARE) * min(costs):
            return start
        ratio = ratios[int(np.argmin(costs))]
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


MAX_SEARCHED_SETS = 4
EVALUATIONS_PER_ROUND = 3  # of the search from each set
MAX_ROUNDS = 11  # of these searches
# to the least cost; a set of larger cost is dropped. Standing motors add their noise to all costs
MAX_COST_RATIO = 1.5
# to the least cost if it is that of the first set, the best by the motor responses: other sets of
# larger cost are not searched
MAX_INITIAL_COST_RATIO = 2.0
LIMIT_SHARE = 1e-3  # of a range: distance within which a stiffness counts as at the limit
_NO_START = "the arm cannot be simulated with any start values of the earlier stages"


def select_candidate(
    candidates: Sequence[Sequence[JointModel]],
    objective_of: Callable[[Sequence[JointModel]], Objective],
    options: WholeArmOptions,
) -> tuple[Sequence[JointModel], Values | None]:
    """The set of joints from which a short search reaches the lowest cost, with its end values.

    A single set is not searched and has none. If a search drives a stiffness to the limit of its
    range, the range is centred there.

    `objective_of` returns the objective of a set of joints, whose start is at zero coordinates.
    Raises `NotIdentifiable` if no arm near any set can be simulated.
    """
    if len(candidates) == 1:
        return candidates[0], None
    searches = _best_starts(candidates, objective_of)
    for _ in range(MAX_ROUNDS):
        continued = [_continue_search(search, objective_of, options) for search in searches]
        searches = [search for search in continued if search is not None]
        if not searches:
            raise NotIdentifiable(
                "the arm cannot be simulated near any start values of the earlier stages"
            )
        min_cost = min(search.fit.cost for search in searches)
        searches = [s for s in searches if s.fit.cost <= MAX_COST_RATIO * min_cost]
        if all(search.is_finished for search in searches):
            break
        if len(searches) == 1 and not searches[0].is_limited:
            break
    best = min(searches, key=lambda search: search.fit.cost)
    return best.joints, best.fit.values


@dataclass(frozen=True, slots=True)
class _SearchState:
    """A set of joints and the state of the search from it."""

    joints: Sequence[JointModel]
    fit: Fit

    @property
    def is_limited(self) -> bool:
        """Whether a stiffness is at the limit of its range; for a curve, all of its slopes."""
        space, z = self.fit.space, self.fit.z
        is_near = np.minimum(z - space.lower, space.upper - z) < LIMIT_SHARE * (
            space.upper - space.lower
        )
        slopes_at_limit: dict[int | None, list[bool]] = {}
        for (name, joint), is_at_limit in zip(space.keys, is_near, strict=True):
            if is_slope(name):
                slopes_at_limit.setdefault(joint, []).append(bool(is_at_limit))
        return any(all(slopes) for slopes in slopes_at_limit.values())

    @property
    def is_finished(self) -> bool:
        """Whether the search has converged inside its ranges."""
        return self.fit.end.is_minimum and not self.is_limited


def _best_starts(
    candidates: Sequence[Sequence[JointModel]],
    objective_of: Callable[[Sequence[JointModel]], Objective],
) -> list[_SearchState]:
    """The sets of lowest initial cost, the best first.

    If the first set, the best by the motor responses, has the lowest cost by far, it is the only
    one. Typical gears, which no record supports, are also combined: one joint, then two
    neighbouring joints get the gears of other sets while the other joints keep theirs.
    """
    models = [
        list({id(joint): joint for joint in joints}.values())
        for joints in zip(*candidates, strict=True)
    ]
    searches: dict[Choice, _SearchState] = {}
    failures: list[NotIdentifiable] = []

    def cost_of(choice: Choice) -> float:
        joints = [each[k] for each, k in zip(models, choice, strict=True)]
        try:
            objective = objective_of(joints)
        except NotIdentifiable as failure:
            failures.append(failure)
            return np.inf
        start = np.zeros(len(objective.space.unknowns))
        cost = objective.cost(start)
        if cost is None:
            return np.inf
        searches[choice] = _SearchState(joints, Fit(objective, start, cost, 0))
        return cost

    search = CoordinateSearch(lambda choices: map(cost_of, choices))
    numbers = [{id(joint): k for k, joint in enumerate(each)} for each in models]
    sets = [
        tuple(number[id(joint)] for number, joint in zip(numbers, joints, strict=True))
        for joints in candidates
    ]
    search.evaluate(sets)
    if not any(joint.experiments for each in models for joint in each):
        best = search.minimise(sets, [len(each) for each in models])
        search.pairs(best, [range(len(each)) for each in models])
    if not searches:
        raise (failures or [NotIdentifiable(_NO_START)])[-1]
    chosen = sorted(searches, key=search.costs.__getitem__)[:MAX_SEARCHED_SETS]
    if chosen[0] == sets[0] and any(joint.experiments for joint in candidates[0]):
        limit = MAX_INITIAL_COST_RATIO * search.costs[chosen[0]]
        chosen = [choice for choice in chosen if search.costs[choice] <= limit]
    return [searches[choice] for choice in chosen]


def _continue_search(
    search: _SearchState,
    objective_of: Callable[[Sequence[JointModel]], Objective],
    options: WholeArmOptions,
) -> _SearchState | None:
    """Continue a search for a few evaluations that do not count for the fit; None if it fails."""
    if search.is_finished:
        return search
    try:
        joints, fit = search.joints, search.fit
        if search.is_limited:
            joints = []  # with the stiffnesses of the search, at which the ranges are centred
            for joint in search.joints:
                stiffness = fit.objective.records[0].arm.joints[joint.joint - 1].law.linearised_by
                centred = {**joint.values, STIFFNESS: fit.values[stiffness, joint.joint]}
                joints.append(replace(joint, values=centred))
            objective = objective_of(joints)
            kept = {key: x for key, x in fit.values.items() if key[0] not in gear_parameters()}
            values = objective.space.start_values | kept  # the springs are at their starts
            fit = Fit.at(objective, objective.space.coordinates(values))
        fit = search_minimum(
            replace(fit, iterations=0), options, max_evaluations=EVALUATIONS_PER_ROUND
        )
    except NotIdentifiable:
        return None
    return _SearchState(joints, fit)
