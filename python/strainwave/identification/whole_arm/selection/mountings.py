"""Starting values of unknown sensor mountings from a simulated arm.

The slow part of a record determines a mounting only as far as the links turn. The simulated link
motion of an approximate arm extends the regression of the sensor readings up to the cut-off.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import WholeArmOptions
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors import SensorAxis, unknowns_of
from strainwave.domain.link_sensors.imu import (
    IMU_ROTATION,
    IMU_START_ATTITUDE,
    ImuAccelerometers,
)
from strainwave.domain.link_sensors.single_axis import ACCELEROMETER_DISTANCE, Accelerometer
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import (
    refine,
    resumed_coarse_search,
    search_minimum,
)
from strainwave.identification.whole_arm.selection.candidate import Selection
from strainwave.identification.whole_arm.selection.sensor_constants import add_sensor_constants
from strainwave.signals.imu_attitude import imu_candidates, mirror_mounting
from strainwave.signals.mounting_start import distance_of

_MAX_STARTS = 3  # mountings of least cost that start a short search
_MAX_PLANAR_STARTS = 2  # the same of mountings in the plane of motion
_MAX_SEARCH_EVALUATIONS = 12  # maximum evaluations of a short search
_MIN_TILT_SIGNIFICANCE = 4.0  # standard deviations from which a tilt is significant
_START_TILT = 0.07  # [rad] about each axis, where the search for a tilt starts
_MIN_COST_REDUCTION = 0.02  # minimum cost reduction of another mounting, relative
_MIN_TILT_COST_SHARE = 0.1  # minimum cost reduction of a tilt out of the plane of motion, relative

Mounting = Mapping[Key, float]
"""Values of the constants of a mounting."""


def select_mountings(fit: Fit, arm: Arm, options: WholeArmOptions) -> Fit:
    """Choose the starting mounting of each sensor by short searches.

    The candidates are the given mounting and those from the simulated arm at the start of `fit`.
    For an IMU on a link that turns about one direction, they include the mirror images on the other
    side of the link, and two accelerometer axes are assumed to lie in the plane of motion unless a
    tilt explains much more.

    The returned parameter space holds the attitudes that rotations are relative to.
    """
    for joint in range(1, arm.n_joints + 1):
        axes = _axes_on(fit, joint)
        if unknowns_of(axes):
            fit = _choose_mounting(fit, axes, options)
    return fit


def _choose_mounting(fit: Fit, axes: Sequence[SensorAxis], options: WholeArmOptions) -> Fit:
    """Choose the starting mounting of the sensors of one link."""
    joint, values = axes[0].joint, fit.values
    keys = (*unknowns_of(axes), *((name, joint) for name in IMU_START_ATTITUDE))
    mountings: list[Mounting] = [{key: values[key] for key in keys if key in values}]
    try:
        mountings += _simulated_mountings(fit, axes)
    except (InvalidInput, NumericalFailure):
        return fit
    has_attitude = (IMU_ROTATION[0], joint) in fit.space.keys
    has_mirror = has_attitude and axes[0].space.axis is not None
    if has_mirror:
        mountings += [mirror_mounting(one, axes[0]) for one in mountings]
    starts = [_with_mounting(fit, one) for one in mountings]
    is_planar = all(isinstance(axis.sensor, ImuAccelerometers) for axis in axes)
    if has_mirror and is_planar and {0, 1} == {axis.number for axis in axes}:
        held: Mounting = {(name, joint): 0.0 for name in IMU_ROTATION[:2]}
        for one in _simulated_attitudes(fit, axes, flat=True):
            start = _with_mounting(fit, {**one, **held})
            starts.append(start.with_unknowns(start.space.fix_values(held)))
    ranked = _rank(starts)
    trials = [
        _search_briefly(start, options)
        for is_flat, n in ((False, _MAX_STARTS), (True, _MAX_PLANAR_STARTS))
        for start in [one for one in ranked if _is_in_plane(one, joint) is is_flat][:n]
    ]

    def penalised_cost(trial: Fit) -> float:
        return trial.cost * (1.0 - _MIN_TILT_COST_SHARE * _is_in_plane(trial, joint))

    best = min(trials, key=penalised_cost, default=fit)
    return fit.restart(best.objective, best.z)


def _rank(starts: Iterable[Fit]) -> list[Fit]:
    """Starts of increasing cost, without those at which the arm cannot be simulated."""
    linearised = ((start, start.objective.linearise(start.z)) for start in starts)
    costs = [(start, at.cost) for start, at in linearised if at is not None]
    return [start for start, _ in sorted(costs, key=lambda one: one[1])]


def _search_briefly(start: Fit, options: WholeArmOptions) -> Fit:
    return search_minimum(start, options, max_evaluations=_MAX_SEARCH_EVALUATIONS)


def _is_in_plane(fit: Fit, joint: int) -> bool:
    """Whether the IMU of a joint is assumed to lie in the plane of motion."""
    keys = fit.space.keys
    return (IMU_ROTATION[2], joint) in keys and (IMU_ROTATION[0], joint) not in keys


def improve_mountings(fit: Fit, selection: Selection) -> Fit:
    """Continue a coarse fit from better IMU mountings, computed from the fitted arm.

    A mounting is kept as it is if no short search from another one ends at a lower cost.
    """
    arm, options = selection.arm, selection.options
    for joint in range(1, arm.n_joints + 1):
        axes, rotation = _axes_on(fit, joint), (IMU_ROTATION[2], joint)
        has_attitude = rotation in fit.space.keys and rotation in unknowns_of(axes)
        if not has_attitude or selection.has_ended(fit):
            continue
        mountings = _simulated_attitudes(fit, axes, flat=_is_in_plane(fit, joint))
        for start in _rank(_with_mounting(fit, one) for one in mountings)[:_MAX_STARTS]:
            trial = _search_briefly(start, options)
            if trial.cost < (1.0 - _MIN_COST_REDUCTION) * fit.cost:
                fit = resumed_coarse_search(trial, options)
                break
    return fit


def _axes_on(fit: Fit, joint: int) -> list[SensorAxis]:
    """Sensor axes of unknown mounting on the link of a joint, over all records."""
    channels = (channel for record in fit.objective.records for channel in record.channels)
    return list(dict.fromkeys(c for c in channels if c.is_mounted and c.joint == joint))


def add_significant_tilts(fit: Fit, selection: Selection) -> Fit:
    """Add significant tilts of IMUs that were assumed to lie in the plane of motion.

    The derivative of the readings with respect to a tilt is zero at zero tilt, so the searches
    start from a small tilt of either sign.
    """
    arm, options = selection.arm, selection.options
    for joint in range(1, arm.n_joints + 1):
        # about a fixed axis, tilt and distance are nearly collinear without gravity
        axes = _axes_on(fit, joint)
        if not _is_in_plane(fit, joint) or not axes[0].space.has_varying_force:
            continue
        tilts: list[Key] = [(name, joint) for name in IMU_ROTATION[:2]]
        trials = []
        for side in (1.0, -1.0):
            starts = {tilts[0]: _START_TILT, tilts[1]: side * _START_TILT}
            space = add_sensor_constants(fit.space, tilts, starts)
            trials.append(_search_briefly(fit.with_unknowns(space, starts), options))
        best = min(trials, key=lambda one: one.cost)
        if fit.cost - best.cost > _MIN_TILT_SIGNIFICANCE**2:
            fit = refine(best, options)
    return fit


def _with_mounting(fit: Fit, mounting: Mounting) -> Fit:
    """Start of a search with another mounting."""
    fixed = {key: value for key, value in mounting.items() if key[0] in IMU_START_ATTITUDE}
    space = replace(fit.space, fixed={**fit.space.fixed, **fixed})
    return fit.with_unknowns(space, dict(mounting))


def _simulated_mountings(
    fit: Fit, axes: Sequence[SensorAxis], *, flat: bool = False
) -> list[dict[Key, float]]:
    """Mountings by least squares on the simulated link motion of all records."""
    per_record = [record.tables(fit.values, axes) for record in fit.objective.records]
    tables = [np.concatenate(parts) for parts in zip(*per_record, strict=True)]
    if isinstance(axes[0].sensor, Accelerometer):
        return [{(ACCELEROMETER_DISTANCE, axes[0].joint): distance_of(axes[0], tables[0])}]
    return imu_candidates(axes, tables, flat=flat)[:_MAX_STARTS]


def _simulated_attitudes(
    fit: Fit, axes: Sequence[SensorAxis], *, flat: bool
) -> list[dict[Key, float]]:
    """The same for an IMU, with the mirror images on the other side of the link if it has any."""
    mountings = _simulated_mountings(fit, axes, flat=flat)
    if axes[0].space.axis is None:
        return mountings
    return mountings + [mirror_mounting(one, axes[0]) for one in mountings]
