"""Consistency of the motor signals: servo references, servo outputs, velocities, torques.

At low frequency, a servo-controlled motor follows its reference, its voltage is the servo output
for the tracking error, and the torques satisfy the equations of rigid joints, (5) to (7), for any
gear stiffness.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from strainwave.domain import BoolArray, FloatArray, channel_parts
from strainwave.domain.keys import Key
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate
from strainwave.signals.consistency.evidence import Evidence, SlowRecord, is_slow
from strainwave.signals.consistency.regression import Comparison, regress
from strainwave.signals.consistency.sensors import recall_motion
from strainwave.signals.drive_law import DriveLaw
from strainwave.signals.link_readings import JointMotion

# Maximum share of samples at the servo limit; above it, the servo law does not hold.
_MAX_SATURATED_SHARE = 0.01
# Minimum magnitude of the mean sign of the motor velocity for a row to count as sliding.
_MIN_MEAN_DIRECTION = 0.8
# Minimum number of sliding rows. With fewer, the regression uses all rows.
_MIN_SLIDING_ROWS = 60
# Search range of the log ratio of the torque constants; 1000 is the largest unit factor.
_MAX_LOG_RATIO = float(np.log(1e3))
# Number of grid points of the ratio search; the spacing is 0.7 %.
_RATIO_GRID_SIZE = 2001
# Torsion moves links by some milliradians, so the torques of a rigid arm are wrong by this share.
_MODEL_ERROR_SHARE = 1e-3
# Rounding error of the eigenvalues of a matrix relative to the largest one.
_EPSILON = float(np.finfo(float).eps)
# Rows of all records that the torques are regressed on: 200 are independent, more than a joint has
# unknowns. Each hypothesis about the input is another regression.
_MAX_ROWS = 2000
# Rows of a stretch of a long record: ten periods of the bandwidth frequency.
_STRETCH_ROWS = 200
# Rows of a chain between two postures at which inertias are evaluated, for their mean.
_POSTURE_STRIDE = 16
# Norm of a column of an equation over that of the largest below which the column is zero.
_MIN_COLUMN_NORM = 1e-12


EFFORTS = ("torque", "u", "tau_l")
"""Kinds of channels of the effort of a joint, of which the first present one is compared."""


@dataclass(frozen=True, slots=True)
class TorqueRegression:
    """Regression of the torque of one joint on its rigid-joint equation, over all slow records."""

    joint: int  # from 1
    inertia: float  # [kg m^2] motor side, coefficient of the joint's own acceleration
    inertia_std: float
    explained: float  # share of the variance of the torque
    base: tuple[Key, ...]  # base parameters in the equation
    value: FloatArray  # (n_base,) their estimates
    covariance: FloatArray  # (n_base, n_base)

    def shared(self, other: TorqueRegression) -> list[int]:
        """Indices of the base parameters that also occur in the equation of another joint."""
        return [k for k, key in enumerate(self.base) if key in other.base]


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


def regress_torques(
    evidence: Evidence, record: SlowRecord | None = None
) -> Iterator[TorqueRegression]:
    """Regress the torque of each joint on the regressor of the rigid-joint equations.

    The joints are regressed separately, so base parameters that couple joints are estimated by
    each of them. Joints without a torque or voltage channel are omitted. A joint is regressed when
    the result is needed, and once for each set of signals. Uses all slow records, or one `record`.
    """
    arm = evidence.arm
    slow = [record] if record else [r for r in evidence.records if is_slow(r.experiment)]
    used = slow or list(evidence.records)
    stretches = spread_stretches(used, _MAX_ROWS)
    angles = [r.channels[f"theta_m{i + 1}"] for r in used for i in range(arm.n_joints)]
    setting = ("torques", *(r.sample_time for r in used), *(r.experiment.joint for r in used))

    @cache
    def equations_of(k: int) -> _Equations:
        return _Equations.of(recall_motion(used[k], evidence), arm, stretches[k])

    for i in range(arm.n_joints):
        chosen = [
            k
            for k, r in enumerate(used)
            if (slow or r.experiment.joint in (None, i + 1)) and effort_channel(r.channels, i + 1)
        ]
        torques = [used[k].channels.get(f"{kind}{i + 1}") for k in chosen for kind in EFFORTS]

        def compute(i: int = i, chosen: Sequence[int] = chosen) -> TorqueRegression | None:
            return _regress_torque([(used[k], equations_of(k)) for k in chosen], arm, i)

        estimate = evidence.memory.recall((*setting, i), (arm, *angles, *torques), compute)
        if estimate is not None:
            yield estimate


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


def _regress_torque(
    records: Sequence[tuple[SlowRecord, _Equations]], arm: Arm, i: int
) -> TorqueRegression | None:
    """Regress the torque of joint i (from 0) over all records, with one constant per record.

    A spring to ground opposes the acceleration of an oscillation, as a wrong sign does. An inertia
    is therefore negative only if it is so with a spring.
    """
    targets, blocks, inertias = [], [], []
    for record, equation in records:
        used = equation.rows
        rows = sliding_rows(record, i)[used]
        if not rows.any():
            continue
        rate = differentiate(record.channels[f"theta_m{i + 1}"], record.sample_time)[used]
        shared = equation.shared_friction[:, i]
        angle = record.channels[f"theta_m{i + 1}"][used]
        parts = equation.regressor[:, i], shared, rate, record.direction[used, i], angle
        torque = compute_motor_torque(record, arm, i)[used][rows]
        block = np.column_stack(parts)[rows]
        targets.append(torque - torque.mean())
        blocks.append(block - block.mean(axis=0))
        inertias.append(equation.inertia[rows[equation.postures], i])
    if not targets:
        return None
    columns = np.concatenate(blocks)
    norms = np.linalg.norm(columns, axis=0)
    with_spring = np.flatnonzero(norms > _MIN_COLUMN_NORM * norms[:-1].max())
    varying = with_spring[with_spring < len(norms) - 1]
    target = np.concatenate(targets)
    fit = regress(target, columns[:, varying], None, _MODEL_ERROR_SHARE)
    if fit is None:
        return None
    base = varying[varying < arm.n_body]
    n = len(base)
    weights = np.concatenate(inertias).mean(axis=0)[base]
    if weights @ fit.value[:n] < 0.0:
        fit = regress(target, columns[:, with_spring], None, _MODEL_ERROR_SHARE) or fit
    return TorqueRegression(
        joint=i + 1,
        inertia=float(weights @ fit.value[:n]),
        inertia_std=float(np.linalg.norm(weights @ fit.root[:n])),
        explained=fit.explained,
        base=tuple(arm.rigid_columns[k].key for k in base),
        value=fit.value[:n],
        covariance=fit.covariance[:n, :n],
    )


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


@dataclass(frozen=True, slots=True)
class _Equations:
    """Rigid-joint equations of all joints in one record, motor side, per base parameter."""

    rows: BoolArray  # (n_record_rows,) rows of the record with equations
    regressor: FloatArray  # (n_rows, n_joints, n_body)
    shared_friction: FloatArray  # (n_rows, n_joints, n_shared) of links that motors share
    inertia: FloatArray  # (n_postures, n_joints, n_body) of the motor's own acceleration
    postures: slice  # of the rows with equations

    @classmethod
    def of(cls, motion: JointMotion, arm: Arm, stretches: Sequence[slice]) -> _Equations:
        """Equations in the rows of `stretches`."""
        rows = np.zeros(len(motion.angle), dtype=bool)
        for stretch in stretches:
            rows[stretch] = True
        q, dq, ddq = (x[rows] for x in (motion.angle, motion.velocity, motion.acceleration))
        postures = slice(None, None, 1 if arm.has_planar_program else _POSTURE_STRIDE)
        angle, rest = q[postures], np.zeros_like(q[postures])
        at_rest = arm.rigid_regressor(angle, rest, rest)
        units = (rest + arm.links_of(unit) for unit in np.eye(arm.n_joints))
        inertia = [arm.rigid_regressor(angle, rest, unit)[:, i] for i, unit in enumerate(units)]
        regressor = arm.rigid_regressor(q, dq, ddq)
        shared = arm.shared_friction_regressor(arm.motor_accelerations(dq))
        return cls(rows, regressor, shared, np.stack(inertia, axis=1) - at_rest, postures)


def estimate_torque_ratios(
    regressions: Sequence[TorqueRegression],
) -> dict[int, tuple[float, float]]:
    """Ratios of the torque-constant error of joint 1 to those of other joints, by joint.

    M(q) is symmetric: base parameters that couple joints occur in the equations of both. If the
    torque constant of joint i is wrong by a factor f_i, the equation of joint i gives estimates x_i
    that are f_i times the true values. The ratio f_1 / f_2 minimises over r

        (x1 - r x2)' (C1 + r^2 C2)^-1 (x1 - r x2)

    The standard deviation is at least abs(r - 1) sqrt(s / (cost(1) - cost(r))), the
    likelihood-ratio value for a ratio of 1, where s is the cost per degree of freedom, at least 1.
    Ratios that the motion does not determine are omitted.
    """
    first = next((each for each in regressions if each.joint == 1), None)
    pairs = [(first, each) for each in regressions if first is not None and each.joint > 1]
    ratios = {second.joint: _torque_ratio(first, second) for first, second in pairs}
    return {joint: ratio for joint, ratio in ratios.items() if ratio is not None}


def _torque_ratio(first: TorqueRegression, second: TorqueRegression) -> tuple[float, float] | None:
    """Ratio of the torque-constant errors of two joints; None if the motion determines none."""
    k1, k2 = first.shared(second), second.shared(first)
    if not k1:
        return None
    x1, x2 = first.value[k1], second.value[k2]
    C1, C2 = first.covariance[np.ix_(k1, k1)], second.covariance[np.ix_(k2, k2)]
    # In the eigenvectors of C2 relative to C1 + C2, both covariances are diagonal.
    size = np.sqrt(np.diag(C1 + C2))
    values, axes = np.linalg.eigh((C1 + C2) / np.outer(size, size))
    white = (axes / np.sqrt(np.maximum(values, _EPSILON * values[-1]))).T / size
    share2, vectors = np.linalg.eigh(white @ C2 @ white.T)
    y1, y2 = (vectors.T @ white @ x for x in (x1, x2))

    def costs_of(ratios: FloatArray) -> FloatArray:
        error = y1 - ratios[:, None] * y2
        return np.asarray((error**2 / (1.0 - share2 + ratios[:, None] ** 2 * share2)).sum(axis=1))

    grid = np.exp(np.linspace(-_MAX_LOG_RATIO, _MAX_LOG_RATIO, _RATIO_GRID_SIZE))
    costs = costs_of(grid)
    best = int(np.argmin(costs))
    if best in (0, len(grid) - 1) or costs[best] + 4.0 > min(costs[0], costs[-1]):
        return None
    # The parabola through the three lowest points gives the minimum and the standard deviation:
    # the distance at which the cost increases by 1.
    step = float(np.log(grid[1] / grid[0]))
    left, middle, right = (float(c) for c in costs[best - 1 : best + 2])
    curvature = max((left - 2.0 * middle + right) / step**2, 1e-12)
    ratio = float(grid[best]) * float(np.exp(0.5 * (left - right) / (step * curvature)))
    excess = max(1.0, middle / max(1, len(k1) - 1))
    std = ratio * float(np.sqrt(2.0 / curvature * excess))
    increase = float(costs_of(np.ones(1))[0]) - middle
    if increase > 1.0:  # The cost is not parabolic far from its minimum.
        std = max(std, abs(ratio - 1.0) * float(np.sqrt(excess / increase)))
    return ratio, std
