"""Mountings of link sensors: place and attitude, and the resonance of the mount.

The slow part of a record determines a mounting only as far as the links turn. The simulated link
motion of an approximate arm extends the regression of the sensor readings up to the cut-off.

A mount resonance changes only the channels of its sensor. A resonance of the arm also moves the
motor and is left to the effects. The model therefore includes a mount resonance only if its fit
reduces the residuals of its sensor strongly and increases those of other channels hardly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, WholeArmOptions
from strainwave.domain.arm.link_sensors import SensorAxis, unknowns_of
from strainwave.domain.arm.link_sensors.imu import (
    IMU_ROTATION,
    IMU_START_ATTITUDE,
    ImuAccelerometers,
)
from strainwave.domain.arm.link_sensors.single_axis import ACCELEROMETER_DISTANCE, Accelerometer
from strainwave.domain.keys import Key, Values
from strainwave.domain.results.distributions import chi_square_limit
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import MountResonance
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.inference.fit_tests import channels_above_noise
from strainwave.identification.whole_arm.problem.parameter_space import is_held
from strainwave.identification.whole_arm.problem.weighted_rows import Evaluation
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.search import (
    COARSE_TOLERANCE,
    Fit,
    fine_search,
    refine,
    resumed_coarse_search,
    search_minimum,
)
from strainwave.identification.whole_arm.selection.candidate import Candidate, Selection, best_trial
from strainwave.identification.whole_arm.selection.sensor_constants import add_sensor_constants
from strainwave.signals.mounting_start import distance_of, imu_candidates, mirror_mounting

_MAX_STARTS = 3  # mountings of least cost, or mounts, that start a short search
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


def _search_briefly(
    start: Fit, options: WholeArmOptions, tolerance: float = COARSE_TOLERANCE
) -> Fit:
    return search_minimum(
        start, options, tolerance=tolerance, max_evaluations=_MAX_SEARCH_EVALUATIONS
    )


def _is_in_plane(fit: Fit, joint: int) -> bool:
    """Whether the IMU of a joint is assumed to lie in the plane of motion."""
    keys = fit.space.keys
    return (IMU_ROTATION[2], joint) in keys and (IMU_ROTATION[0], joint) not in keys


def improve_mountings(fit: Fit, selection: Selection) -> Fit:
    """Continue a coarse fit from better IMU mountings, computed from the fitted arm.

    A mounting is kept as it is if no short search from another one ends at a lower cost.
    """
    for joint in range(1, selection.arm.n_joints + 1):
        change = partial(_better_mounting, joint=joint)
        fit = Candidate(change, resumed_coarse_search)(fit, selection)
    return fit


def _better_mounting(fit: Fit, selection: Selection, joint: int) -> Fit | None:
    axes, rotation = _axes_on(fit, joint), (IMU_ROTATION[2], joint)
    if rotation not in fit.space.keys or rotation not in unknowns_of(axes):
        return None
    mountings = _simulated_attitudes(fit, axes, flat=_is_in_plane(fit, joint))
    starts = _rank(_with_mounting(fit, one) for one in mountings)[:_MAX_STARTS]
    trials = (_search_briefly(start, selection.options) for start in starts)
    max_cost = (1.0 - _MIN_COST_REDUCTION) * fit.cost
    return next((trial for trial in trials if trial.cost < max_cost), None)


def _axes_on(fit: Fit, joint: int) -> list[SensorAxis]:
    """Sensor axes of unknown mounting on the link of a joint, over all records."""
    channels = (channel for record in fit.objective.records for channel in record.channels)
    return list(dict.fromkeys(c for c in channels if c.is_mounted and c.joint == joint))


def add_significant_tilts(fit: Fit, selection: Selection) -> Fit:
    """Add significant tilts of IMUs that were assumed to lie in the plane of motion."""
    for joint in range(1, selection.arm.n_joints + 1):
        change = partial(_significant_tilt, joint=joint)
        fit = Candidate(change, refine, is_addition=False)(fit, selection)
    return fit


def _significant_tilt(fit: Fit, selection: Selection, joint: int) -> Fit | None:
    """The better of two tilts.

    The derivative of the readings with respect to a tilt is zero at zero tilt, so the searches
    start from a small tilt of either sign.
    """
    # about a fixed axis, tilt and distance are nearly collinear without gravity
    axes = _axes_on(fit, joint)
    if not _is_in_plane(fit, joint) or not axes[0].space.has_varying_force:
        return None
    tilts: list[Key] = [(name, joint) for name in IMU_ROTATION[:2]]
    tilted = [{tilts[0]: _START_TILT, tilts[1]: side * _START_TILT} for side in (1.0, -1.0)]
    starts = (fit.with_unknowns(add_sensor_constants(fit.space, tilts, one), one) for one in tilted)
    best = best_trial(starts, partial(_search_briefly, options=selection.options))
    return best if best and fit.cost - best.cost > _MIN_TILT_SIGNIFICANCE**2 else None


def _with_mounting(fit: Fit, mounting: Mounting) -> Fit:
    fixed = {key: value for key, value in mounting.items() if key[0] in IMU_START_ATTITUDE}
    space = replace(fit.space, fixed={**fit.space.fixed, **fixed})
    return fit.with_unknowns(space, dict(mounting))


def _simulated_mountings(
    fit: Fit, axes: Sequence[SensorAxis], *, flat: bool = False
) -> list[dict[Key, float]]:
    """Mountings by least squares on the simulated link motion of all records."""
    per_record = [_tables(record, fit.values, axes) for record in fit.objective.records]
    tables = [np.concatenate(parts) for parts in zip(*per_record, strict=True)]
    if isinstance(axes[0].sensor, Accelerometer):
        return [{(ACCELEROMETER_DISTANCE, axes[0].joint): distance_of(axes[0], tables[0])}]
    return imu_candidates(axes, tables, flat=flat)[:_MAX_STARTS]


def _tables(record: Dataset, values: Values, axes: Sequence[SensorAxis]) -> list[FloatArray]:
    """For each axis, the simulated quantities that it combines and, last, its reading.

    Each table (n_rows, n_quantities + 1) has zero column means. The simulation starts from the
    initial states of `start`. The table of an axis that the record lacks has no rows.
    """
    rows = record.rows(record.run(values, record.start(), record.quantities()))
    at = {channel: k for k, channel in enumerate(record.channels)}
    tables = []
    for axis in axes:
        parts = [rows[name][:, axis.joint - 1] for name in axis.quantities if name in rows]
        table = np.zeros((0, len(axis.quantities) + 1))
        if axis in at:
            table = np.column_stack([*parts, record.measured[:, at[axis]]])
            table = table - table.mean(axis=0)
        tables.append(table)
    return tables


def _simulated_attitudes(
    fit: Fit, axes: Sequence[SensorAxis], *, flat: bool
) -> list[dict[Key, float]]:
    """The same for an IMU, with the mirror images on the other side of the link if it has any."""
    mountings = _simulated_mountings(fit, axes, flat=flat)
    if axes[0].space.axis is None:
        return mountings
    return mountings + [mirror_mounting(one, axes[0]) for one in mountings]


# natural frequencies [Hz] of the tested mounts
_TESTED_FREQUENCIES_HZ = (30.0, 37.0, 45.0, 55.0, 67.0, 82.0, 100.0, 122.0, 150.0, 183.0, 223.0)
_TESTED_DAMPING_RATIOS = (0.05, 0.12)  # damping ratios of the tested mounts, at each frequency
_MAX_BAND_RATIO = 2.0  # maximum frequency over the cut-off; beyond, at most 1/4 change in the band
_FALSE_ALARM_PROBABILITY = 1e-4  # false alarm probability over all tested mounts
# minimum cost reduction of a linear step, as a share of the sensor's cost
_MIN_LINEAR_COST_SHARE = 0.1
_TRIAL_TOLERANCE = 0.1  # predicted cost reduction at which a trial ends
_MAX_REMAINING_COST_SHARE = 0.3  # maximum cost of the sensor after the fit, relative to that before
_MAX_SPILLOVER_SHARE = 0.2  # maximum cost increase of other channels, relative to the reduction

Names = tuple[Key, Key]
"""Keys of the frequency and the damping ratio of a sensor's mount."""

Mounts = dict[Names, list[MountResonance]]


def _with_mount(fit: Fit, selection: Selection) -> Fit | None:
    """The first acceptable one of the best mounts of sensors, the most significant sensor first.

    The evaluations of the trials do not count for the budget.
    """
    for names, mounts in _significant_mounts(fit, selection).items():
        starts = []
        for mount in mounts:
            values = dict(zip(names, (mount.frequency, mount.damping), strict=True))
            space = add_sensor_constants(fit.space, list(values), values)
            starts.append(replace(fit.with_unknowns(space, values), iterations=0))
        search = partial(_search_briefly, options=selection.options, tolerance=_TRIAL_TOLERANCE)
        trial = best_trial(starts, search)
        if trial is not None and _is_acceptable(fit, trial, names):
            selection.allow(selection.options.max_iterations + trial.iterations)
            return replace(trial, iterations=fit.iterations + trial.iterations)
    return None


add_mount_resonances = Candidate(_with_mount, fine_search, is_repeated=True)


def _significant_mounts(fit: Fit, selection: Selection) -> Mounts:
    """Mounts with significant score tests, by sensor, the most significant first."""
    tested = _mounts_to_test(fit, selection)
    n = sum(map(len, tested.values()))
    if not n:
        return {}
    objective, values = fit.objective.lengthen_steps(fit.z), fit.values

    def columns(k: int, _: Evaluation) -> list[FloatArray]:
        return [mount_changes(objective.records[k], values, objective.initial_states(k), tested)]

    projected, target = objective.project_columns(fit.z, n, columns)
    square = np.sum(projected**2, axis=0)
    gains = np.where(projected.T @ target < 0.0, (projected.T @ target) ** 2, 0.0)
    gains /= np.where(square > 0.0, square, np.inf)
    gain, limit = iter(gains.tolist()), chi_square_limit(_FALSE_ALARM_PROBABILITY / n, 1)
    significant: list[tuple[float, Names, list[MountResonance]]] = []
    for names, mounts in tested.items():
        ranked = sorted(((next(gain), mount) for mount in mounts), key=lambda one: -one[0])
        threshold = max(limit, _MIN_LINEAR_COST_SHARE * _split_cost(fit, names)[0])
        if ranked[0][0] > threshold:
            significant.append((ranked[0][0], names, [mount for _, mount in ranked[:_MAX_STARTS]]))
    significant.sort(key=lambda one: -one[0])
    return {names: mounts for _, names, mounts in significant}


def mount_changes(
    record: Dataset,
    values: Mapping[Key, float],
    initial: FloatArray,
    mounts: Mapping[Names, Sequence[MountResonance]],
) -> FloatArray:
    """Change of the channels by candidate mount resonances, one at a time.

    `initial` (n_initial,) are the initial states. `mounts` maps the frequency and damping keys
    of a sensor's mount to candidates. Returns (n_rows, n_channels, n_mounts) in the order of
    the mapping.
    """
    runs, scales = record.run(values, initial, record.quantities()), record.sensor_scales(values)
    tested = [(names, mount) for names, candidates in mounts.items() for mount in candidates]
    changes = np.zeros((len(record.time), len(record.channels), len(tested)))
    for k, channel in enumerate(record.channels):
        reading = channel.reading(runs, values)
        for at, (names, mount) in enumerate(tested):
            if names == channel.mount:
                change = mount.read(reading, record.log.sample_time) - reading
                changes[:, k, at] = scales[k] * record.kernels.rows(
                    change, slope=channel.reads_angle
                )
    return changes


def _mounts_to_test(fit: Fit, selection: Selection) -> Mounts:
    """Mounts to test: of sensors with residuals above noise and without a mount resonance."""
    objective, mounts = fit.objective, Mounts()
    limit_hz = _MAX_BAND_RATIO * max(record.cutoff_hz for record in objective.records)
    present = objective.space.keys
    candidates = [
        MountResonance(f, d)
        for f in _TESTED_FREQUENCIES_HZ
        if f < limit_hz
        for d in _TESTED_DAMPING_RATIOS
    ]
    for record, beyond in zip(
        objective.records, channels_above_noise(objective, fit.z), strict=True
    ):
        for channel, exceeds_noise in zip(record.channels, beyond.tolist(), strict=True):
            names = channel.mount
            if not exceeds_noise or names is None or names[0] in present:
                continue
            if not any(is_held(key, selection.options) for key in names):
                mounts[names] = candidates
    return mounts


def _is_acceptable(before: Fit, after: Fit, names: Names) -> bool:
    """Whether a mount explains the residuals of its sensor without increasing others much."""
    (cost_before, others_before), (cost_after, others_after) = (
        _split_cost(fit, names) for fit in (before, after)
    )
    return (
        cost_after < _MAX_REMAINING_COST_SHARE * cost_before
        and others_after - others_before < _MAX_SPILLOVER_SHARE * (cost_before - cost_after)
    )


def _split_cost(fit: Fit, names: Names) -> tuple[float, float]:
    """Cost of the channels of the mount's sensor, and of all other channels."""
    costs = np.zeros(2)
    objective = fit.objective
    evaluated = zip(objective.records, objective.weights, objective.rows(fit.z), strict=True)
    for record, weights, rows in evaluated:
        for channel, cost in zip(record.channels, rows.costs(weights), strict=True):
            costs[0 if channel.mount == names else 1] += cost
    sensor_cost, others = costs.tolist()
    return sensor_cost, others
