"""Linear equations in the parameters of the rigid model, filtered and decimated.

Both sides of the equation of motion pass through the same low-pass filter. During sliding, friction
is viscous * dq + Coulomb * sgn(dq) + offset; where the motor may be in stiction, the Coulomb torque
is a separate unknown. Elastic joints are modelled to first order: the torsion is the gear torque
times the compliance, (1) and (2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, IntArray, Signals
from strainwave.domain.combinations import FRICTION_COLUMNS
from strainwave.dynamics.arm import Arm
from strainwave.numerics.banded import Banded
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.numerics.least_squares import Equations, Factor, Local
from strainwave.signals.standstill import free_friction, responses, running

MOTOR_SHARE = 0.5
"""Assumed motor share of the rigid inertia of joint 1 (or of a single joint).

Only the gear compliance separates motor and link inertia. Designs match the two within a small
factor, and the fitted compliance compensates for an error of the share.
"""

_ROWS_PER_CUTOFF = 4.0  # rows per period of the cut-off; the filter prevents aliasing
# The equations are nonlinear in the motion, so the motion keeps a higher bandwidth: 8 cut-offs, at
# four samples per period of that frequency. Products with higher frequencies are negligible.
_MOTION_CUTOFFS, _SAMPLES_PER_ROW = 8.0, 8
# Periods of the cut-off after which the filter response has decayed to 0.1 %. Rows nearer to the
# ends of a record are not used: free friction is not defined beyond the ends.
_EDGE_PERIODS = 2.5
_KNOTS_PER_PERIOD = 16.0  # knots of the free friction per period of the cut-off; 8 suffice
# prior standard deviation of the stiction torque in units of f: uniform distribution in [-f, f]
_STICTION_STD = 0.58
_JACKKNIFE_BLOCKS = 20  # blocks of the jackknife over all records
_LOAD_FRICTION_STD = 0.5  # prior standard deviation of the load friction; gears have 0.03 to 0.3
_COMPLIANCE_STD = 0.25  # prior standard deviation of (bandwidth / anti-resonance)^2
_MIN_INERTIA = 1e-30  # [kg m^2] lower bound of a link inertia, which avoids division by zero


@dataclass(frozen=True, slots=True)
class Estimate:
    """Parameters and compliances around which the equations are linearised."""

    solution: FloatArray  # (n_parameters,)
    compliance: FloatArray  # (n_joints,) [rad/(N m)] link side, at least 0
    standing: tuple[
        FloatArray, ...
    ]  # per record (n_motion, n_joints) free friction [N m], or empty
    motor_share: float = MOTOR_SHARE


@dataclass(frozen=True, slots=True)
class Stretch:
    """Parts of one record's equations that do not depend on the parameters."""

    signals: Signals
    bandwidth_hz: float
    motion_step: int  # samples between successive rows of `motion`
    motion: tuple[FloatArray, ...]  # angle, velocity, acceleration: (n_motion, n_joints)
    drive: tuple[FloatArray, ...]  # torque and direction, as `motion`; empty if rigid
    rows: IntArray  # (n_rows,) sample indices
    keep: BoolArray  # (n_rows, n_joints)
    torque: FloatArray  # (n_rows, n_joints)
    friction: FloatArray  # (n_rows, n_joints, 3) per dq, sgn(dq), 1
    standing: tuple[
        tuple[IntArray, Banded], ...
    ]  # per joint, shape functions of the free friction at the motion's samples:
    # indices (n_near,) with nonzero values and the values (n_near, n_free); empty if rigid
    free: tuple[Banded, ...]  # per joint (n_rows, n_free), filtered shape functions
    noise: FloatArray  # (n_parameters,) standard deviation of the noise of each column
    period: float  # [samples] of the motion; the whole record if it does not repeat

    @property
    def duration(self) -> float:
        """Duration [s] of one period of the motion."""
        return self.period * self.signals.sample_time

    def blocks(self, count: int) -> IntArray:
        """Block number of each row, (n_rows,): one of `count` equal parts of the period."""
        offset = self.rows - self.rows[:1]
        step = decimation(self.signals.sample_time, self.bandwidth_hz)
        span = min(self.period, step * len(self.rows))
        # a block contains the same part of all periods
        return np.asarray((offset % span) * count / span, dtype=np.int64)

    def motion_samples(self) -> IntArray:
        """Sample indices of the motion; they include the rows of the equations."""
        start = _edge_samples(self.signals.sample_time, self.bandwidth_hz) % self.motion_step
        return np.arange(start, len(self.signals.time), self.motion_step)

    def filtered(self, signal: FloatArray) -> FloatArray:
        """Apply the equations' filter to a signal at the motion's samples: (n_rows, ...)."""
        step, T = self.motion_step, self.signals.sample_time
        return low_pass(signal, self.bandwidth_hz, T, decimated=step)[self.rows // step]


def decimation(sample_time: float, bandwidth_hz: float) -> int:
    """Number of samples per equation."""
    step = _motion_step(sample_time, bandwidth_hz)
    return step * max(1, int(1.0 / (_ROWS_PER_CUTOFF * bandwidth_hz * sample_time)) // step)


def _motion_step(sample_time: float, bandwidth_hz: float) -> int:
    """Number of samples per sample of the motion."""
    per_second = _SAMPLES_PER_ROW * _ROWS_PER_CUTOFF * bandwidth_hz
    return max(1, int(1.0 / (per_second * sample_time)))


def _edge_samples(sample_time: float, bandwidth_hz: float) -> int:
    """Number of samples between an end of the record and the nearest equation."""
    return int(_EDGE_PERIODS / (bandwidth_hz * sample_time))


def prepare(arm: Arm, signals: Signals, bandwidth_hz: float, period: float) -> Stretch:
    """Filter and decimate one record's torque, friction columns and free friction.

    `period` [samples] is that of the motion, or the whole record if it does not repeat.
    """
    T = signals.sample_time
    n_samples, n_joints = signals.motor_torque.shape
    cutoff_period = 1.0 / (bandwidth_hz * T)  # samples per period of the cut-off
    edge = _edge_samples(T, bandwidth_hz)
    step = _motion_step(T, bandwidth_hz)
    rows = np.arange(edge, n_samples - edge, decimation(T, bandwidth_hz))
    motion_samples = np.arange(edge % step, n_samples, step)  # samples of the motion
    kernel = _impulse_response(bandwidth_hz, T)
    motion_kernel = _impulse_response(_MOTION_CUTOFFS * bandwidth_hz, T)
    elastic = n_compliances(arm) > 0
    keep, standing, free = [], [], []
    for i in range(n_joints):
        keep.append(_exclude_neighbours(~signals.valid[:, i], int(cutoff_period / 2))[rows])
        spacing = max(2, round(cutoff_period / _KNOTS_PER_PERIOD))
        shapes = free_friction(signals.direction[:, i], spacing)
        if elastic:
            at_rest = signals.direction[:, i] == 0.0
            near = np.flatnonzero(~_exclude_neighbours(at_rest, len(motion_kernel))[motion_samples])
            standing.append((near, responses(shapes, motion_samples[near], motion_kernel)))
        free.append(responses(shapes, rows, kernel))
    angle, velocity, acceleration, torque, direction = (
        low_pass(x, _MOTION_CUTOFFS * bandwidth_hz, T, kept=slice(edge % step, None, step))
        for x in (
            signals.motor_angle,
            signals.motor_velocity,
            signals.motor_acceleration,
            signals.motor_torque,
            signals.direction,
        )
    )
    unfiltered = np.stack([torque, velocity, direction, np.ones_like(torque)], axis=2)
    # filter both sides at the same samples, so that edge effects are equal
    filtered = low_pass(unfiltered, bandwidth_hz, T, decimated=step)[rows // step]
    return Stretch(
        signals=signals,
        bandwidth_hz=bandwidth_hz,
        motion_step=step,
        motion=(angle, velocity, acceleration),
        drive=(torque, direction) if elastic else (),
        rows=rows,
        keep=np.column_stack(keep),
        torque=filtered[:, :, 0],
        friction=filtered[:, :, 1:],
        standing=tuple(standing),
        free=tuple(free),
        noise=_column_noise(arm, signals, bandwidth_hz),
        period=period,
    )


def _impulse_response(cutoff_hz: float, sample_time: float) -> FloatArray:
    """Impulse response of the low-pass, centred, until it has decayed."""
    half_length = _edge_samples(sample_time, cutoff_hz)
    impulse = np.zeros(2 * half_length + 1)
    impulse[half_length] = 1.0
    return low_pass(impulse, cutoff_hz, sample_time)


def convert_estimate(
    estimate: Estimate, before: Sequence[Stretch], after: Sequence[Stretch]
) -> Estimate:
    """Convert an estimate at one bandwidth to a starting value at another.

    `before` and `after` are the same records at the two bandwidths. The free friction is
    interpolated to the motion's samples at the other bandwidth.
    """
    stiction_torque = []
    for friction, old, new in zip(estimate.standing, before, after, strict=True):
        old_samples, target_samples = old.motion_samples(), new.motion_samples()
        columns = [
            np.interp(target_samples, old_samples, column) for column in friction.T if len(column)
        ]
        stiction_torque.append(np.column_stack(columns) if columns else friction)
    return replace(estimate, standing=tuple(stiction_torque))


@dataclass(frozen=True, slots=True)
class Loads:
    """Joints whose friction depends on the load, with the direction of motion of all joints."""

    joints: tuple[int, ...]  # from 0
    direction: tuple[FloatArray, ...]  # per record (n_motion, n_joints)

    @staticmethod
    def of(joints: Sequence[int], stretches: Sequence[Stretch]) -> Loads:
        """Loads of `joints` (from 0) in the records of a fit."""
        directions = []
        for stretch in stretches:
            T, step = stretch.signals.sample_time, stretch.motion_step
            motion_rows = slice(_edge_samples(T, stretch.bandwidth_hz) % step, None, step)
            cutoff = _MOTION_CUTOFFS * stretch.bandwidth_hz
            directions.append(low_pass(stretch.signals.direction, cutoff, T, kept=motion_rows))
        return Loads(tuple(joints), tuple(directions))

    def columns(self, arm: Arm, stretch: Stretch, record: int, around: Estimate) -> FloatArray:
        """Regressor of the load friction, (n_rows, n_joints, n_loads).

        The load is the body torque of the estimate, without friction.
        """
        q, dq, ddq = (x * arm.gear_ratios for x in stretch.motion)
        body = arm.rigid_regressor(q, dq, ddq) @ around.solution[: arm.n_body]
        friction = stretch.filtered(np.abs(body) * self.direction[record])
        columns = np.zeros((*friction.shape, len(self.joints)))
        for k, joint in enumerate(self.joints):
            columns[:, joint, k] = friction[:, joint]
        return columns


def assemble(
    arm: Arm,
    stretches: Sequence[Stretch],
    around: Estimate | None,
    loads: Loads | None = None,
) -> Equations:
    """Assemble the equations of all records and joints.

    Nuisance parameters are the compliances of elastic joints, common to all rows, and the free
    friction of each record and joint. Blocks are equal intervals of time, about 20 in all, and
    equal parts of the period of a repeated motion; both joints share them.

    Without `around`, the joints are rigid, the prior of the free friction is the size of the
    torque, and friction does not depend on the load. `loads` adds one share of the load per joint,
    common to all rows.
    """
    elastic = np.array([joint.elastic for joint in arm.joints])
    n_elastic = n_compliances(arm) if around is not None else 0
    total = sum(s.duration for s in stretches)
    n_shared, n_of_body = len(arm.rigid_columns), arm.n_body
    shared, common, local, target, group, block = [], [], [], [], [], []
    free_friction_std: list[float] = []
    first_block = n_before = 0
    for record, stretch in enumerate(stretches):
        body, lags, torque = _body_equations(arm, stretch, around, record, elastic)
        n_blocks = max(2, round(_JACKKNIFE_BLOCKS * stretch.duration / total))
        block_of_row = first_block + stretch.blocks(n_blocks)
        load_columns = np.zeros((len(lags), arm.n_joints, 0))
        if loads is not None and around is not None:
            load_columns = loads.columns(arm, stretch, record, around)
        first_block += n_blocks
        for i, free in enumerate(stretch.free):
            friction = n_of_body + FRICTION_COLUMNS * i
            X = np.zeros((len(stretch.rows), n_shared))
            X[:, :n_of_body] = body[:, i]
            X[:, friction : friction + FRICTION_COLUMNS] = stretch.friction[:, i]
            coulomb = around.solution[friction + 1] if around else np.std(stretch.torque[:, i])
            free_friction_std += [max(_STICTION_STD * abs(float(coulomb)), 1e-300)] * free.n_columns
            keep = np.flatnonzero(stretch.keep[:, i])
            shared.append(X[keep])
            common.append(
                np.concatenate([lags[keep, i, :n_elastic], load_columns[keep, i]], axis=1)
            )
            columns = free if len(keep) == len(stretch.rows) else free.rows(keep)
            local.append(Local(n_before + np.arange(len(keep)), columns))
            n_before += len(keep)
            target.append(torque[keep, i])
            group.append(np.full(len(keep), i))
            block.append(block_of_row[keep])
    noise = np.mean([s.noise**2 for s in stretches], axis=0)
    return Equations(
        shared=np.concatenate(shared),
        noise=np.sqrt(noise),
        common=np.concatenate(common),
        common_deviation=np.concatenate(
            [
                _compliance_std(arm, stretches, around) if n_elastic else np.zeros(0),
                np.full(load_columns.shape[2], _LOAD_FRICTION_STD),
            ]
        ),
        local=tuple(local),
        local_deviation=np.array(free_friction_std),
        target=np.concatenate(target),
        group=np.concatenate(group),
        block=np.concatenate(block),
    )


def n_compliances(arm: Arm) -> int:
    """Number of compliances: one per joint if any gear is elastic, otherwise 0."""
    return arm.n_joints if any(joint.elastic for joint in arm.joints) else 0


def estimate_of(
    arm: Arm,
    stretches: Sequence[Stretch],
    equations: Equations,
    factor: Factor,
    motor_share: float = MOTOR_SHARE,
) -> Estimate:
    """Estimate from a solution, around which the next equations are linearised.

    Compliances are limited to between zero and three standard deviations of their prior. Above that
    the first-order model is not valid.
    """
    compliance = np.zeros(arm.n_joints)
    n = n_compliances(arm)
    if n and len(factor.common):
        elastic = np.array([joint.elastic for joint in arm.joints])
        upper_bound = 3.0 * equations.common_deviation[:n]
        compliance = np.clip(factor.common[:n], 0.0, upper_bound) * elastic
    stiction_torque, start = [], 0
    for stretch in stretches:
        friction = np.zeros_like(stretch.motion[0] if stretch.standing else stretch.torque[:0])
        for i, (near, shapes) in enumerate(stretch.standing):
            friction[near, i] = shapes @ factor.local[start : start + shapes.n_columns]
            start += shapes.n_columns
        stiction_torque.append(friction)
    return Estimate(factor.value, compliance, tuple(stiction_torque), motor_share)


def average_estimates(one: Estimate, other: Estimate) -> Estimate:
    """Mean of two estimates of the same records, with the motor share of `other`."""
    return Estimate(
        0.5 * (one.solution + other.solution),
        0.5 * (one.compliance + other.compliance),
        tuple(0.5 * (a + b) for a, b in zip(one.standing, other.standing, strict=True)),
        other.motor_share,
    )


def anti_resonances(arm: Arm, estimate: Estimate) -> FloatArray:
    """Anti-resonance of each link on its gear, sqrt(1 / (c M_ii)) / 2 pi, (n_joints,) [Hz].

    Infinite if the gear is rigid.
    """
    inertia = np.maximum(arm.link_inertias(_base(arm, estimate)), 1e-300)
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / (2.0 * np.pi * np.sqrt(estimate.compliance * inertia)))


def _body_equations(
    arm: Arm, stretch: Stretch, around: Estimate | None, record: int, elastic: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Regressor of the body, regressor of the compliances, and the torque (right-hand side)."""
    n = arm.gear_ratios
    q, dq, ddq = (x * n for x in stretch.motion)
    if around is None or not elastic.any():
        phi = stretch.filtered(arm.rigid_regressor(q, dq, ddq))
        return phi, np.zeros((len(phi), arm.n_joints, 0)), stretch.torque
    gear = _gear_torque(arm, stretch, around, around.standing[record])
    interval = stretch.motion_step * stretch.signals.sample_time
    dgear = differentiate(gear, interval)
    ddgear = differentiate(dgear, interval)
    c = around.compliance
    phi = arm.rigid_regressor(q - c * gear, dq - c * dgear, ddq - c * ddgear)
    # motor inertia acts on the motor acceleration, not the link acceleration
    motors = arm.motors_of_rigid(around.motor_share)
    for i, k in np.argwhere(motors):
        phi[:, i, k] += motors[i, k] / n[i] * c[i] * ddgear[:, i]
    lags = _compliance_regressor(arm, around, q, ddgear) * elastic
    filtered = stretch.filtered(np.concatenate([phi, lags], axis=2))
    phi, lags = filtered[:, :, : phi.shape[2]], filtered[:, :, phi.shape[2] :]
    return phi, lags, stretch.torque + lags @ c


def _gear_torque(arm: Arm, stretch: Stretch, around: Estimate, standing: FloatArray) -> FloatArray:
    """Torque through each gear, link side: motor torque minus friction and motor inertia.

    Low-passed at twice the bandwidth of the equations, because it is differentiated twice.
    """
    n = arm.gear_ratios
    (_, velocity, acceleration), (torque, direction) = stretch.motion, stretch.drive
    solution = around.solution
    viscous, coulomb, offset = solution[arm.n_body :].reshape(-1, FRICTION_COLUMNS).T
    friction = viscous * velocity + coulomb * direction + offset + standing
    inertia = arm.motors_of_rigid(around.motor_share) @ solution[: arm.n_body]
    net = (torque - friction - inertia * acceleration) / n
    T, step = stretch.signals.sample_time, stretch.motion_step
    return low_pass(net, 2.0 * stretch.bandwidth_hz, T, decimated=step)


def _compliance_regressor(
    arm: Arm, around: Estimate, angle: FloatArray, ddgear: FloatArray
) -> FloatArray:
    """Motor torque per compliance, -n_i M_ij(q) ddT_j: (n_samples, n_joints, n_joints)."""
    torque = arm.torques_of_accelerations(_base(arm, around), angle, ddgear)
    return np.asarray(-arm.gear_ratios[:, None] * torque)


def _base(arm: Arm, around: Estimate) -> FloatArray:
    """Base parameters of the links, (n_base,)."""
    return np.asarray(arm.links_of_rigid(around.motor_share) @ around.solution[: arm.n_body])


def _compliance_std(arm: Arm, stretches: Sequence[Stretch], around: Estimate | None) -> FloatArray:
    """Prior standard deviation of the compliances: anti-resonances exceed the bandwidth."""
    assert around is not None
    w = 2.0 * np.pi * max(s.bandwidth_hz for s in stretches)
    inertia = np.abs(arm.link_inertias(_base(arm, around)))
    return np.asarray(_COMPLIANCE_STD / (np.maximum(inertia, _MIN_INERTIA) * w**2))


def _column_noise(arm: Arm, signals: Signals, bandwidth_hz: float) -> FloatArray:
    """Standard deviation of the noise in each column, from the noise of the angles.

    White angle noise s, sampled at T and low-passed at f, has the standard deviation s (2 pi f)^k
    sqrt(2 f T / (2 k + 1)) in the k-th derivative.
    """
    f, T = bandwidth_hz, signals.sample_time
    n = arm.gear_ratios
    velocity_noise, acceleration_noise = (
        signals.angle_noise * (2.0 * np.pi * f) ** k * np.sqrt(2.0 * f * T / (2 * k + 1))
        for k in (1, 2)
    )
    angle = signals.motor_angle[:: max(1, len(signals.time) // 200)] * n
    zero = np.zeros_like(angle)
    static = arm.rigid_regressor(angle, zero, zero)
    power = np.zeros(len(arm.rigid_columns))
    for j in range(arm.n_joints):
        acceleration = zero.copy()
        acceleration[:, j] = n[j] * acceleration_noise[j]
        phi = arm.rigid_regressor(angle, zero, acceleration) - static
        power[: arm.n_body] += np.mean(phi**2, axis=(0, 1))
        power[arm.n_body + FRICTION_COLUMNS * j] = velocity_noise[j] ** 2 / arm.n_joints
    return np.asarray(np.sqrt(power))


def _exclude_neighbours(bad: BoolArray, reach: int) -> BoolArray:
    """Samples that are at least `reach` away from every bad sample."""
    return ~running(np.logical_or, bad, 2 * max(1, reach) + 1)
