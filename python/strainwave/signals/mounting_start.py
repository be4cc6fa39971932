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
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors import Axis, mounted_axes, unknowns_of
from strainwave.domain.link_sensors.accelerometer import ACCELEROMETER_DISTANCE, Accelerometer
from strainwave.domain.link_sensors.imu import ImuAccelerometers, ImuGyros
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import low_pass
from strainwave.signals.channels import unmeasured
from strainwave.signals.imu_attitude import estimate_imu_starts
from strainwave.signals.link_readings import JointMotion, read_gyro
from strainwave.signals.prepared_record import prepare_record

_MAX_FREQUENCY_HZ = 2.0  # [Hz] below which links follow their motors; most resonances exceed 10 Hz
_MIN_PERIODS = 5.0  # minimum number of periods of the cutoff frequency in a record
_EDGE_PERIODS = 1.0  # excluded edge of a record, in periods of the cutoff (low-pass transient)
_MIN_SAMPLES = 64  # minimum number of samples of a record
_MIN_COLUMN_NORM = 1e-6  # minimum norm of a column relative to the largest one
_MIN_SQUARED_SHARE = 0.1  # of the rate about the axis in the gyros of an IMU
_MIN_DISTANCE = 0.02  # [m] minimum distance from the axis to measure angular acceleration


def accelerometer_quantities(arm: Arm, motion: JointMotion) -> FloatArray:
    """Quantities of which each accelerometer on a link reads a linear combination.

    The result is (n_samples, n_joints, 4): f_x, f_y [m/s^2], alpha [rad/s^2] and w^2 [rad^2/s^2],
    as in `ACCELEROMETER_QUANTITIES`.
    """
    links = motion.links(arm)
    return np.concatenate([links[..., [6, 7, 5]], links[..., 2:3] ** 2], axis=2)


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
        if unknowns_of(axes, arm):
            tables = _axis_tables(logs, arm, axes)
            if isinstance(axes[0].sensor, Accelerometer):
                starting_values[ACCELEROMETER_DISTANCE, joint] = distance_of(tables[0])
            else:
                starting_values |= estimate_imu_starts(axes, tables, arm)
    return starting_values


def axes_on(logs: Sequence[Log], arm: Arm, joint: int) -> tuple[Axis, ...]:
    """Sensor axes on the link of a joint (from 1) in any of the records, without duplicates."""
    axes_per_log = (mounted_axes(arm.joints[joint - 1], joint, log.channels) for log in logs)
    return tuple(dict.fromkeys(axis for axes in axes_per_log for axis in axes))


def linear_factors(logs: Sequence[Log], arm: Arm, axes: Sequence[Axis]) -> list[FloatArray]:
    """Estimate the factors of the quantities in the reading of each axis by linear least squares.

    The axes belong to one link. Returns (n_quantities,) per axis. For a tangential accelerometer,
    the factor of f_y is one, and the factors of f_x and w^2 are zero.
    """
    tables = _axis_tables(logs, arm, axes)
    return [_fit_factors(axis, table) for axis, table in zip(axes, tables, strict=True)]


def _axis_tables(logs: Sequence[Log], arm: Arm, axes: Sequence[Axis]) -> list[FloatArray]:
    """Quantities of each axis and, in the last column, its reading; all centred per record."""
    tables: list[list[FloatArray]] = [[np.zeros((1, len(axis.quantities) + 1))] for axis in axes]
    for log in logs:
        if len(log) < _MIN_SAMPLES or f"theta_m{arm.n_joints}" not in log.channels:
            continue
        motion, i = _motion_from_motors(log, arm), axes[0].joint - 1
        basis, rate = accelerometer_quantities(arm, motion)[:, i], read_gyro(arm, motion, i)
        for axis, table in zip(axes, tables, strict=True):
            if axis.channel not in log.channels:
                continue
            reading = low_pass(log.channels[axis.channel], _cutoff_hz(log), log.sample_time)
            columns = [rate] if isinstance(axis.sensor, ImuGyros) else list(basis.T)
            rows = np.column_stack([*columns, reading])[_inner_samples(log)]
            table.append(rows - rows.mean(axis=0))
    return [np.concatenate(table) for table in tables]


def _cutoff_hz(log: Log) -> float:
    """Cutoff frequency [Hz] for a record."""
    return max(_MAX_FREQUENCY_HZ, _MIN_PERIODS / (len(log) * log.sample_time))


def _motion_from_motors(log: Log, arm: Arm) -> JointMotion:
    """Motion of the joints at low frequencies, from the motors."""
    motors = low_pass(prepare_record(log, arm).motor_angle, _cutoff_hz(log), log.sample_time)
    return JointMotion.of_motors(motors, arm, log.sample_time)


def _inner_samples(log: Log) -> slice:
    """Samples without the transient of the low-pass at both ends."""
    edge = min(round(_EDGE_PERIODS / (_cutoff_hz(log) * log.sample_time)), len(log) // 4)
    return slice(edge, len(log) - edge)


def _fit_factors(axis: Axis, rows: FloatArray) -> FloatArray:
    """Least squares for the factors of one axis over all records, without negligible columns."""
    if isinstance(axis.sensor, Accelerometer):
        return np.array([0.0, 1.0, distance_of(rows), 0.0])
    columns, reading = rows[:, :-1], rows[:, -1]
    column_norm = np.linalg.norm(columns, axis=0)
    is_significant = column_norm > _MIN_COLUMN_NORM * max(float(column_norm.max()), 1e-300)
    estimate = np.zeros(columns.shape[1])
    estimate[is_significant] = np.linalg.lstsq(columns[:, is_significant], reading)[0]
    return estimate


def distance_of(rows: FloatArray) -> float:
    """Estimate the distance [m] of a tangential accelerometer from the axis of its link.

    `rows` is (n_rows, 5): f_x, f_y, alpha and w^2 of the link, and the reading. The estimate is by
    least squares.
    """
    alpha, tangential = rows[:, 2], rows[:, 4] - rows[:, 1]
    return float(alpha @ tangential) / max(float(alpha @ alpha), 1e-300)


def substitute_equivalent_sensors(
    logs: Sequence[Log], arm: Arm, known: Sequence[Log]
) -> tuple[list[Log], Arm]:
    """Replace sensors at unknown positions by equivalent tangential accelerometers or gyros.

    The steps before the whole-arm fit use them. A weighted sum of the axes of an IMU equals one
    tangential accelerometer `a{i}`, with an estimated distance, or a gyro along the axis. If no
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
        linear = linear_factors(known, arm, axes)
        is_long_enough = any(
            _cutoff_hz(log) == _MAX_FREQUENCY_HZ for log in known if axes[0].channel in log.channels
        )
        if not is_long_enough:  # an inaccurate position is worse than no sensor
            logs_then = _without_accelerometer(logs_then, joint)
            continue
        sensor = _equivalent_sensor(arm_then, axes, linear)
        if sensor is None:
            logs_then = _without_accelerometer(logs_then, joint)
            continue
        logs_then = [sensor.added_to(log, arm_then) for log in logs_then]
        before, after = arm_then.joints[: joint - 1], arm_then.joints[joint:]
        arm_then = arm_then.with_joints((*before, sensor.description, *after))
    return logs_then, arm_then


def _without_accelerometer(logs: Sequence[Log], joint: int) -> list[Log]:
    """Logs without the tangential accelerometer of a joint."""
    return [
        replace(log, channels={k: x for k, x in log.channels.items() if k != f"a{joint}"})
        for log in logs
    ]


@dataclass(frozen=True, slots=True)
class _EquivalentSensor:
    """Weighted sum of axes on one link that equals a tangential accelerometer or a gyro."""

    channel: str
    description: Joint  # with the constants of the equivalent sensor
    axes: tuple[Axis, ...]
    weights: FloatArray  # (n_axes,)
    # factors (4,) of other quantities in the sum, which the motors give; None: not subtracted
    others: FloatArray | None = None

    def added_to(self, log: Log, arm: Arm) -> Log:
        """The log with the equivalent sensor, if it has all axes."""
        names = [axis.channel for axis in self.axes]
        if not all(name in log.channels for name in names):
            return log
        reading = self.weights @ np.array([log.channels[name] for name in names])
        if self.others is not None:
            motion, i = _motion_from_motors(log, arm), self.axes[0].joint - 1
            reading -= accelerometer_quantities(arm, motion)[:, i] @ self.others
        channels = {**log.channels, self.channel: reading}
        return replace(
            log, channels=channels, masked={**log.masked, self.channel: unmeasured(log, names)}
        )


def _equivalent_sensor(
    arm: Arm, axes: Sequence[Axis], linear: Sequence[FloatArray]
) -> _EquivalentSensor | None:
    """The equivalent accelerometer or gyro of one link; None if no sum of axes is one."""
    joint = axes[0].joint
    description, pairs = arm.joints[joint - 1], list(zip(axes, linear, strict=True))
    gyros = [(a, f) for a, f in pairs if isinstance(a.sensor, ImuGyros)]
    accelerometers = [(a, f) for a, f in pairs if not isinstance(a.sensor, ImuGyros)]
    factors = [f for _, f in accelerometers]
    weights, distance = _tangential_weights(factors, joint)
    if accelerometers and abs(distance) > _MIN_DISTANCE:
        used = tuple(axis for axis, _ in accelerometers)
        hz, others = used[0].sensor.hz, None
        if isinstance(used[0].sensor, ImuAccelerometers):
            others = weights @ np.array(factors) - np.array([0.0, 1.0, distance, 0.0])
        changed = replace(description, accelerometer_distance=distance, accelerometer_hz=hz)
        return _EquivalentSensor(f"a{joint}", changed, used, weights, others)
    shares = np.array([factor[0] for _, factor in gyros])
    if not float(shares @ shares) > _MIN_SQUARED_SHARE:
        return None
    hz = gyros[0][0].sensor.hz
    # equal delay of the first-order and the second-order low-pass
    changed = replace(description, gyro_hz=hz / np.sqrt(2.0) if hz else None)
    used, weights = tuple(axis for axis, _ in gyros), shares / float(shares @ shares)
    return _EquivalentSensor(f"gyro{joint}", changed, used, weights)


def _tangential_weights(linear: Sequence[FloatArray], joint: int) -> tuple[FloatArray, float]:
    """Weights of a sum of axes with factor one of f_y and zero of f_x, and its factor of alpha.

    On the first link, where f is small, the sum has factor one of alpha and zero of w^2. The factor
    is zero if no weights achieve this.
    """
    if not linear:
        return np.zeros(0), 0.0
    matrix = np.array(linear).T  # (4, n_axes)
    if len(linear) == 1 and joint > 1:
        return np.ones(1), float(matrix[2, 0]) if abs(matrix[1, 0] - 1.0) < 0.1 else 0.0
    rows, target = (matrix[:2], [0.0, 1.0]) if joint > 1 else (matrix[[3, 2]], [0.0, 1.0])
    weights = np.linalg.pinv(rows, rcond=0.1) @ target
    achieved = rows @ weights
    if abs(achieved[1] - 1.0) > 0.1 or abs(achieved[0]) > 0.1:
        return weights, 0.0
    return weights, float(matrix[2] @ weights)
