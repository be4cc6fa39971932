"""Consistency of the motor signals: servo references, servo outputs, velocities, torques.

At low frequency, a servo-controlled motor follows its reference, its voltage is the servo output
for the tracking error, and the torques satisfy the equations of rigid joints, (5) to (7), for any
gear stiffness.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from strainwave.domain import BoolArray, FloatArray, channel_parts
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate
from strainwave.signals.consistency.evidence import Evidence, SlowRecord, is_slow
from strainwave.signals.consistency.regression import Comparison, regress
from strainwave.signals.consistency.sensors import recall_motion
from strainwave.signals.drive_law import DriveLaw

# Maximum share of samples at the servo limit; above it, the servo law does not hold.
_MAX_SATURATED_SHARE = 0.01
# Minimum magnitude of the mean sign of the motor velocity for a row to count as sliding.
_MIN_MEAN_DIRECTION = 0.8
# Minimum number of sliding rows. With fewer, the regression uses all rows.
_MIN_SLIDING_ROWS = 60
# Rows of a stretch of a long record: ten periods of the bandwidth frequency.
_STRETCH_ROWS = 200


EFFORTS = ("torque", "u", "tau_l")
"""Kinds of channels of the effort of a joint, of which the first present one is compared."""


def compute_reference_ratios(evidence: Evidence) -> list[Comparison]:
    """Ratios of low-frequency motor velocity to servo reference.

    Covers the joints under servo control whose reference varies.
    """
    ratios: list[Comparison] = []
    for record, i in _servo_controlled(evidence):
        reference = record.channels[f"ref{i}"]
        velocity = differentiate(record.channels[f"theta_m{i}"], record.sample_time)
        slope = differentiate(reference, record.sample_time)
        slope2 = differentiate(slope, record.sample_time)
        columns = np.column_stack([reference, slope, slope2])[record.inside]
        ratios.extend(_regress_ratio("reference", record, f"theta_m{i}", velocity, columns))
    return ratios


def compute_servo_output_ratios(evidence: Evidence) -> list[Comparison]:
    """Ratios of the logged voltage to the servo output kp e + ki int(e) of the study.

    e is reference minus motor velocity. Excludes joints with a PRBS added to the servo output, and
    servos with a position loop: its law integrates twice, which the slow rows do not resolve.
    """
    ratios: list[Comparison] = []
    servo = evidence.arm.servo
    if servo is None or servo.position_gain is not None:
        return ratios
    for record, i in _servo_controlled(evidence):
        name = f"u{i}"
        has_prbs = record.experiment.prbs is not None and record.experiment.joint in (None, i)
        if has_prbs or name not in record.channels:
            continue
        angle, reference = record.channels[f"theta_m{i}"], record.channels[f"ref{i}"]
        error = reference - differentiate(angle, record.sample_time)
        integral = np.cumsum(reference) * record.sample_time - angle
        expected = servo.kp[i - 1] * error + servo.ki[i - 1] * integral
        ratios.extend(
            _regress_ratio(
                "servo", record, name, record.channels[name], expected[record.inside, None]
            )
        )
    return ratios


def compute_velocity_ratios(evidence: Evidence) -> list[Comparison]:
    """Ratios of the logged motor velocity to the derivative of the motor angle."""
    ratios: list[Comparison] = []
    for record in evidence.records:
        for i in range(1, evidence.arm.n_joints + 1):
            if f"omega_m{i}" in record.channels:
                ratios.extend(_recall_velocity_ratio(evidence, record, i))
    return ratios


def _recall_velocity_ratio(evidence: Evidence, record: SlowRecord, i: int) -> list[Comparison]:
    """Velocity ratio of motor i, from 1, in one record, computed once."""
    name = f"omega_m{i}"
    angle, velocity = record.channels[f"theta_m{i}"], record.channels[name]

    def compute() -> list[Comparison]:
        columns = differentiate(angle, record.sample_time)[record.inside, None]
        return [*_regress_ratio("velocity", record, name, velocity, columns)]

    setting = ("velocity", i, record.sample_time)
    return evidence.memory.recall(setting, (angle, velocity), compute)


def motor_signals(record: SlowRecord, arm: Arm) -> list[FloatArray]:
    """Angles and inputs of the motors of a record."""
    names = (f"{kind}{i}" for kind in ("theta_m", *EFFORTS) for i in range(1, arm.n_joints + 1))
    return [record.channels[name] for name in names if name in record.channels]


def compare_torque_sensors(evidence: Evidence) -> Iterator[Comparison]:
    """Ratios of torques behind the gears to those of the motors, without friction and rotor."""
    for record in evidence.records:
        for i, joint in enumerate(evidence.arm.joints, start=1):
            motor, sensor = f"torque{i}", f"tau_l{i}"
            if {motor, sensor} <= set(record.channels) and not evidence.arm.is_coupled:
                rate = differentiate(record.channels[f"theta_m{i}"], record.sample_time)
                own = [record.channels[motor] / joint.gear_ratio, rate, record.direction[:, i - 1]]
                own.append(differentiate(rate, record.sample_time))
                columns = np.column_stack(own)[record.inside]
                yield from _regress_ratio(
                    "torque-sensor", record, sensor, record.channels[sensor], columns
                )


def implied_mass(evidence: Evidence) -> float | None:
    """Largest torque of a joint over the torque of a mass of 1 kg at the reach of the arm [kg].

    None without logged torques, of planar arms, whose distant masses have no length in the study,
    and with prismatic joints.
    """
    arm = evidence.arm
    lengths = [float(np.linalg.norm(joint.origin.xyz)) for joint in arm.joints[1:]]
    is_sliding = any(joint.motion == "prismatic" for joint in arm.joints)
    if not sum(lengths) or is_sliding or arm.has_planar_program:
        return None
    reach, masses = sum(lengths), []
    for record in evidence.records:
        motion = recall_motion(record, evidence)
        for i, joint in enumerate(arm.joints):
            name = effort_channel(record.channels, i + 1)
            if is_slow(record.experiment) and name and channel_parts(name)[0] != "u":
                torque = np.ptp(compute_motor_torque(record, arm, i)[record.inside])
                fastest = float(np.abs(motion.acceleration[record.inside, i]).max())
                size = reach * np.hypot(arm.gravity_size or 0.0, reach * fastest)
                masses.append(0.5 * float(torque) / abs(joint.gear_ratio) / max(size, 1e-300))
    return float(max(masses)) if masses else None


def link_speed(evidence: Evidence) -> float | None:
    """Largest speed of a revolute joint [rad/s]; None of a single joint, which may spin."""
    if evidence.arm.n_joints == 1:
        return None
    speeds = [
        float(np.abs(recall_motion(r, evidence).velocity[r.inside, i]).max())
        for r in evidence.records
        for i, joint in enumerate(evidence.arm.joints)
        if joint.motion == "revolute" and r.inside.any()
    ]
    return max(speeds, default=None)


def _servo_controlled(evidence: Evidence) -> Iterator[tuple[SlowRecord, int]]:
    """Records and joints (from 1) under servo control, unsaturated, with a varying reference."""
    if evidence.arm.servo is None:
        return
    limit = 0.999 * evidence.arm.servo.limit
    for record in evidence.records:
        for i, control in enumerate(record.experiment.control, start=1):
            if control != "servo" or f"ref{i}" not in record.channels:
                continue
            voltage = record.channels.get(f"u{i}")
            if voltage is not None and np.mean(np.abs(voltage) >= limit) > _MAX_SATURATED_SHARE:
                continue
            if np.ptp(record.channels[f"ref{i}"]) > 0.0:
                yield record, i


def _regress_ratio(
    kind: str, record: SlowRecord, channel: str, target: FloatArray, columns: FloatArray
) -> Iterator[Comparison]:
    """Coefficient of the first column in a regression; no ratio if the regression fails."""
    fit = regress(target[record.inside], columns)
    if fit is not None:
        values = {kind: fit.coefficient(0)}
        yield Comparison(channel, record.experiment.name, fit.explained, values)


def spread_stretches(records: Sequence[SlowRecord], max_rows: int) -> list[list[slice]]:
    """Stretches of rows of each record, spread evenly over it; one at least per record.

    Whole records if these have no more than `max_rows`.
    """
    n_rows = [len(record.inside) for record in records]
    if sum(n_rows) <= max_rows:
        return [[slice(0, n)] for n in n_rows]
    share = max_rows / sum(n_rows)
    return [_stretches(n, max(1, int(share * n / _STRETCH_ROWS))) for n in n_rows]


def _stretches(n_rows: int, count: int) -> list[slice]:
    """Stretches in the centres of `count` equal parts of a record."""
    length, part = min(_STRETCH_ROWS, n_rows), n_rows / count
    starts = [int((k + 0.5) * part - 0.5 * length) for k in range(count)]
    return [slice(start, start + length) for start in starts]


def sliding_rows(record: SlowRecord, i: int) -> BoolArray:
    """Rows in which joint i (from 0) slides, (n_rows,); all inner rows if these are too few.

    Near a velocity reversal and at rest, the Coulomb friction is undetermined between its two
    values.
    """
    if not record.moves[i]:
        return np.zeros_like(record.inside)
    rows = record.inside & (np.abs(record.direction[:, i]) > _MIN_MEAN_DIRECTION)
    return rows if rows.sum() > _MIN_SLIDING_ROWS else record.inside


def compute_motor_torque(record: SlowRecord, arm: Arm, i: int) -> FloatArray:
    """Motor torque of joint i (from 0), (n_rows,) [N m].

    Returns the logged torque, torque_per_volt times the voltage (with a scale of 1 if the study
    gives no torque_per_volt), or the reading of a sensor behind the gear.
    """
    name = effort_channel(record.channels, i + 1) or ""
    kind = channel_parts(name)[0]
    if kind == "torque":
        return record.channels[name]
    if kind == "tau_l":
        return arm.joints[i].gear_ratio * record.channels[name]
    return DriveLaw.of(arm.joints[i]).command(record.channels[name])


def effort_channel(channels: Collection[str], joint: int) -> str | None:
    """Channel of the effort of a joint, from 1: of its motor, or of a sensor behind the gear."""
    names = (f"{kind}{joint}" for kind in EFFORTS)
    return next((name for name in names if name in channels), None)
