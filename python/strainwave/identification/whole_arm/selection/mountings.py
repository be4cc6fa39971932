"""Starting values of unknown sensor mountings from a simulated arm.

The slow part of a record determines a mounting only as far as the links turn. The simulated link
motion of an approximate arm extends the regression of the sensor readings up to the cut-off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, WholeArmOptions
from strainwave.domain.keys import Key, Values
from strainwave.domain.link_sensors import Axis, unknowns_of
from strainwave.domain.link_sensors.accelerometer import ACCELEROMETER_DISTANCE, Accelerometer
from strainwave.domain.link_sensors.imu import IMU_ROTATION, IMU_START_ATTITUDE, ImuAccelerometers
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import (
    COARSE_TOLERANCE,
    refine,
    resumed_coarse_search,
    search_minimum,
)
from strainwave.identification.whole_arm.selection.candidate import Selection
from strainwave.identification.whole_arm.selection.sensor_constants import add_sensor_constants
from strainwave.signals.imu_attitude import imu_candidates, mirror_mounting
from strainwave.signals.mounting_start import distance_of

_MAX_STARTS = 3  # mountings of least cost that start a short search
_MAX_SEARCH_EVALUATIONS = 12  # maximum evaluations of a short search
_MIN_TILT_SIGNIFICANCE = 4.0  # standard deviations from which a tilt is significant
_START_TILT = 0.07  # [rad] about each axis, where the search for a tilt starts
_MIN_COST_REDUCTION = 0.02  # minimum cost reduction of another mounting, relative
_MIN_TILT_COST_SHARE = 0.1  # minimum cost reduction of a tilt out of the plane of motion, relative


def select_mountings(
    objective: Objective, z: FloatArray, arm: Arm, options: WholeArmOptions
) -> tuple[Objective, FloatArray]:
    """Choose the starting mounting of each sensor by short searches.

    The candidates are the given mounting and those from the simulated arm at `z` (n_unknowns,). For
    an IMU on a link that turns about one direction, they include the mirror images on the other
    side of the link, and two accelerometer axes are assumed to lie in the plane of motion unless a
    tilt explains much more.

    The returned parameter space holds the attitudes that rotations are relative to.
    """
    for joint in range(1, arm.n_joints + 1):
        axes = _axes_on(objective, joint)
        if unknowns_of(axes):
            objective, z = _choose_mounting(objective, z, axes, options)
    return objective, z


def _choose_mounting(
    objective: Objective, z: FloatArray, axes: Sequence[Axis], options: WholeArmOptions
) -> tuple[Objective, FloatArray]:
    """Choose the starting mounting of the sensors of one link."""
    joint, values = axes[0].joint, objective.space.values(z)
    mounting_keys: list[Key] = [
        *unknowns_of(axes),
        *((name, joint) for name in IMU_START_ATTITUDE),
    ]
    mountings: list[Mapping[Key, float]] = [
        {key: values[key] for key in mounting_keys if key in values}
    ]
    try:
        mountings += _simulated_mountings(objective, values, axes)
    except (InvalidInput, NumericalFailure):
        return objective, z
    has_attitude = (IMU_ROTATION[0], joint) in objective.space.keys
    has_mirror = has_attitude and axes[0].space.axis is not None
    if has_mirror:
        mountings += [mirror_mounting(one, axes[0]) for one in mountings]
    starts = [_with_mounting(objective, values, one) for one in mountings]
    if (
        has_mirror
        and all(isinstance(axis.sensor, ImuAccelerometers) for axis in axes)
        and {0, 1} == {a.number for a in axes}
    ):
        held: dict[Key, float] = {(name, joint): 0.0 for name in IMU_ROTATION[:2]}
        lying = _simulated_mountings(objective, values, axes, flat=True)
        lying += [mirror_mounting(one, axes[0]) for one in lying]
        starts += [
            _hold(*_with_mounting(objective, values, {**one, **held}), held) for one in lying
        ]
    costs = sorted((cost_of(*one), k) for k, one in enumerate(starts))
    by_kind: tuple[list[int], list[int]] = ([], [])
    for cost, k in costs:
        if np.isfinite(cost):
            by_kind[_is_in_plane(starts[k][0].space, joint)].append(k)
    trials = []
    for k in (*by_kind[0][:_MAX_STARTS], *by_kind[1][:2]):
        candidate, start = starts[k]
        trial = search_minimum(
            Fit.at(candidate, start),
            options,
            tolerance=COARSE_TOLERANCE,
            max_evaluations=_MAX_SEARCH_EVALUATIONS,
        )
        trials.append(
            (
                trial.cost * (1.0 - _MIN_TILT_COST_SHARE * _is_in_plane(candidate.space, joint)),
                k,
                trial,
            )
        )
    if not trials:
        return objective, z
    best = min(trials, key=lambda one: one[:2])[2]
    return best.objective, best.z


def cost_of(objective: Objective, z: FloatArray) -> float:
    """Cost at `z` (n_unknowns,), infinite if the arm cannot be simulated."""
    linearised = objective.linearise(z)
    return np.inf if linearised is None else linearised.cost


def _is_in_plane(space: ParameterSpace, joint: int) -> bool:
    """Whether the IMU of a joint is assumed to lie in the plane of motion."""
    return (IMU_ROTATION[2], joint) in space.keys and (IMU_ROTATION[0], joint) not in space.keys


def improve_mountings(fit: Fit, selection: Selection) -> Fit:
    """Continue a coarse fit from better IMU mountings, computed from the fitted arm.

    A mounting is kept as it is if no short search from another one ends at a lower cost.
    """
    arm, options = selection.arm, selection.options
    for joint in range(1, arm.n_joints + 1):
        space, values = fit.space, fit.values
        axes = _axes_on(fit.objective, joint)
        attitude: Key = (IMU_ROTATION[2], joint)
        has_attitude = attitude in space.keys and attitude in unknowns_of(axes)
        if not has_attitude or fit.iterations >= options.max_iterations:
            continue
        flat = _is_in_plane(space, joint)
        mountings = _simulated_mountings(fit.objective, values, axes, flat=flat)
        if axes[0].space.axis is not None:
            mountings += [mirror_mounting(one, axes[0]) for one in mountings]
        starts = [_with_mounting(fit.objective, values, one) for one in mountings]
        for _, k in sorted((cost_of(*one), k) for k, one in enumerate(starts))[:_MAX_STARTS]:
            trial = search_minimum(
                fit.restart(*starts[k]),
                options,
                tolerance=COARSE_TOLERANCE,
                max_evaluations=_MAX_SEARCH_EVALUATIONS,
            )
            if trial.cost < (1.0 - _MIN_COST_REDUCTION) * fit.cost:
                fit = resumed_coarse_search(trial, options)
                break
    return fit


def _axes_on(objective: Objective, joint: int) -> list[Axis]:
    """Sensor axes of unknown mounting on the link of a joint, over all records."""
    channels = (channel for record in objective.records for channel in record.channels)
    return list(dict.fromkeys(c for c in channels if c.is_mounted and c.joint == joint))


def add_significant_tilts(fit: Fit, selection: Selection) -> Fit:
    """Add significant tilts of IMUs that were assumed to lie in the plane of motion.

    The derivative of the readings with respect to a tilt is zero at zero tilt, so the searches
    start from a small tilt of either sign.
    """
    arm, options = selection.arm, selection.options
    for joint in range(1, arm.n_joints + 1):
        # about a fixed axis, tilt and distance are nearly collinear without gravity
        axes = _axes_on(fit.objective, joint)
        if not _is_in_plane(fit.space, joint) or not axes[0].space.has_varying_force:
            continue
        tilts: list[Key] = [(name, joint) for name in IMU_ROTATION[:2]]
        trials = []
        for side in (1.0, -1.0):
            starts = {tilts[0]: _START_TILT, tilts[1]: side * _START_TILT}
            space = add_sensor_constants(fit.space, tilts, starts)
            trials.append(
                search_minimum(
                    fit.with_unknowns(space, starts),
                    options,
                    tolerance=COARSE_TOLERANCE,
                    max_evaluations=_MAX_SEARCH_EVALUATIONS,
                )
            )
        best = min(trials, key=lambda one: one.cost)
        if fit.cost - best.cost > _MIN_TILT_SIGNIFICANCE**2:
            fit = refine(best, options)
    return fit


def _with_mounting(
    objective: Objective, values: Values, mounting: Mapping[Key, float]
) -> tuple[Objective, FloatArray]:
    """Objective and point with another mounting."""
    fixed = {key: value for key, value in mounting.items() if key[0] in IMU_START_ATTITUDE}
    space = replace(objective.space, fixed={**objective.space.fixed, **fixed})
    return objective.replace_unknowns(space), space.coordinates({**values, **mounting})


def _hold(
    objective: Objective, z: FloatArray, held: Mapping[Key, float]
) -> tuple[Objective, FloatArray]:
    """Objective and point with some unknowns fixed."""
    kept = [k for k, key in enumerate(objective.space.keys) if key not in held]
    return objective.replace_unknowns(objective.space.fix_values(held)), z[kept]


def _simulated_mountings(
    objective: Objective, values: Values, axes: Sequence[Axis], *, flat: bool = False
) -> list[dict[Key, float]]:
    """Mountings by least squares on the simulated link motion of all records."""
    per_record = [record.tables(values, axes) for record in objective.records]
    tables = [np.concatenate(parts) for parts in zip(*per_record, strict=True)]
    if isinstance(axes[0].sensor, Accelerometer):
        return [{(ACCELEROMETER_DISTANCE, axes[0].joint): distance_of(axes[0], tables[0])}]
    return imu_candidates(axes, tables, flat=flat)[:_MAX_STARTS]
