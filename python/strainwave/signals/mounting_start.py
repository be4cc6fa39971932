"""Starting values of sensor positions for the whole-arm fit, from low-frequency signals.

Far below the resonances, links follow their motors, so kinematics alone give the quantities of
which each accelerometer reading is a linear combination. Least squares estimate its factors. The
effect of the springs, a few percent, is left to the whole-arm fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Joint, Log
from strainwave.domain.arm.link_sensors import SensorAxis, mounted_axes, unknowns_of
from strainwave.domain.arm.link_sensors.imu import ImuAccelerometers, ImuGyros, ImuSensor
from strainwave.domain.arm.link_sensors.link_space import (
    ACCELEROMETER_QUANTITIES,
    GYRO_QUANTITIES,
    LinkSpace,
    accelerometer_weights,
    axes_about,
)
from strainwave.domain.arm.link_sensors.single_axis import ACCELEROMETER_DISTANCE, Accelerometer
from strainwave.domain.keys import JointNumber, Key
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import low_pass
from strainwave.signals.channels import unmeasured
from strainwave.signals.imu_attitude import imu_candidates
from strainwave.signals.link_readings import JointMotion
from strainwave.signals.prepared_record import prepare_record

_MAX_FREQUENCY_HZ = 2.0  # [Hz] below which links follow their motors; most resonances exceed 10 Hz
_MIN_PERIODS = 5.0  # minimum number of periods of the cutoff frequency in a record
_EDGE_PERIODS = 1.0  # excluded edge of a record, in periods of the cutoff (low-pass transient)
_MIN_SAMPLES = 64  # minimum number of samples of a record
_MIN_COLUMN_NORM = 1e-6  # minimum norm of a column relative to the largest one
_MIN_SQUARED_SHARE = 0.1  # of the rate about the axis in the gyros of an IMU
_MAX_FACTOR_ERROR = 0.1  # of a sum of axes that replaces a tangential accelerometer
_MIN_DISTANCE = 0.02  # [m] minimum distance from the axis to measure angular acceleration


def link_quantities(axis: SensorAxis, arm: Arm, motion: JointMotion) -> FloatArray:
    """The quantities (n_samples, n_quantities) that an axis reads, from the joints' motion."""
    rates, accelerations, forces = np.split(motion.links(arm)[:, axis.joint - 1], 3, axis=1)
    products = rates[:, [0, 1, 2, 0, 0, 1]] * rates[:, [0, 1, 2, 1, 2, 2]]
    names = (*ACCELEROMETER_QUANTITIES, *GYRO_QUANTITIES)
    signals = np.column_stack([forces, accelerations, products, rates])
    return signals[:, [names.index(name) for name in axis.quantities]]


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
    tables: list[list[FloatArray]] = [[np.zeros((1, len(axis.quantities) + 1))] for axis in axes]
    for log in logs:
        if len(log) < _MIN_SAMPLES or f"theta_m{arm.n_joints}" not in log.channels:
            continue
        motion = _motion_from_motors(log, arm)
        for axis, table in zip(axes, tables, strict=True):
            if axis.channel not in log.channels:
                continue
            reading = low_pass(log.channels[axis.channel], _cutoff_hz(log), log.sample_time)
            rows = np.column_stack([link_quantities(axis, arm, motion), reading])
            edge = min(round(_EDGE_PERIODS / (_cutoff_hz(log) * log.sample_time)), len(log) // 4)
            rows = rows[edge : len(log) - edge]
            table.append(rows - rows.mean(axis=0))
    return [np.concatenate(table) for table in tables]


def _cutoff_hz(log: Log) -> float:
    return max(_MAX_FREQUENCY_HZ, _MIN_PERIODS / (len(log) * log.sample_time))


def _motion_from_motors(log: Log, arm: Arm) -> JointMotion:
    motors = low_pass(prepare_record(log, arm).motor_angle, _cutoff_hz(log), log.sample_time)
    return JointMotion.of_motors(motors, arm, log.sample_time)


def _fit_factors(axis: SensorAxis, rows: FloatArray) -> FloatArray:
    """Least squares for the factors of one axis over all records, without negligible columns."""
    if isinstance(axis.sensor, Accelerometer):
        distance: dict[Key, float] = {(ACCELEROMETER_DISTANCE, axis.joint): distance_of(axis, rows)}
        return axis.sensor.weights(axis, distance)
    columns, reading = rows[:, :-1], rows[:, -1]
    column_norm = np.linalg.norm(columns, axis=0)
    is_significant = column_norm > _MIN_COLUMN_NORM * max(float(column_norm.max()), 1e-300)
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


def substitute_equivalent_sensors(
    logs: Sequence[Log], arm: Arm, known: Sequence[Log]
) -> tuple[list[Log], Arm]:
    """Replace sensors at unknown positions by equivalent tangential accelerometers or gyros.

    The steps before the whole-arm fit use them. A weighted sum of the axes of an IMU equals one
    tangential accelerometer `a{i}`, with an estimated distance, or a gyro along the axis; on a
    prismatic joint, one accelerometer along the axis. If no
    such sum exists, the sensor is omitted. `known` are all logs, which determine the positions.
    Logs and arm are unchanged if no position is unknown.
    """
    arm_then, logs_then = arm, list(logs)
    for joint in range(1, arm.n_joints + 1):
        axes = axes_on(logs, arm, joint)
        direct_sensors = {"a", "theta_l", "gyro", "deflection"}
        if axes and isinstance(axes[0].sensor, Accelerometer):
            direct_sensors = set()
        has_direct_sensor = any(
            f"{name}{joint}" in log.channels for name in direct_sensors for log in logs
        )
        if not axes or has_direct_sensor:
            continue
        is_long_enough = any(
            _cutoff_hz(log) == _MAX_FREQUENCY_HZ for log in known if axes[0].channel in log.channels
        )
        sensor = None
        if is_long_enough:  # an inaccurate position is worse than no sensor
            sensor = _equivalent_sensor(arm_then, axes, linear_factors(known, arm, axes))
        if sensor is None:
            logs_then = [
                replace(log, channels={k: x for k, x in log.channels.items() if k != f"a{joint}"})
                for log in logs_then
            ]
            continue
        logs_then = [sensor.added_to(log, arm_then) for log in logs_then]
        before, after = arm_then.joints[: joint - 1], arm_then.joints[joint:]
        arm_then = arm_then.with_joints((*before, sensor.description, *after))
    return logs_then, arm_then


@dataclass(frozen=True, slots=True)
class _EquivalentSensor:
    """Weighted sum of axes on one link that equals a tangential accelerometer or a gyro."""

    channel: str
    description: Joint  # with the constants of the equivalent sensor
    axes: tuple[SensorAxis, ...]
    weights: FloatArray  # (n_axes,)
    # factors of other quantities in the sum, which the motors give; None: not subtracted
    others: FloatArray | None = None

    def added_to(self, log: Log, arm: Arm) -> Log:
        """The log with the equivalent sensor, if it has all axes."""
        names = [axis.channel for axis in self.axes]
        if not all(name in log.channels for name in names):
            return log
        reading = self.weights @ np.array([log.channels[name] for name in names])
        if self.others is not None:
            axis, motion = self.axes[0], _motion_from_motors(log, arm)
            reading -= link_quantities(axis, arm, motion) @ self.others[axis.is_simulated]
        channels = {**log.channels, self.channel: reading}
        return replace(
            log, channels=channels, masked={**log.masked, self.channel: unmeasured(log, names)}
        )


def _equivalent_sensor(
    arm: Arm, axes: Sequence[SensorAxis], linear: Sequence[FloatArray]
) -> _EquivalentSensor | None:
    """The equivalent accelerometer or gyro of one link; None if no sum of axes is one."""
    joint, space = axes[0].joint, axes[0].space
    x, y, z = axes_about(arm.joints[joint - 1].axis)
    description, pairs = arm.joints[joint - 1], list(zip(axes, linear, strict=True))
    gyros = [(a, f) for a, f in pairs if isinstance(a.sensor, ImuGyros)]
    accelerometers = [(a, f) for a, f in pairs if not isinstance(a.sensor, ImuGyros)]
    factors = [f for _, f in accelerometers]
    if description.motion == "prismatic":
        return _along_the_slide(description, joint, accelerometers, z)
    weights, distance = _tangential_weights(factors, (x, y, z), space)
    if accelerometers and abs(distance) > _MIN_DISTANCE:
        used = tuple(axis for axis, _ in accelerometers)
        hz, others = used[0].sensor.hz, None
        if isinstance(used[0].sensor, ImuAccelerometers):
            tangential = accelerometer_weights(y.tolist(), (distance * x).tolist())
            others = weights @ np.array(factors) - tangential
        changed = replace(description, accelerometer_distance=distance, accelerometer_hz=hz)
        return _EquivalentSensor(f"a{joint}", changed, used, weights, others)
    shares = np.array([factor @ z for _, factor in gyros])
    if not float(shares @ shares) > _MIN_SQUARED_SHARE:
        return None
    hz = gyros[0][0].sensor.hz
    # equal delay of the first-order and the second-order low-pass
    changed = replace(description, gyro_hz=hz / np.sqrt(2.0) if hz else None)
    used, weights = tuple(axis for axis, _ in gyros), shares / float(shares @ shares)
    others = weights @ np.array([f for _, f in gyros]) - z if space.axis is None else None
    return _EquivalentSensor(f"gyro{joint}", changed, used, weights, others)


def _along_the_slide(
    description: Joint,
    joint: int,
    accelerometers: Sequence[tuple[SensorAxis, FloatArray]],
    z: FloatArray,
) -> _EquivalentSensor | None:
    """The equivalent accelerometer along a prismatic joint, at the origin of its link."""
    if not accelerometers:
        return None
    factors = np.array([factor for _, factor in accelerometers])
    forces = factors[:, :3].T
    weights = np.linalg.pinv(forces, rcond=0.1) @ z
    if np.any(np.abs(forces @ weights - z) > _MAX_FACTOR_ERROR):
        return None
    used = tuple(axis for axis, _ in accelerometers)
    others = weights @ factors - accelerometer_weights(z.tolist(), (0.0, 0.0, 0.0))
    changed = replace(description, accelerometer_hz=used[0].sensor.hz)
    return _EquivalentSensor(f"a{joint}", changed, used, weights, others)


def _tangential_weights(
    linear: Sequence[FloatArray], directions: Sequence[FloatArray], space: LinkSpace
) -> tuple[FloatArray, float]:
    """Weights of a sum of axes that reads f along the tangent only, and its factor of alpha.

    `directions` are x, along the link, the tangent y and the axis z of the joint. About a fixed
    axis, where f is small, the sum has factor one of alpha and zero of w^2. The factor is zero if
    no weights achieve this.
    """
    if not linear:
        return np.zeros(0), 0.0
    forces, accelerations, products = np.split(np.array(linear).T, [3, 6])  # (.., n_axes)
    x, y, z = directions
    by_alpha = z @ accelerations
    if len(linear) == 1 and not space.is_axis_fixed:
        is_tangential = abs(y @ forces[:, 0] - 1.0) < _MAX_FACTOR_ERROR
        return np.ones(1), float(by_alpha[0]) if is_tangential else 0.0
    if space.is_axis_fixed:
        by_square = (z[[0, 1, 2, 0, 0, 1]] * z[[0, 1, 2, 1, 2, 2]]) @ products
        rows, target = np.array([by_square, by_alpha]), np.array([0.0, 1.0])
    else:
        rows, target = np.array([x, y, z]) @ forces, np.array([0.0, 1.0, 0.0])
    weights = np.linalg.pinv(rows, rcond=0.1) @ target
    if np.any(np.abs(rows @ weights - target) > _MAX_FACTOR_ERROR):
        return weights, 0.0
    return weights, float(by_alpha @ weights)
