"""Where sensors sit, by a simulated arm: a second start for those whose place is unknown.

The slow part of a record shows a place only as far as the links turn. An arm that is simulated, if
only nearly the right one, gives what the axes read a combination of up to the cut-off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, TuningOptions
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.mounting import DISTANCE, START, TURN, Axis, unknowns_of
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import Objective
from strainwave.identification.whole_arm.parametrisation import Key, ParameterSpace
from strainwave.identification.whole_arm.selection import Selection
from strainwave.identification.whole_arm.sensors import with_sensors
from strainwave.identification.whole_arm.solver import (
    COARSE_GAIN,
    refined,
    resumed_coarse_search,
    search_from,
)
from strainwave.signals.imu_attitude import imu_candidates, in_mirror
from strainwave.signals.mounting_start import distance_of

_FEW = 3  # mountings from which a short search goes on
_STEPS = 12  # of each
_EVIDENT = 4.0  # deviations from which a tilt is kept
_LEAST_TILT = 0.07  # [rad] about each axis, from which it is looked for
_LOWER = 0.02  # share of the cost by which another mounting must be better
_FLAT = 0.1  # share of the cost that a tilt out of the plane must explain


def best_placed(
    objective: Objective, z: FloatArray, arm: Arm, options: TuningOptions
) -> tuple[Objective, FloatArray]:
    """A start with each sensor where a short search from there ends lowest.

    Tried are the mounting as it is, those by the arm that is simulated there, and of an IMU the
    same on the other side of its link. One with two accelerometers lies flat, unless it explains
    much more if it does not.

    `z` (n_unknowns,).

    Returns: Attitudes that turns start from are among what its search holds. (n_unknowns,)
    """
    for joint in range(1, arm.n_joints + 1):
        axes = _axes_on(objective, joint)
        if unknowns_of(axes, arm):
            objective, z = _placed(objective, z, axes, arm, options)
    return objective, z


def _placed(
    objective: Objective, z: FloatArray, axes: Sequence[Axis], arm: Arm, options: TuningOptions
) -> tuple[Objective, FloatArray]:
    """The same of one link's sensors."""
    joint, values = axes[0].joint, objective.space.values(z)
    own: list[Key] = [*unknowns_of(axes, arm), *((name, joint) for name in START)]
    tried: list[Mapping[Key, float]] = [{key: values[key] for key in own if key in values}]
    try:
        tried += _by_simulation(objective, values, axes, arm)
    except (InvalidInput, NumericalFailure):
        return objective, z
    turns = (TURN[0], joint) in objective.space.keys
    if turns:
        tried += [in_mirror(one, joint) for one in tried]
    starts = [_with(objective, values, one) for one in tried]
    if turns and {a.kind for a in axes} == {"accelerometer"} and {0, 1} == {a.number for a in axes}:
        held: dict[Key, float] = {(name, joint): 0.0 for name in TURN[:2]}
        lying = _by_simulation(objective, values, axes, arm, flat=True)
        lying += [in_mirror(one, joint) for one in lying]
        starts += [_holding(*_with(objective, values, {**one, **held}), held) for one in lying]
    costs = sorted((cost_of(*one), k) for k, one in enumerate(starts))
    kinds: tuple[list[int], list[int]] = ([], [])
    for cost, k in costs:
        if np.isfinite(cost):
            kinds[_is_flat(starts[k][0].space, joint)].append(k)
    ends = []
    for k in (*kinds[0][:_FEW], *kinds[1][:2]):
        at, begin = starts[k]
        found = search_from(at, begin, 0, options, tolerance=COARSE_GAIN, most=_STEPS)
        ends.append((found.cost * (1.0 - _FLAT * _is_flat(at.space, joint)), k, found))
    if not ends:
        return objective, z
    best = min(ends, key=lambda one: one[:2])[2]
    return best.objective, best.z


def cost_of(objective: Objective, z: FloatArray) -> float:
    """The cost at a start, infinite where no arm can be simulated.

    `z` (n_unknowns,).
    """
    found = objective.linearise(z)
    return np.inf if found is None else found.cost


def _is_flat(space: ParameterSpace, joint: int) -> bool:
    return (TURN[2], joint) in space.keys and (TURN[0], joint) not in space.keys


def with_better_mountings(fit: Fit, selection: Selection) -> Fit:
    """A rough fit with each IMU where the arm that it found has it best, and on from there.

    Returns: As it is where a short search from no other mounting ends lower.
    """
    arm, options = selection.arm, selection.options
    for joint in range(1, arm.n_joints + 1):
        space, values = fit.objective.space, fit.objective.space.values(fit.z)
        axes = _axes_on(fit.objective, joint)
        turns = (TURN[2], joint) in space.keys and (TURN[2], joint) in unknowns_of(axes, arm)
        if not turns or fit.iterations >= options.max_iterations:
            continue
        flat = _is_flat(space, joint)
        tried = _by_simulation(fit.objective, values, axes, arm, flat=flat)
        tried += [in_mirror(one, joint) for one in tried]
        starts = [_with(fit.objective, values, one) for one in tried]
        for _, k in sorted((cost_of(*one), k) for k, one in enumerate(starts))[:_FEW]:
            found = search_from(
                *starts[k], fit.iterations, options, tolerance=COARSE_GAIN, most=_STEPS
            )
            if found.cost < (1.0 - _LOWER) * fit.cost:
                fit = resumed_coarse_search(found.objective, found.z, found.iterations, options)
                break
    return fit


def _axes_on(objective: Objective, joint: int) -> list[Axis]:
    every = (c.axis for record in objective.records for c in record.channels)
    return list(dict.fromkeys(a for a in every if a and a.joint == joint))


def with_evident_tilts(fit: Fit, selection: Selection) -> Fit:
    """A fit with those tilts of IMUs that were taken to lie flat that its residuals speak for.

    Lying flat, a sensor's readings do not change by a tilt at first: a search starts from some.
    """
    arm, options = selection.arm, selection.options
    for joint in range(1, arm.n_joints + 1):
        # on an axis that stands still a tilt is hardly apart from the distance
        if not _is_flat(fit.objective.space, joint) or (joint == 1 and not arm.gravity):
            continue
        flat: list[Key] = [(name, joint) for name in TURN[:2]]
        values = fit.objective.space.values(fit.z)
        ends = []
        for side in (1.0, -1.0):
            starts = {flat[0]: _LEAST_TILT, flat[1]: side * _LEAST_TILT}
            space = with_sensors(fit.objective.space, flat, starts)
            objective = fit.objective.for_unknowns(space)
            begin = space.coordinates({**values, **starts})
            spent = fit.iterations
            ends.append(
                search_from(objective, begin, spent, options, tolerance=COARSE_GAIN, most=_STEPS)
            )
        best = min(ends, key=lambda one: one.cost)
        if fit.cost - best.cost > _EVIDENT**2:
            fit = refined(best, options)
    return fit


def _with(
    objective: Objective, values: Values, mounting: Mapping[Key, float]
) -> tuple[Objective, FloatArray]:
    """The start with another mounting."""
    fixed = {key: value for key, value in mounting.items() if key[0] in START}
    space = replace(objective.space, fixed={**objective.space.fixed, **fixed})
    return objective.for_unknowns(space), space.coordinates({**values, **mounting})


def _holding(
    objective: Objective, z: FloatArray, held: Mapping[Key, float]
) -> tuple[Objective, FloatArray]:
    kept = [k for k, key in enumerate(objective.space.keys) if key not in held]
    return objective.for_unknowns(objective.space.holding(held)), z[kept]


def _by_simulation(
    objective: Objective, values: Values, axes: Sequence[Axis], arm: Arm, *, flat: bool = False
) -> list[dict[Key, float]]:
    """Least squares on what an arm's links do in all records."""
    each = [record.tables(values, axes) for record in objective.records]
    tables = [np.concatenate(parts) for parts in zip(*each, strict=True)]
    if axes[0].kind == "tangential":
        return [{(DISTANCE, axes[0].joint): distance_of(tables[0])}]
    return imu_candidates(axes, tables, arm, flat=flat)[:_FEW]
