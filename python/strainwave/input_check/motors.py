"""Consistency of the motor signals: servo references, servo outputs, velocities, torques.

At low frequency, a servo-controlled motor follows its reference, its voltage is the servo output
for the tracking error, and the torques satisfy the equations of rigid joints, (5) to (7), for any
gear stiffness.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from functools import partial

import numpy as np

from strainwave.domain import BoolArray, FloatArray, channel_parts
from strainwave.dynamics.arm import Arm
from strainwave.input_check.evidence import Evidence, PredictedSignal, SlowRecord, is_slow
from strainwave.input_check.sensors import recall_motion
from strainwave.numerics.filters import differentiate
from strainwave.numerics.regression import regress
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


def compare_motor_signals(evidence: Evidence) -> Iterator[PredictedSignal]:
    """Compare motor velocities with references and with logged velocities, and torque sensors.

    A reference is compared where it varies and the servo is not at its limit; a torque behind a
    gear with that of the motor without friction and rotor.
    """
    kinds = ("theta_m", "ref", "omega_m", "u", "torque", "tau_l")
    for record in evidence.records:
        for i, joint in enumerate(evidence.arm.joints, start=1):
            signals = [record.channels.get(f"{kind}{i}") for kind in kinds]
            setting = ("motor", i, record.sample_time, joint.gear_ratio)
            compute = partial(_compare_motor, evidence, record, i)
            yield from evidence.memory.recall(setting, signals, compute)


def _compare_motor(evidence: Evidence, record: SlowRecord, i: int) -> list[PredictedSignal]:
    """Comparisons of the signals of motor i, from 1."""
    signals, T, servo = record.channels, record.sample_time, evidence.arm.servo
    angle, velocity, reference = f"theta_m{i}", f"omega_m{i}", signals.get(f"ref{i}")
    motor, sensor, rate = f"torque{i}", f"tau_l{i}", differentiate(signals[f"theta_m{i}"], T)
    compared: list[tuple[str, str, FloatArray, list[FloatArray]]] = []
    if servo is not None and reference is not None and np.ptp(reference) > 0.0:
        is_limited = np.abs(signals.get(f"u{i}", np.zeros(1))) >= 0.999 * servo.limit
        is_servoed = record.experiment.control[i - 1] == "servo"
        if is_servoed and np.mean(is_limited) <= _MAX_SATURATED_SHARE:
            slope = differentiate(reference, T)
            columns = [reference, slope, differentiate(slope, T)]
            compared.append(("reference", angle, rate, columns))
    if velocity in signals:
        compared.append(("velocity", velocity, signals[velocity], [rate]))
    if {motor, sensor} <= set(signals) and not evidence.arm.is_coupled:
        at_link = signals[motor] / evidence.arm.joints[i - 1].gear_ratio
        columns = [at_link, rate, record.direction[:, i - 1], differentiate(rate, T)]
        compared.append(("torque-sensor", sensor, signals[sensor], columns))
    comparisons = []
    for kind, channel, target, columns in compared:
        fit = regress(target[record.inside], np.column_stack(columns)[record.inside])
        if fit is not None:
            values = {kind: fit.coefficient(0)}
            each = PredictedSignal(channel, record.experiment.name, fit.explained, values)
            comparisons.append(each)
    return comparisons


def motor_signals(record: SlowRecord, arm: Arm) -> list[FloatArray]:
    """Angles and inputs of the motors of a record."""
    names = (f"{kind}{i}" for kind in ("theta_m", *EFFORTS) for i in range(1, arm.n_joints + 1))
    return [record.channels[name] for name in names if name in record.channels]


def implied_density(evidence: Evidence) -> float | None:
    """Mass at the reach of an arm that its largest torque implies, over the reach cubed [kg/m^3].

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
    return float(max(masses)) / reach**3 if masses else None


def spread_stretches(records: Sequence[SlowRecord], max_rows: int) -> list[list[slice]]:
    """Stretches of rows of each record, spread evenly over it; one at least per record.

    Whole records if these have no more than `max_rows`.
    """
    n_rows = [len(record.inside) for record in records]
    if sum(n_rows) <= max_rows:
        return [[slice(0, n)] for n in n_rows]
    stretches: list[list[slice]] = []
    for n in n_rows:  # stretches in the centres of equal parts
        count = max(1, int(max_rows / sum(n_rows) * n / _STRETCH_ROWS))
        length = min(_STRETCH_ROWS, n)
        starts = [int((k + 0.5) * n / count - 0.5 * length) for k in range(count)]
        stretches.append([slice(start, start + length) for start in starts])
    return stretches


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
