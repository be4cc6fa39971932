"""Consistency of the link sensors with the motor angles at low frequency.

At low frequency a gear is rigid for any stiffness, and the link angle is n theta_M. Each link
channel therefore has a prediction without unknown parameters, (8) to (10). The regression
coefficient of a channel on its prediction is 1 if the input is consistent. A servo-controlled motor
follows its reference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from strainwave.domain import Correction, FloatArray, Lag, channel_parts
from strainwave.domain.arm.link_sensors import sensor_of
from strainwave.domain.keys import JointIndex, JointNumber
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import (
    JointMotion,
    angle_derivatives,
    channel_weights,
    read_gravity,
    read_link,
    reading_parts,
)
from strainwave.input_check.evidence import Evidence, PredictedSignal, SlowRecord, is_slow
from strainwave.numerics.filters import apply_lags, differentiate, low_pass
from strainwave.numerics.statistics import Regression, regress
from strainwave.signals.channels import sensor_lags

IMU_ACCELEROMETERS = ("ax", "ay", "az")
"""Kinds of channels of the accelerometers of an IMU."""

IMU_CHANNELS = (*IMU_ACCELEROMETERS, "gx", "gy", "gz")
"""Kinds of channels of an IMU."""

LINK_CHANNELS = ("a", "gyro", "theta_l", *IMU_CHANNELS)
"""Kinds of channels that the motor angles predict."""

STANDARD_GRAVITY = 9.80665  # [m/s^2]
# Maximum share of samples at the servo limit; above it, the servo law does not hold.
_MAX_SATURATED_SHARE = 0.01
# Search range of the factor of a joint's rotation, in either direction.
_MAX_ROTATION_FACTOR = 300.0
# Grid points of the rotation search.
_ROTATION_GRID_SIZE = 41
# Grid points of the high-pass search.
_HIGH_PASS_GRID_SIZE = 13
# Largest time constants of a high-pass and of a low-pass in record lengths; a wrong time base can
# give millions.
_MAX_DECAY_RECORDS, _MAX_LAG_RECORDS = 2.0, 0.1
# Maximum unexplained share of the reading with a high-pass.
_MAX_HIGH_PASS_UNEXPLAINED = 0.02
# The same on the first grid, whose steps are up to a factor of two.
_MAX_COARSE_UNEXPLAINED = 0.2
# Maximum ratio of the unexplained shares with and without a high-pass.
_MAX_HIGH_PASS_UNEXPLAINED_RATIO = 0.2
# Time constant in rows below which a low-pass is ignored.
_MIN_TIME_CONSTANT_ROWS = 1e-3
# Minimum significance of the denominator of a rotation ratio, in standard deviations.
_MIN_ROTATION_SIGNIFICANCE = 5.0
# Range of a part of an IMU's reading below which the part is zero, up to rounding.
_MIN_PART = 1e-9
# Prior standard deviation of an unknown tilt or encoder zero [rad].
_TILT_PRIOR_STD = 0.1
# Gear resonance over record bandwidth that sets the prior of the spring coefficient.
_RESONANCE_OVER_BANDWIDTH = 2.0


def regress_readings(evidence: Evidence) -> Iterator[tuple[str, list[PredictedSignal]]]:
    """Regress each link channel on the prediction from the motor angles, channel by channel.

    Uses the slow records that contain the channel. If none do, uses the records that excite the
    joint. Omits records that do not determine the regression.
    """
    slow = {name for r in evidence.records if is_slow(r.experiment) for name in r.channels}
    arm = evidence.arm
    for kind in LINK_CHANNELS:
        for i in range(arm.n_joints):
            name = f"{kind}{i + 1}"
            used = [
                record
                for record in evidence.records
                if name in record.channels
                and (is_slow(record.experiment) or name not in slow)
                and (is_slow(record.experiment) or record.experiment.joint in (None, i + 1))
            ]
            if used:
                readings = (_recall(record, evidence, kind, i) for record in used)
                yield name, [each for each in readings if each is not None]


def _recall(
    record: SlowRecord, evidence: Evidence, kind: str, i: JointIndex
) -> PredictedSignal | None:
    """Regression of a channel of joint i, computed once per hypothesis about its sources.

    A link moves with the motors up to its own, or with all if the motors are coupled.
    """
    arm, name = evidence.arm, f"{kind}{i + 1}"
    n_motors = arm.n_joints if arm.coupling else i + 1
    sources = [record.channels[f"theta_m{j}"] for j in range(1, n_motors + 1)]
    return evidence.cache.recall(
        ("reading", name, record.sample_time, evidence.high_passes.get(name)),
        (arm, record.channels[name], *sources),
        lambda: _regress_channel(record, evidence, recall_motion(record, evidence), kind, i),
    )


def estimate_high_pass_cutoff(evidence: Evidence, name: str) -> float | None:
    """Cutoff of the first-order high-pass that explains an accelerometer reading [Hz].

    Returns None if no cutoff explains the reading substantially better than no high-pass.
    """
    kind, joint = channel_parts(name)
    records = [r for r in evidence.records if name in r.channels and is_slow(r.experiment)]
    if not records:
        return None
    record = max(records, key=lambda r: len(r.inside))

    def unexplained(hz: float) -> float:
        hypothesis = replace(evidence, high_passes={**evidence.high_passes, name: hz})
        reading = _recall(record, hypothesis, kind, joint - 1)
        if reading is None or not 0.5 < reading.values["scale"][0] < 2.0:
            return 1.0
        return 1.0 - reading.explained

    edges = 0.1 / (len(record.inside) * record.sample_time), record.bandwidth_hz
    hz, share = _search(unexplained, *edges, _HIGH_PASS_GRID_SIZE, _MAX_COARSE_UNEXPLAINED)
    least = min(_MAX_HIGH_PASS_UNEXPLAINED, _MAX_HIGH_PASS_UNEXPLAINED_RATIO * unexplained(0.0))
    return float(f"{hz:.4g}") if share <= least else None


def estimate_rotation_factors(evidence: Evidence, joint: int) -> tuple[float, ...]:
    """Estimate the rotation of a link relative to the rotation that the gear ratio implies.

    The readings of a link are not proportional to the motion of its joint, so a grid search finds
    the factor that explains the largest share of a reading. Other gear ratios are kept.
    Returns one factor, or an empty tuple for joint 1 or if no factor explains the reading.
    """
    ratio = evidence.arm.joints[joint - 1].gear_ratio
    slow = [r for r in evidence.records if is_slow(r.experiment)] or list(evidence.records)
    kinds = [k for k in ("theta_l", "gyro", "a") if f"{k}{joint}" in slow[0].channels]
    if joint == 1 or not kinds:
        return ()

    def unexplained(factor: float) -> float:
        change = Correction("joint", str(joint), "gear_ratio", factor * ratio)
        hypothesis = evidence.corrected([change])
        motion = recall_motion(slow[0], hypothesis, is_kept=False)
        reading = _regress_channel(slow[0], hypothesis, motion, kinds[0], joint - 1)
        return 1.0 if reading is None else 1.0 - reading.explained

    edges = 1.0 / _MAX_ROTATION_FACTOR, _MAX_ROTATION_FACTOR
    factor, share = _search(unexplained, *edges, _ROTATION_GRID_SIZE, 1.0)
    return (factor,) if share < 0.5 else ()


def _search(
    unexplained: Callable[[float], float], low: float, high: float, size: int, limit: float
) -> tuple[float, float]:
    """Factor that leaves the least unexplained share, by three logarithmic grids, and that share.

    The first grid can miss a narrow minimum: a share above `limit` ends the search.
    """
    first, last = float(np.log(low)), float(np.log(high))
    for _ in range(3):
        grid = np.linspace(first, last, size)
        shares = [unexplained(float(np.exp(x))) for x in grid]
        k = int(np.argmin(shares))
        if shares[k] > limit:
            break
        first, last = float(grid[max(k - 1, 0)]), float(grid[min(k + 1, size - 1)])
    return float(np.exp(grid[k])), shares[k]


def recall_motion(record: SlowRecord, evidence: Evidence, *, is_kept: bool = True) -> JointMotion:
    """Joint motion of a record from its motor angles, each (n_rows, n_joints), computed once."""
    arm, T = evidence.arm, record.sample_time
    angles = [record.channels[f"theta_m{i + 1}"] for i in range(arm.n_joints)]
    return evidence.cache.recall(
        ("motion", T),
        (arm, *angles),
        lambda: JointMotion.of_motors(np.column_stack(angles), arm, T),
        is_kept=is_kept,
    )


def _predicted_parts(
    arm: Arm, motion: JointMotion, kind: str, i: JointIndex
) -> dict[str, FloatArray] | None:
    """Parts whose sum is the predicted reading of a channel of joint i.

    Returns None if the study does not give the place of the sensor.
    """
    if kind == "theta_l":
        return {"own-joint": motion.angle[:, i]}
    parts = reading_parts(arm, motion, kind, i)
    if parts is None:
        return None
    if kind in IMU_CHANNELS:
        return {key: part for key, part in parts.items() if np.ptp(part) > _MIN_PART} or None
    return {key: part for key, part in parts.items() if key == "own-joint" or np.any(part)}


def _tilt_derivatives(
    arm: Arm, motion: JointMotion, kind: str, i: JointIndex
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Derivatives of a reading of joint i by the tilt of the base and the encoder zeros.

    The tilt of a horizontal arm adds gravity along the axes of the base. The tilt of an arm under
    gravity rotates the known gravity. The zero of an encoder rotates the acceleration of the
    frame's origin. Per radian; those by zeros without that of gravity.
    """
    if kind != "a" or arm.joints[i].motion == "prismatic":
        return [], []
    changes = np.cross(np.eye(3), arm.gravity) if arm.gravity else STANDARD_GRAVITY * np.eye(3)
    tilt = read_gravity(arm, motion.angle, i, changes).T
    zero = angle_derivatives(replace(arm, gravity=None), motion, i).T
    return [x for x in tilt if np.any(x)], [x for x in zero if np.any(x)]


def _regress_channel(
    record: SlowRecord, evidence: Evidence, motion: JointMotion, kind: str, i: JointIndex
) -> PredictedSignal | None:
    """Regress a channel of joint i; None if the record does not determine it."""
    name, arm = f"{kind}{i + 1}", evidence.arm
    T, parts = record.sample_time, _predicted_parts(arm, motion, kind, i)
    if parts is None:
        return None

    def is_relevant(hz: float, max_records: float) -> bool:
        # a time base that is wrong by a factor of 1000 gives other time constants
        rows = 1.0 / (2.0 * np.pi * hz * T)
        return _MIN_TIME_CONSTANT_ROWS < rows < max_records * len(record.inside)

    lags = sensor_lags(sensor_of(arm.joints[i], kind))
    sensor = [lag for lag in lags if is_relevant(lag.cutoff_hz, _MAX_LAG_RECORDS)]
    cutoff = evidence.high_passes.get(name)
    cutoff = cutoff if cutoff and is_relevant(cutoff, _MAX_DECAY_RECORDS) else None

    def smoothed(signal: FloatArray) -> FloatArray:
        # Turns about several axes have harmonics, which the filter removed from the log. In a plane
        # they are small, and a second filter would remove more signal than harmonics.
        return signal if arm.has_planar_program else low_pass(signal, record.bandwidth_hz, T)

    def sensed(part: FloatArray) -> FloatArray:
        part = apply_lags(part, sensor, T)
        return smoothed(part - apply_lags(part, [Lag(1, cutoff)], T) if cutoff else part)

    parts = {key: sensed(part) for key, part in parts.items()}
    target = smoothed(record.channels[name])[record.inside]
    prediction = np.sum(list(parts.values()), axis=0)
    tilt, zero = _tilt_derivatives(arm, motion, kind, i)
    turned = [*map(sensed, tilt + zero)]
    # The initial state of a high-pass is unknown.
    decays = [np.exp(-2.0 * np.pi * cutoff * T * np.arange(len(prediction)))] if cutoff else []
    slope = differentiate(prediction, T)
    since = T * (np.arange(len(prediction)) - np.flatnonzero(record.inside).mean())
    # The link motion is the motor motion plus 1/omega_a^2 times its second derivative. The columns
    # of delay and drift are proportional to the slope of the prediction.
    springs = differentiate(differentiate(prediction - parts.get("gravity", 0.0), T), T)
    top = 2.0 * np.pi * _RESONANCE_OVER_BANDWIDTH * record.bandwidth_hz
    nuisance = [springs, -slope, -since * slope, *decays, *turned]
    free = [np.inf] * (2 + len(decays))
    prior = [top**-2.0, *free, *[_TILT_PRIOR_STD] * len(turned)]

    def fit_of(regressed: list[FloatArray], n: int = len(nuisance)) -> Regression | None:
        columns = np.column_stack([*regressed, *nuisance[:n]])[record.inside]
        return regress(target, columns, np.array([*[np.inf] * len(regressed), *prior[:n]]))

    fit = fit_of([prediction])
    if fit is None:
        return None
    each_part_fit = fit_of(list(parts.values())) if len(parts) > 1 else None
    values = {"scale": fit.coefficient(0), "delay": fit.relative(2), "drift": fit.relative(3)}
    if each_part_fit is not None:
        values |= {key: each_part_fit.coefficient(k) for k, key in enumerate(parts)}
    elif len(parts) > 1:
        values["own-joint"] = values["scale"]
    if rotations := [sensed(part) for part in _rotations(arm, motion, kind, i)]:
        rotations += [part for key, part in parts.items() if key != "own-joint"]
        # without tilt, an actual tilt biases the ratio; its columns absorb errors of springs
        fits = [fit_of(rotations, len(nuisance) - len(turned)), fit_of(rotations)]
        ratios = [each.ratio(_MIN_ROTATION_SIGNIFICANCE) for each in fits if each is not None]
        valid = [each for each in ratios if each is not None]
        if len(valid) == len(fits):
            values["rotation-ratio"] = min(valid, key=lambda r: abs(r[0] - 1.0) / r[1])
    if not arm.gravity and tilt:  # gravity in the plane of motion of a horizontal arm [g]
        of_tilt = slice(4 + len(decays), 4 + len(decays) + len(tilt))
        components, covariance = fit.value[of_tilt], fit.covariance[of_tilt, of_tilt]
        length, variance = float(np.linalg.norm(components)), components @ covariance @ components
        values["tilt"] = length, float(np.sqrt(variance)) / max(length, 1e-12)
    size = float(np.std(target))
    return PredictedSignal(
        channel=name,
        explained=fit.explained,
        values=values,
        seconds=T * len(record.inside),
        signal=size / max(record.noise[name], 1e-12 * size, 1e-300),
        expected_signal=float(np.std(prediction)) / max(record.noise[name], 1e-300),
        size=size / max(float(np.std(prediction)), 1e-300),
    )


def _rotations(arm: Arm, motion: JointMotion, kind: str, i: JointIndex) -> list[FloatArray]:
    """Parts of the rotation in a reading of link i: of its joint, of the joints before.

    Empty if the reading does not contain both.
    """
    weights = channel_weights(arm.joints[i], kind) if kind in ("a", "gyro") else None
    if weights is None or arm.joints[i].motion == "prismatic":
        return []
    of_rotation = weights * (np.arange(len(weights)) >= 3)  # without the specific force
    before = read_link(arm, motion.without(i), i) @ of_rotation
    return [read_link(arm, motion, i) @ of_rotation - before, before] if np.any(before) else []


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
            yield from evidence.cache.recall(setting, signals, compute)


def _compare_motor(evidence: Evidence, record: SlowRecord, i: JointNumber) -> list[PredictedSignal]:
    """Comparisons of the signals of motor i."""
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
            comparisons.append(PredictedSignal(channel, fit.explained, values))
    return comparisons
