"""Starting values of sensor positions and attitudes for the whole-arm fit.

Far below the resonances, links follow their motors, so kinematics alone give the quantities of
which each reading is a linear combination. Least squares estimate its factors. The effect of the
springs, a few percent, is left to the whole-arm fit.

The factors of an IMU are products of its position and a rotation. Levenberg-Marquardt iterations
from many attitudes converge to local minima, and the minimum with the smallest objective is
selected.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from strainwave.domain import FloatArray, Log
from strainwave.domain.arm.link_sensors import (
    ConstantKind,
    SensorAxis,
    is_kind,
    mounted_axes,
    unknowns_of,
)
from strainwave.domain.arm.link_sensors.imu import (
    IMU_BEARING,
    IMU_DISTANCE,
    IMU_POSITION,
    IMU_ROTATION,
    IMU_START_ATTITUDE,
    ImuSensor,
    attitude_of,
)
from strainwave.domain.arm.link_sensors.link_space import angles, attitude
from strainwave.domain.arm.link_sensors.single_axis import ACCELEROMETER_DISTANCE, Accelerometer
from strainwave.domain.keys import JointNumber, Key
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import JointMotion, link_quantities
from strainwave.numerics.filters import low_pass
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.prepared_record import prepare_record

_MAX_FREQUENCY_HZ = 2.0  # [Hz] below which links follow their motors; most resonances exceed 10 Hz
_MIN_PERIODS = 5.0  # minimum number of periods of the cutoff frequency in a record
_EDGE_PERIODS = 1.0  # excluded edge of a record, in periods of the cutoff (low-pass transient)
_MIN_SAMPLES = 64  # minimum number of samples of a record
_MIN_QUANTITY_NORM = 1e-6  # minimum norm of a quantity relative to the largest one
_MAX_SEARCHES = 16  # number of best starting values from which the search continues
_MAX_ITERATIONS = 120  # maximum number of iterations of each search
_INITIAL_DAMPING = 1e-3  # initial Levenberg-Marquardt damping
_RELATIVE_TOLERANCE = 1e-9  # relative decrease of the objective at convergence
# relative difference of the objective below which two minima are identical
_MIN_COST_DIFFERENCE = 0.01
_RELATIVE_RIDGE = 1e-9  # relative ridge term for factors that the data do not determine
_N_BEARINGS = 8  # number of starting values of the bearing, evenly spaced
_MIN_COLUMN_NORM = 1e-9  # minimum norm of a derivative relative to the largest one
_MAX_STEP = 0.7  # [rad or m] maximum step of any unknown


def estimate_mounting_starts(
    logs: Sequence[Log], arm: Arm, used: Sequence[Log] | None = None
) -> dict[Key, float]:
    """Estimate the unknowns of all sensor mountings by least squares at low frequencies.

    The unknowns are those of the sensors in `used`, by default all logs. Returns (name, joint) ->
    value for each unknown and for the attitudes at which rotations start; empty if nothing is
    unknown.
    """
    starting_values: dict[Key, float] = {}
    for joint in range(1, arm.n_joints + 1):
        axes = axes_on(logs if used is None else used, arm, joint)
        if unknowns_of(axes):
            tables = _axis_tables(logs, arm, axes)
            if isinstance(axes[0].sensor, Accelerometer):
                starting_values[ACCELEROMETER_DISTANCE, joint] = distance_of(axes[0], tables[0])
            else:
                starting_values |= imu_candidates(axes, tables)[0]
    return starting_values


def axes_on(logs: Sequence[Log], arm: Arm, joint: JointNumber) -> tuple[SensorAxis, ...]:
    """Sensor axes on the link of a joint in any of the records, without duplicates."""
    axes_per_log = (mounted_axes(arm, joint, log.channels) for log in logs)
    return tuple(dict.fromkeys(axis for axes in axes_per_log for axis in axes))


def linear_factors(logs: Sequence[Log], arm: Arm, axes: Sequence[SensorAxis]) -> list[FloatArray]:
    """Estimate the factors of the link signals in the reading of each axis.

    The axes belong to one link. Returns one array per axis, in the order of the quantities of its
    sensor. Behind several joint axes the factors follow from the estimated mounting, otherwise from
    linear least squares.
    """
    tables = _axis_tables(logs, arm, axes)
    if axes[0].space.axis is None and isinstance(axes[0].sensor, ImuSensor):
        values = imu_candidates(axes, tables)[0] if unknowns_of(axes) else {}
        return [axis.sensor.weights(axis, values) for axis in axes]
    return [_fit_factors(axis, table) for axis, table in zip(axes, tables, strict=True)]


def _axis_tables(logs: Sequence[Log], arm: Arm, axes: Sequence[SensorAxis]) -> list[FloatArray]:
    """Quantities of each axis and, in the last column, its reading; all centred per record."""
    usable = [
        log for log in logs if len(log) >= _MIN_SAMPLES and f"theta_m{arm.n_joints}" in log.channels
    ]
    first = [np.zeros((1, len(axis.quantities) + 1)) for axis in axes]
    tables = run_parallel([partial(_record_tables, log, arm, axes) for log in usable])
    return [np.concatenate(parts) for parts in zip(first, *tables, strict=True)]


def _record_tables(log: Log, arm: Arm, axes: Sequence[SensorAxis]) -> list[FloatArray]:
    """The tables of one record; without rows for an axis that it lacks."""
    cutoff_hz, tables = _cutoff_hz(log), []
    edge = min(round(_EDGE_PERIODS / (cutoff_hz * log.sample_time)), len(log) // 4)
    of_axes = link_quantities(axes, arm, slow_motion(log, arm))
    for axis, quantities in zip(axes, of_axes, strict=True):
        rows = np.zeros((0, len(axis.quantities) + 1))
        if axis.channel in log.channels:
            reading = low_pass(log.channels[axis.channel], cutoff_hz, log.sample_time)
            rows = np.column_stack([quantities, reading])[edge : len(log) - edge]
            rows = rows - rows.mean(axis=0)
        tables.append(rows)
    return tables


def _cutoff_hz(log: Log) -> float:
    return max(_MAX_FREQUENCY_HZ, _MIN_PERIODS / (len(log) * log.sample_time))


def is_long_enough(log: Log) -> bool:
    """Whether a record determines positions with the accuracy that the decoupled step needs."""
    return _cutoff_hz(log) == _MAX_FREQUENCY_HZ


def slow_motion(log: Log, arm: Arm) -> JointMotion:
    """Motion of the links at low frequencies, where they follow their motors."""
    motors = low_pass(prepare_record(log, arm).motor_angle, _cutoff_hz(log), log.sample_time)
    return JointMotion.of_motors(motors, arm, log.sample_time)


def _fit_factors(axis: SensorAxis, rows: FloatArray) -> FloatArray:
    """Least squares for the factors of one axis over all records, without negligible columns."""
    if isinstance(axis.sensor, Accelerometer):
        distance: dict[Key, float] = {(ACCELEROMETER_DISTANCE, axis.joint): distance_of(axis, rows)}
        return axis.sensor.weights(axis, distance)
    columns, reading = rows[:, :-1], rows[:, -1]
    column_norm = np.linalg.norm(columns, axis=0)
    is_significant = column_norm > _MIN_QUANTITY_NORM * max(float(column_norm.max()), 1e-300)
    estimate = np.zeros(len(axis.is_simulated))
    places = np.flatnonzero(axis.is_simulated)[is_significant]
    estimate[places] = np.linalg.lstsq(columns[:, is_significant], reading)[0]
    return estimate


def distance_of(axis: SensorAxis, rows: FloatArray) -> float:
    """Estimate the distance [m] of a tangential accelerometer from the axis of its link.

    `rows` is (n_rows, n_quantities + 1): the quantities of the axis, and the reading. The estimate
    is by least squares.
    """
    at_axis, at_one = (axis.weights({(ACCELEROMETER_DISTANCE, axis.joint): d}) for d in (0.0, 1.0))
    rotation, tangential = rows[:, :-1] @ (at_one - at_axis), rows[:, -1] - rows[:, :-1] @ at_axis
    return float(rotation @ tangential) / max(float(rotation @ rotation), 1e-300)


def imu_candidates(
    axes: Sequence[SensorAxis], tables: Sequence[FloatArray], *, flat: bool = False
) -> list[dict[Key, float]]:
    """Estimates of an IMU mounting by least squares over its readings, the best first.

    They are the distinct local minima. `axes` belong to one link. Each table is (n_rows,
    n_quantities + 1): the quantities of an axis and, in the last column, its reading. With `flat`,
    the x and y axes of the IMU lie in the plane of motion. Each estimate has (name, joint) -> value
    for `strainwave.domain.arm.link_sensors.unknowns_of` and for the attitude at which the rotation
    starts.
    """
    problems = [_AxisProblem.of(axis, table) for axis, table in zip(axes, tables, strict=True)]
    minima: list[tuple[float, dict[Key, float]]] = []
    for cost, values in _search_minima(problems, flat=flat):
        differences = (
            abs(cost - other_cost) > _MIN_COST_DIFFERENCE * max(cost, other_cost)
            for other_cost, _ in minima
        )
        if all(differences):
            minima.append((cost, values))
    return [_with_positive_distance(values, axes[0]) for _, values in minima]


def _with_positive_distance(values: dict[Key, float], axis: SensorAxis) -> dict[Key, float]:
    """The equivalent mounting with a positive distance: half a turn about the joint axis."""
    joint = axis.joint
    distance = values.get((IMU_DISTANCE, joint), 1.0)
    if distance >= 0.0:
        return values
    turned = _turned(values, axis, (-1.0, -1.0, 1.0)) | {(IMU_DISTANCE, joint): -distance}
    if (IMU_BEARING, joint) in turned:
        turned[IMU_BEARING, joint] += np.pi
    return turned


def mirror_mounting(values: Mapping[Key, float], axis: SensorAxis) -> dict[Key, float]:
    """The mounting on the other side of a link with one axis, with the same factors of f_y, alpha.

    The factors of f_x and w^2 change their sign, which only fast or large motions show. `values`
    must contain a rotation.
    """
    joint, directions = axis.joint, axis.space.directions
    mirrored = _turned(values, axis, (-1.0, 1.0, -1.0))
    if (IMU_BEARING, joint) in mirrored:
        mirrored[IMU_BEARING, joint] = -mirrored[IMU_BEARING, joint]
    keys: list[Key] = [(IMU_POSITION[k], joint) for k in axis.space.free_coordinates]
    if keys[0] in mirrored:
        position = np.zeros(3)
        position[list(axis.space.free_coordinates)] = [values[key] for key in keys]
        opposite = directions.T @ (np.array([1.0, -1.0, 1.0]) * (directions @ position))
        mirrored |= zip(keys, axis.space.coordinates(opposite), strict=True)
    return mirrored


def _turned(
    values: Mapping[Key, float], axis: SensorAxis, signs: Sequence[float]
) -> dict[Key, float]:
    """The mounting with another attitude, by signs along the directions of the link's space."""
    joint, directions = axis.joint, axis.space.directions
    start = directions.T @ np.diag(signs) @ directions @ attitude_of(values, joint)
    return {
        **values,
        **{(name, joint): 0.0 for name in IMU_ROTATION if (name, joint) in values},
        **_start_attitude(start, joint),
    }


def _start_attitude(matrix: FloatArray, joint: int) -> dict[Key, float]:
    rpy = zip(IMU_START_ATTITUDE, angles(matrix).tolist(), strict=True)
    return {(name, joint): angle for name, angle in rpy}


@dataclass(frozen=True, slots=True)
class _AxisProblem:
    """Linear least-squares problem for the factors of one axis."""

    axis: SensorAxis
    root: FloatArray  # (n_factors + 1, n_factors) triangular
    target: FloatArray  # (n_factors + 1,)

    @classmethod
    def of(cls, axis: SensorAxis, rows: FloatArray) -> _AxisProblem:
        """R and Q'y of the rows: |R f - Q'y|^2 is the objective of factors f, up to a constant."""
        n = rows.shape[1] - 1
        ridge = (
            _RELATIVE_RIDGE * max(float(np.linalg.norm(rows[:, :-1])), 1e-150) * np.eye(n, n + 1)
        )
        triangular = np.asarray(np.linalg.qr(np.concatenate([rows, ridge]), mode="r"))
        return cls(axis, triangular[:, :-1], triangular[:, -1])


def _search_minima(
    problems: Sequence[_AxisProblem], *, flat: bool
) -> list[tuple[float, dict[Key, float]]]:
    """Local minima as (objective, mounting), in ascending order of the objective."""
    axes = [problem.axis for problem in problems]
    joint, keys = axes[0].joint, unknowns_of(axes)
    has_rotation = any(key[0] in IMU_ROTATION for key in keys)
    if flat:
        keys = [key for key in keys if key[0] not in IMU_ROTATION[:2]]
    has_bearing = (IMU_BEARING, joint) in keys
    starts = []
    for rotation in _starting_rotations(problems, flat=flat) if has_rotation else [np.eye(3)]:
        for k in range(_N_BEARINGS if has_bearing else 1):
            values = dict.fromkeys(keys, 0.0)
            if has_rotation:
                values |= _start_attitude(rotation, joint)
            if has_bearing:
                values[IMU_BEARING, joint] = 2.0 * np.pi * k / _N_BEARINGS
            candidate = _with_optimal_position(problems, values, keys)
            starts.append((_cost(problems, candidate), candidate))
    starts.sort(key=lambda one: one[0])
    minima = [_find_minimum(problems, values, keys) for _, values in starts[:_MAX_SEARCHES]]
    return sorted(minima, key=lambda one: one[0])


def _starting_rotations(problems: Sequence[_AxisProblem], *, flat: bool) -> Iterator[FloatArray]:
    """Starting rotations.

    On a link that turns about several axes, the linear estimate; on another link right-angle
    rotations and two between each, or rotations in the plane of motion.
    """
    space = problems[0].axis.space
    if space.axis is None:
        yield _linear_rotation(problems)
        return
    if flat:
        for k, side in product(range(8), (1.0, -1.0)):
            c, s = np.cos(k * np.pi / 4.0), np.sin(k * np.pi / 4.0)
            in_plane = np.array([[c, -s * side, 0.0], [s, c * side, 0.0], [0.0, 0.0, side]])
            yield space.directions.T @ in_plane
        return
    intermediate = [attitude(rpy) for rpy in ((0.5, 0.6, 0.7), (-0.7, 0.5, -0.6))]
    for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.eye(3)[:, order] * np.array(signs)
            if np.linalg.det(matrix) > 0.0:
                yield matrix
                yield from (matrix @ rotation for rotation in intermediate)


def _linear_rotation(problems: Sequence[_AxisProblem]) -> FloatArray:
    """The rotation nearest to the directions of the axes by linear least squares.

    An accelerometer reads the specific force along its direction, a gyro the rate.
    """
    directions = np.zeros((3, 3))
    for problem in problems:
        factors = np.linalg.lstsq(problem.root, problem.target)[0]
        directions[:, problem.axis.number] += factors[:3] / np.linalg.norm(factors[:3])
    left, _, right = np.linalg.svd(directions)
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _residual(problems: Sequence[_AxisProblem], values: dict[Key, float]) -> FloatArray:
    parts = [problem.root @ problem.axis.weights(values) - problem.target for problem in problems]
    return np.concatenate(parts)


def _cost(problems: Sequence[_AxisProblem], values: dict[Key, float]) -> float:
    return float(np.sum(_residual(problems, values) ** 2))


def _jacobian(
    problems: Sequence[_AxisProblem], values: dict[Key, float], keys: Sequence[Key]
) -> FloatArray:
    """Derivatives of the residuals with respect to the unknowns, (n_rows, n_keys)."""
    return np.concatenate(
        [problem.root @ problem.axis.slopes(values, keys) for problem in problems]
    )


def _with_optimal_position(
    problems: Sequence[_AxisProblem], values: dict[Key, float], keys: Sequence[Key]
) -> dict[Key, float]:
    """Mounting with the optimal position and gyro factors for its attitude.

    The readings are linear in these unknowns.
    """
    linear = [
        key
        for key in keys
        if key[0] in (IMU_DISTANCE, *IMU_POSITION) or is_kind(key, ConstantKind.SHARE)
    ]
    if not linear:
        return values
    jacobian = _jacobian(problems, values, linear)
    optimum = np.linalg.lstsq(jacobian, -_residual(problems, values))[0]
    placed = {**values, **dict(zip(linear, optimum.tolist(), strict=True))}
    joint = linear[0][1]
    # A negative distance belongs to the opposite bearing.
    if placed.get((IMU_DISTANCE, joint), 1.0) < 0.0:
        placed[IMU_DISTANCE, joint] = 0.0
    return placed


def _find_minimum(
    problems: Sequence[_AxisProblem], values: dict[Key, float], keys: Sequence[Key]
) -> tuple[float, dict[Key, float]]:
    """Levenberg-Marquardt search from a mounting: (objective, mounting) at the local minimum."""
    cost, damping = _cost(problems, values), _INITIAL_DAMPING
    for _ in range(_MAX_ITERATIONS):
        jacobian, residual = _jacobian(problems, values, keys), _residual(problems, values)
        norm = np.linalg.norm(jacobian, axis=0)
        norm = np.maximum(norm, _MIN_COLUMN_NORM * max(float(norm.max()), 1e-300))
        rows = np.concatenate([jacobian / norm, np.sqrt(damping) * np.eye(len(keys))])
        target = np.concatenate([-residual, np.zeros(len(keys))])
        step = np.linalg.lstsq(rows, target)[0] / norm
        step *= min(1.0, _MAX_STEP / max(float(np.max(np.abs(step))), 1e-300))
        changes = zip(keys, step.tolist(), strict=True)
        trial = values | {key: values[key] + change for key, change in changes}
        trial_cost = _cost(problems, trial)
        if trial_cost < cost:
            decrease, cost, values, damping = cost - trial_cost, trial_cost, trial, 0.2 * damping
            if decrease < _RELATIVE_TOLERANCE * cost:
                break
        else:
            damping *= 5.0
            if damping > 1e6:
                break
    return cost, values
