"""Where sensors sit, by the slow part of their signals: a start for the whole-arm fit.

Far below the resonances links move as their motors do, so that kinematics alone give what every
accelerometer reads a combination of; least squares then give the combination. What the springs add
there, some hundredths, is left to the whole-arm fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, Imu, Log
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.mounting import DISTANCE, Axis, axes_of, unknowns_of
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.signals.channels import unmeasured
from strainwave.signals.imu_attitude import imu_starts

Key = tuple[str, int | None]

_SLOW = 2.0  # [Hz] below which links follow their motors: few arms resonate below 10 Hz
_PERIODS = 5.0  # of the highest frequency used that a short record has
_EDGE = 1.0  # periods of it, at a record's ends, that its low-pass spoils
_LEAST = 64  # samples of a record to be of use
_WEAK = 1e-6  # of a column beside the largest, below which it says nothing
_NEAR = 0.02  # [m] from its axis at which an accelerometer no longer shows a link's turning


def kinematics(
    angle: FloatArray, velocity: FloatArray, acceleration: FloatArray, arm: Arm
) -> FloatArray:
    """What every accelerometer on each link reads a combination of, by the links' motion.

    Parameters
    ----------
    angle, velocity, acceleration : (n_samples, n_joints) [rad, rad/s, rad/s^2]
        Of the links, each relative to the one before.
    arm : Arm

    Returns
    -------
    (n_samples, n_joints, 4)
        f_x, f_y [m/s^2], alpha [rad/s^2] and w^2 [rad^2/s^2], as
        `strainwave.dynamics.mounting.BASIS`.
    """
    g, length = arm.gravity or 0.0, arm.link_length or 0.0
    in_space, rate, turning = (x.cumsum(axis=1) for x in (angle, velocity, acceleration))
    found = np.stack([g * np.sin(in_space), g * np.cos(in_space), turning, rate**2], axis=2)
    if arm.n_joints > 1:
        sin, cos = np.sin(angle[:, 1]), np.cos(angle[:, 1])
        across, inward = length * acceleration[:, 0], length * velocity[:, 0] ** 2
        found[:, 1, 0] += across * sin - inward * cos
        found[:, 1, 1] += across * cos + inward * sin
    return found


def mounting_starts(
    logs: Sequence[Log], arm: Arm, used: Sequence[Log] | None = None
) -> dict[Key, float]:
    """The unknowns of all mountings, by least squares on the slow part of the records.

    Parameters
    ----------
    logs : sequence of Log
        Of any use.
    arm : Arm
    used : sequence of Log, optional
        Those whose sensors are to be placed; all of them if it is not given.

    Returns
    -------
    dict
        (name, joint) -> value of each unknown, and of the attitudes that turns start from; empty
        where nothing is unknown.
    """
    found: dict[Key, float] = {}
    for joint in range(1, arm.n_joints + 1):
        axes = axes_on(logs if used is None else used, arm, joint)
        if unknowns_of(axes, arm):
            tables = _tables(logs, arm, axes)
            if axes[0].kind == "tangential":
                found[DISTANCE, joint] = distance_of(tables[0])
            else:
                found |= imu_starts(axes, tables, arm)
    return found


def axes_on(logs: Sequence[Log], arm: Arm, joint: int) -> tuple[Axis, ...]:
    """The axes on a link that any of the records has.

    Parameters
    ----------
    logs : sequence of Log
    arm : Arm
    joint : int
        From 1.

    Returns
    -------
    tuple of Axis
    """
    each = (axes_of(log.channels, arm, joint) for log in logs)
    return tuple(dict.fromkeys(axis for axes in each for axis in axes))


def linear_factors(logs: Sequence[Log], arm: Arm, axes: Sequence[Axis]) -> list[FloatArray]:
    """What each of an axis's quantities counts in its reading, by linear least squares.

    Parameters
    ----------
    logs : sequence of Log
    arm : Arm
    axes : sequence of Axis
        Of one link.

    Returns
    -------
    list of (n_quantities,)
        Of a tangential accelerometer f_y counts once, and f_x and w^2 not at all.
    """
    tables = _tables(logs, arm, axes)
    return [_solved(axis, table) for axis, table in zip(axes, tables, strict=True)]


def _tables(logs: Sequence[Log], arm: Arm, axes: Sequence[Axis]) -> list[FloatArray]:
    """Of each axis, columns of what it reads a combination of and, last, what it reads."""
    tables: list[list[FloatArray]] = [[np.zeros((1, len(axis.quantities) + 1))] for axis in axes]
    for log in logs:
        if len(log) < _LEAST or f"theta_m{arm.n_joints}" not in log.channels:
            continue
        basis, rate = _by_motors(log, arm, axes[0].joint)
        for axis, table in zip(axes, tables, strict=True):
            if axis.channel not in log.channels:
                continue
            read = low_pass(log.channels[axis.channel], _slow(log), log.sample_time)
            columns = [rate] if axis.kind == "gyro" else list(basis.T)
            rows = np.column_stack([*columns, read])[_inside(log)]
            table.append(rows - rows.mean(axis=0))
    return [np.concatenate(table) for table in tables]


def _slow(log: Log) -> float:
    """Frequency [Hz] up to which a record is used."""
    return max(_SLOW, _PERIODS / (len(log) * log.sample_time))


def _by_motors(log: Log, arm: Arm, joint: int) -> tuple[FloatArray, FloatArray]:
    """One link's basis and rate as its motors move it: (n_samples, 4), (n_samples,)."""
    T, joints = log.sample_time, arm.joints
    angle = np.column_stack(
        [own.gear_ratio * log.channels[f"theta_m{i}"] for i, own in enumerate(joints, start=1)]
    )
    q = low_pass(angle, _slow(log), T)
    dq = differentiate(q, T)
    basis = kinematics(q, dq, differentiate(dq, T), arm)[:, joint - 1]
    return basis, dq[:, :joint].sum(axis=1)


def _inside(log: Log) -> slice:
    edge = min(round(_EDGE / (_slow(log) * log.sample_time)), len(log) // 4)
    return slice(edge, len(log) - edge)


def _solved(axis: Axis, rows: FloatArray) -> FloatArray:
    """Least squares over all records, without columns that are nothing."""
    if axis.kind == "tangential":
        return np.array([0.0, 1.0, distance_of(rows), 0.0])
    columns, read = rows[:, :-1], rows[:, -1]
    size = np.linalg.norm(columns, axis=0)
    strong = size > _WEAK * max(float(size.max()), 1e-300)
    found = np.zeros(columns.shape[1])
    found[strong] = np.linalg.lstsq(columns[:, strong], read)[0]
    return found


def distance_of(rows: FloatArray) -> float:
    """The distance from its link's axis of an accelerometer across it, by least squares.

    Parameters
    ----------
    rows : (n_rows, 5)
        f_x, f_y, alpha and w^2 of the link, and what the sensor reads.

    Returns
    -------
    float [m]
    """
    own, read = rows[:, 2], rows[:, 4] - rows[:, 1]
    return float(own @ read) / max(float(own @ own), 1e-300)


def with_stand_ins(logs: Sequence[Log], arm: Arm, known: Sequence[Log]) -> tuple[list[Log], Arm]:
    """Tangential accelerometers made of sensors of unknown place, for the steps before the fit.

    A weighted sum of an IMU's axes reads what one accelerometer across the link does, or a gyro
    along the axis; an `a{i}` gets its distance. Where no sum does, the sensor is left out.

    Parameters
    ----------
    logs : sequence of Log
    arm : Arm
    known : sequence of Log
        All there are, by which the sensors are placed.

    Returns
    -------
    list of Log, Study
        As they are where no place is unknown.
    """
    arm_then, logs_then = arm, list(logs)
    for joint in range(1, arm.n_joints + 1):
        axes = axes_on(logs, arm, joint)
        taken = {"a", "theta_l", "gyro", "deflection"}
        if axes and axes[0].kind == "tangential":
            taken = set()
        has = any(f"{name}{joint}" in log.channels for name in taken for log in logs)
        if not axes or has:
            continue
        linear = linear_factors(known, arm, axes)
        long = any(_slow(log) == _SLOW for log in known if axes[0].channel in log.channels)
        if not long:  # a guess of a place is worse than none
            logs_then = _left_out(logs_then, joint)
            continue
        logs_then, arm_then = _stood_in(logs_then, arm_then, axes, linear)
    return logs_then, arm_then


def _left_out(logs: Sequence[Log], joint: int) -> list[Log]:
    """Without the accelerometer across a link."""
    return [
        replace(log, channels={k: x for k, x in log.channels.items() if k != f"a{joint}"})
        for log in logs
    ]


def _stood_in(
    logs: list[Log], arm: Arm, axes: Sequence[Axis], linear: Sequence[FloatArray]
) -> tuple[list[Log], Arm]:
    joint = axes[0].joint
    drive = arm.joints[joint - 1]
    imu = drive.imu or Imu()
    own = [k for k, axis in enumerate(axes) if axis.kind != "gyro"]
    weights, distance = _tangential([linear[k] for k in own], arm, joint)
    if own and abs(distance) > _NEAR:
        hz = drive.accelerometer_hz if axes[0].kind == "tangential" else imu.accelerometer_hz
        changed = replace(drive, accelerometer_distance=distance, accelerometer_hz=hz)
        used, name = [axes[k] for k in own], f"a{joint}"
    else:
        used = [axis for axis in axes if axis.kind == "gyro"]
        shares = np.array([f[0] for a, f in zip(axes, linear, strict=True) if a.kind == "gyro"])
        if not used or not float(shares @ shares) > 0.1:
            return _left_out(logs, joint), arm
        # of the same delay as one of second order
        changed = replace(drive, gyro_hz=imu.gyro_hz / np.sqrt(2.0) if imu.gyro_hz else None)
        weights, name = shares / float(shares @ shares), f"gyro{joint}"
    found = []
    for log in logs:
        channels, masked = dict(log.channels), dict(log.masked)
        if all(axis.channel in channels for axis in used):
            parts = (w * channels[a.channel] for w, a in zip(weights, used, strict=True))
            channels[name] = np.asarray(sum(parts))
            masked[name] = unmeasured(log, (axis.channel for axis in used))
            counts = sum(w * f for w, f in zip(weights, [linear[k] for k in own], strict=True))
            if name.startswith("a") and axes[0].kind != "tangential":
                channels[name] = channels[name] - _beside(log, arm, joint, counts, distance)
        found.append(replace(log, channels=channels, masked=masked))
    joints = tuple(changed if i == joint - 1 else j for i, j in enumerate(arm.joints))
    return found, arm.with_joints(joints)


def _tangential(linear: Sequence[FloatArray], arm: Arm, joint: int) -> tuple[FloatArray, float]:
    """Weights of axes whose sum counts f_y once and f_x not at all, and how it counts alpha.

    On the first link, where f says little, the sum counts alpha once, and w^2 not at all.
    """
    if not linear:
        return np.zeros(0), 0.0
    counts = np.array(linear).T  # (4, n_axes)
    if len(linear) == 1 and joint > 1:
        return np.ones(1), float(counts[2, 0]) if abs(counts[1, 0] - 1.0) < 0.1 else 0.0
    rows, target = (counts[:2], [0.0, 1.0]) if joint > 1 else (counts[[3, 2]], [0.0, 1.0])
    weights = np.linalg.pinv(rows, rcond=0.1) @ target
    reached = rows @ weights
    if abs(reached[1] - 1.0) > 0.1 or abs(reached[0]) > 0.1:
        return weights, 0.0
    return weights, float(counts[2] @ weights)


def _beside(log: Log, arm: Arm, joint: int, counts: FloatArray, distance: float) -> FloatArray:
    """What a sum counts beside f_y and alpha, by the motors: (n_samples,)."""
    basis, _ = _by_motors(log, arm, joint)
    return np.asarray(basis @ (counts - np.array([0.0, 1.0, distance, 0.0])))
