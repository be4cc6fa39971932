"""Signals -> linear equations in the rigid model's parameters, filtered and decimated.

Both sides of the equation of motion pass one low-pass filter. Where the motor certainly slides its
friction is viscous * dq + Coulomb * sgn(dq) + offset; where it may stand, the Coulomb part is an
unknown of that stretch. Elastic joints are seen to first order: the link lags the motor by the
gear's torque times its compliance, (1) and (2).
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
"""Share of joint 1's rigid inertia (a single joint's inertia) taken for its motor's.

The two come apart only through the gear's compliance. Designs match them within a factor of a few,
and the compliance, which is fitted, takes up what is wrong with the share.
"""

_ROWS_PER_CUTOFF = 4.0  # rate of the equations in cut-offs; the filter leaves nothing at half of it
# The motion is nonlinear in the equations, so more of it is kept than they pass: up to so many
# cut-offs, at four samples a period of that. The next products, nine cut-offs up, are all but gone.
_MOTION_CUTOFFS, _SAMPLES_PER_ROW = 8.0, 8
# Periods of the cut-off after which a thousandth of the filter's answer is left. Rows nearer to a
# record's ends would depend on where it was cut: free friction has no continuation beyond them.
_REACH = 2.5
_KNOTS_PER_PERIOD = 16.0  # of free friction, in periods of the cut-off: convergence is at 8
_STANDING = 0.58  # deviation of a torque anywhere in [-f, f], in f
_BLOCKS = 20
_LOAD_SHARE = 0.5  # deviation of the prior of friction per load: gears have 0.03 to 0.3
_STIFF = 0.25  # deviation of the prior of (bandwidth / anti-resonance)^2
_NO_INERTIA = 1e-30  # [kg m^2] of a link, for which a trial may take one that is none


@dataclass(frozen=True, slots=True)
class Estimate:
    """Parameters and compliances around which the equations are built."""

    solution: FloatArray  # (n_parameters,)
    compliance: FloatArray  # (n_joints,) [rad/(N m)] link side, not negative
    standing: tuple[
        FloatArray, ...
    ]  # per record (n_motion, n_joints) free friction [N m], or empty
    motor_share: float = MOTOR_SHARE


@dataclass(frozen=True, slots=True)
class Stretch:
    """What of one record's equations does not depend on the parameters."""

    signals: Signals
    bandwidth_hz: float
    motion_step: int  # samples from one of `motion` to the next
    motion: tuple[FloatArray, ...]  # angle, velocity, acceleration: (n_motion, n_joints)
    drive: tuple[FloatArray, ...]  # torque and direction, as the motion; none if no gear gives way
    rows: IntArray  # (n_rows,) samples kept
    keep: BoolArray  # (n_rows, n_joints)
    torque: FloatArray  # (n_rows, n_joints)
    friction: FloatArray  # (n_rows, n_joints, 3) per dq, sgn(dq), 1
    standing: tuple[
        tuple[IntArray, Banded], ...
    ]  # per joint, shapes of free friction as the motion:
    # where in the motion there are any, (n_near,), and them, (n_near, n_free); as the drive
    free: tuple[Banded, ...]  # per joint (n_rows, n_free), those shapes filtered
    noise: FloatArray  # (n_parameters,) deviation of each column's, from the angles'
    period: float  # samples after which the motion repeats; all where it does not

    @property
    def duration(self) -> float:
        """Of the motion, each period of which counts once [s]."""
        return self.period * self.signals.sample_time

    def blocks(self, count: int) -> IntArray:
        """Of each row one of so many equal parts of the period: (n_rows,)."""
        since = self.rows - self.rows[:1]
        step = decimation(self.signals.sample_time, self.bandwidth_hz)
        span = min(self.period, step * len(self.rows))
        # what repeats is left out in all periods at once
        return np.asarray((since % span) * count / span, dtype=np.int64)

    def motion_samples(self) -> IntArray:
        """Samples at which the motion is kept; the equations' rows are among them."""
        first = _reach(self.signals.sample_time, self.bandwidth_hz) % self.motion_step
        return np.arange(first, len(self.signals.time), self.motion_step)

    def filtered(self, signal: FloatArray) -> FloatArray:
        """The equations' filter on a signal at the motion's samples: (n_rows, ...)."""
        step, T = self.motion_step, self.signals.sample_time
        return low_pass(signal, self.bandwidth_hz, T, decimated=step)[self.rows // step]


def decimation(sample_time: float, bandwidth_hz: float) -> int:
    """Samples per equation."""
    step = _motion_step(sample_time, bandwidth_hz)
    return step * max(1, int(1.0 / (_ROWS_PER_CUTOFF * bandwidth_hz * sample_time)) // step)


def _motion_step(sample_time: float, bandwidth_hz: float) -> int:
    """Samples per sample of the motion."""
    per_second = _SAMPLES_PER_ROW * _ROWS_PER_CUTOFF * bandwidth_hz
    return max(1, int(1.0 / (per_second * sample_time)))


def _reach(sample_time: float, bandwidth_hz: float) -> int:
    """Samples between an end of the record and the nearest equation."""
    return int(_REACH / (bandwidth_hz * sample_time))


def prepare(arm: Arm, signals: Signals, bandwidth_hz: float, period: float) -> Stretch:
    """Filter and decimate one record's torque, friction columns and free friction.

    `bandwidth_hz` [Hz].
    `period` [samples]: After which the motion repeats; all where it does not.
    """
    T = signals.sample_time
    n_samples, n_joints = signals.motor_torque.shape
    of_cutoff = 1.0 / (bandwidth_hz * T)  # samples in a period of it
    reach = _reach(T, bandwidth_hz)
    step = _motion_step(T, bandwidth_hz)
    rows = np.arange(reach, n_samples - reach, decimation(T, bandwidth_hz))
    moments = np.arange(reach % step, n_samples, step)  # of the motion
    kernel = _impulse_response(bandwidth_hz, T)
    wider = _impulse_response(_MOTION_CUTOFFS * bandwidth_hz, T)
    elastic = n_compliances(arm) > 0
    keep, standing, free = [], [], []
    for i in range(n_joints):
        keep.append(_clear_of(~signals.valid[:, i], int(of_cutoff / 2))[rows])
        spacing = max(2, round(of_cutoff / _KNOTS_PER_PERIOD))
        shapes = free_friction(signals.direction[:, i], spacing)
        if elastic:
            still = signals.direction[:, i] == 0.0
            near = np.flatnonzero(~_clear_of(still, len(wider))[moments])
            standing.append((near, responses(shapes, moments[near], wider)))
        free.append(responses(shapes, rows, kernel))
    angle, velocity, acceleration, torque, direction = (
        low_pass(x, _MOTION_CUTOFFS * bandwidth_hz, T, kept=slice(reach % step, None, step))
        for x in (
            signals.motor_angle,
            signals.motor_velocity,
            signals.motor_acceleration,
            signals.motor_torque,
            signals.direction,
        )
    )
    sides = np.stack([torque, velocity, direction, np.ones_like(torque)], axis=2)
    # both sides of the equations are cut at the same samples, for what the filter makes of the cuts
    passed = low_pass(sides, bandwidth_hz, T, decimated=step)[rows // step]
    return Stretch(
        signals=signals,
        bandwidth_hz=bandwidth_hz,
        motion_step=step,
        motion=(angle, velocity, acceleration),
        drive=(torque, direction) if elastic else (),
        rows=rows,
        keep=np.column_stack(keep),
        torque=passed[:, :, 0],
        friction=passed[:, :, 1:],
        standing=tuple(standing),
        free=tuple(free),
        noise=_column_noise(arm, signals, bandwidth_hz),
        period=period,
    )


def _impulse_response(cutoff_hz: float, sample_time: float) -> FloatArray:
    """The low-pass's answer to an impulse at its middle, until it has died away."""
    reach = _reach(sample_time, cutoff_hz)
    impulse = np.zeros(2 * reach + 1)
    impulse[reach] = 1.0
    return low_pass(impulse, cutoff_hz, sample_time)


def carried_over(
    estimate: Estimate, before: Sequence[Stretch], after: Sequence[Stretch]
) -> Estimate:
    """An estimate at one bandwidth as the point to start from at another.

    `before, after`: The same records at the two bandwidths.

    Returns: Its free friction interpolated to the motion's samples at the other bandwidth.
    """
    standing = []
    for friction, old, new in zip(estimate.standing, before, after, strict=True):
        here, there = old.motion_samples(), new.motion_samples()
        columns = [np.interp(there, here, column) for column in friction.T if len(column)]
        standing.append(np.column_stack(columns) if columns else friction)
    return replace(estimate, standing=tuple(standing))


@dataclass(frozen=True, slots=True)
class Loads:
    """Joints whose friction may grow with the load, and which way all slide."""

    joints: tuple[int, ...]  # from 0
    direction: tuple[FloatArray, ...]  # per record (n_motion, n_joints)

    @staticmethod
    def of(joints: Sequence[int], stretches: Sequence[Stretch]) -> Loads:
        """Some joints', in the records of a fit.

        `joints`: From 0.
        """
        directions = []
        for one in stretches:
            T, step = one.signals.sample_time, one.motion_step
            kept = slice(_reach(T, one.bandwidth_hz) % step, None, step)
            cutoff = _MOTION_CUTOFFS * one.bandwidth_hz
            directions.append(low_pass(one.signals.direction, cutoff, T, kept=kept))
        return Loads(tuple(joints), tuple(directions))

    def columns(self, arm: Arm, stretch: Stretch, record: int, around: Estimate) -> FloatArray:
        """What friction in proportion to the load is per share: (n_rows, n_joints, n_loads).

        Its size is that of the body's torque as the estimate has it, which the friction itself
        does not enter.
        """
        q, dq, ddq = (x * arm.gear_ratios for x in stretch.motion)
        body = arm.rigid_regressor(q, dq, ddq) @ around.solution[: arm.n_body]
        dry = stretch.filtered(np.abs(body) * self.direction[record])
        own = np.zeros((*dry.shape, len(self.joints)))
        for k, joint in enumerate(self.joints):
            own[:, joint, k] = dry[:, joint]
        return own


def assemble(
    arm: Arm,
    stretches: Sequence[Stretch],
    around: Estimate | None,
    loads: Loads | None = None,
) -> Equations:
    """The equations of all records and joints in one.

    Nuisance unknowns are the compliances of elastic joints, common to all rows, and the free
    friction of each record and joint. Blocks are equal lengths of time, about `_BLOCKS` in all, and
    of a motion that repeats equal parts of its period; both joints share them.

    `around`: None: rigid, free friction as large as the torque, and independent of the load.
    `loads`: Joints whose friction grows with the load: by a share of it, common to all rows as
        well.
    """
    elastic = np.array([joint.elastic for joint in arm.joints])
    n_elastic = n_compliances(arm) if around is not None else 0
    total = sum(s.duration for s in stretches)
    n_shared, n_of_body = len(arm.rigid_columns), arm.n_body
    shared, common, local, target, group, block = [], [], [], [], [], []
    deviation: list[float] = []
    first_block = at = 0
    for record, stretch in enumerate(stretches):
        body, lags, torque = _body_equations(arm, stretch, around, record, elastic)
        n_blocks = max(2, round(_BLOCKS * stretch.duration / total))
        label = first_block + stretch.blocks(n_blocks)
        dry = np.zeros((len(lags), arm.n_joints, 0))
        if loads is not None and around is not None:
            dry = loads.columns(arm, stretch, record, around)
        first_block += n_blocks
        for i, free in enumerate(stretch.free):
            friction = n_of_body + FRICTION_COLUMNS * i
            X = np.zeros((len(stretch.rows), n_shared))
            X[:, :n_of_body] = body[:, i]
            X[:, friction : friction + FRICTION_COLUMNS] = stretch.friction[:, i]
            size = around.solution[friction + 1] if around else np.std(stretch.torque[:, i])
            deviation += [max(_STANDING * abs(float(size)), 1e-300)] * free.n_columns
            keep = np.flatnonzero(stretch.keep[:, i])
            shared.append(X[keep])
            common.append(np.concatenate([lags[keep, i, :n_elastic], dry[keep, i]], axis=1))
            columns = free if len(keep) == len(stretch.rows) else free.rows(keep)
            local.append(Local(at + np.arange(len(keep)), columns))
            at += len(keep)
            target.append(torque[keep, i])
            group.append(np.full(len(keep), i))
            block.append(label[keep])
    noise = np.mean([s.noise**2 for s in stretches], axis=0)
    return Equations(
        shared=np.concatenate(shared),
        noise=np.sqrt(noise),
        common=np.concatenate(common),
        common_deviation=np.concatenate(
            [
                _compliance_deviation(arm, stretches, around) if n_elastic else np.zeros(0),
                np.full(dry.shape[2], _LOAD_SHARE),
            ]
        ),
        local=tuple(local),
        local_deviation=np.array(deviation),
        target=np.concatenate(target),
        group=np.concatenate(group),
        block=np.concatenate(block),
    )


def n_compliances(arm: Arm) -> int:
    """How many compliances all rows may have: one per joint if any gear is elastic."""
    return arm.n_joints if any(joint.elastic for joint in arm.joints) else 0


def estimate_of(
    arm: Arm,
    stretches: Sequence[Stretch],
    equations: Equations,
    factor: Factor,
    motor_share: float = MOTOR_SHARE,
) -> Estimate:
    """What a solve says, as the point around which to build the next equations.

    Compliances are kept between zero and three deviations of their prior, beyond which an arm is
    not nearly rigid and the first order says nothing.
    """
    compliance = np.zeros(arm.n_joints)
    n = n_compliances(arm)
    if n and len(factor.common):
        elastic = np.array([joint.elastic for joint in arm.joints])
        most = 3.0 * equations.common_deviation[:n]
        compliance = np.clip(factor.common[:n], 0.0, most) * elastic
    standing, at = [], 0
    for stretch in stretches:
        friction = np.zeros_like(stretch.motion[0] if stretch.standing else stretch.torque[:0])
        for i, (near, shapes) in enumerate(stretch.standing):
            friction[near, i] = shapes @ factor.local[at : at + shapes.n_columns]
            at += shapes.n_columns
        standing.append(friction)
    return Estimate(factor.value, compliance, tuple(standing), motor_share)


def halfway(one: Estimate, other: Estimate) -> Estimate:
    """The mean of two estimates of the same records.

    Returns: With the other's share of the motor.
    """
    return Estimate(
        0.5 * (one.solution + other.solution),
        0.5 * (one.compliance + other.compliance),
        tuple(0.5 * (a + b) for a, b in zip(one.standing, other.standing, strict=True)),
        other.motor_share,
    )


def anti_resonances(arm: Arm, estimate: Estimate) -> FloatArray:
    """Lowest resonance of each link on its gear, sqrt(1 / (c M_ii)) / 2 pi.

    Returns: (n_joints,) [Hz]: Infinite where the gear is rigid.
    """
    inertia = np.maximum(arm.link_inertias(_base(arm, estimate)), 1e-300)
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / (2.0 * np.pi * np.sqrt(estimate.compliance * inertia)))


def _body_equations(
    arm: Arm, stretch: Stretch, around: Estimate | None, record: int, elastic: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Regressor of the body, regressor of the compliances, and the torque they are to explain."""
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
    # motors turn with the motors' acceleration, not the links'
    motors = arm.motors_of_rigid(around.motor_share)
    for i, k in np.argwhere(motors):
        phi[:, i, k] += motors[i, k] / n[i] * c[i] * ddgear[:, i]
    lags = _mass_times(arm, around, q, ddgear) * elastic
    both = stretch.filtered(np.concatenate([phi, lags], axis=2))
    phi, lags = both[:, :, : phi.shape[2]], both[:, :, phi.shape[2] :]
    return phi, lags, stretch.torque + lags @ c


def _gear_torque(arm: Arm, stretch: Stretch, around: Estimate, standing: FloatArray) -> FloatArray:
    """Torque through each gear, link side: the motor's less friction and its own inertia's.

    Low-passed at twice the equations' bandwidth, for it is to be differentiated twice.
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


def _mass_times(arm: Arm, around: Estimate, angle: FloatArray, ddgear: FloatArray) -> FloatArray:
    """Motor torque per compliance, -n_i M_ij(q) ddT_j: (n_samples, n_joints, n_joints)."""
    torque = arm.torques_of_accelerations(_base(arm, around), angle, ddgear)
    return np.asarray(-arm.gear_ratios[:, None] * torque)


def _base(arm: Arm, around: Estimate) -> FloatArray:
    """The links' base parameters: (n_base,)."""
    return np.asarray(arm.base_of_rigid(around.motor_share) @ around.solution[: arm.n_body])


def _compliance_deviation(
    arm: Arm, stretches: Sequence[Stretch], around: Estimate | None
) -> FloatArray:
    """Prior deviation of the compliances: the anti-resonance lies well above the bandwidth."""
    assert around is not None
    w = 2.0 * np.pi * max(s.bandwidth_hz for s in stretches)
    inertia = np.abs(arm.link_inertias(_base(arm, around)))
    return np.asarray(_STIFF / (np.maximum(inertia, _NO_INERTIA) * w**2))


def _column_noise(arm: Arm, signals: Signals, bandwidth_hz: float) -> FloatArray:
    """Deviation of the noise that the angles' own noise leaves in each column.

    White noise s of an angle, sampled at T and low-passed at f, leaves
    s (2 pi f)^k sqrt(2 f T / (2 k + 1)) in the k-th derivative.
    """
    f, T = bandwidth_hz, signals.sample_time
    n = arm.gear_ratios
    first, second = (
        signals.angle_noise * (2.0 * np.pi * f) ** k * np.sqrt(2.0 * f * T / (2 * k + 1))
        for k in (1, 2)
    )
    angle = signals.motor_angle[:: max(1, len(signals.time) // 200)] * n
    still = np.zeros_like(angle)
    at_standstill = arm.rigid_regressor(angle, still, still)
    power = np.zeros(len(arm.rigid_columns))
    for j in range(arm.n_joints):
        noisy = still.copy()
        noisy[:, j] = n[j] * second[j]
        phi = arm.rigid_regressor(angle, still, noisy) - at_standstill
        power[: arm.n_body] += np.mean(phi**2, axis=(0, 1))
        power[arm.n_body + FRICTION_COLUMNS * j] = first[j] ** 2 / arm.n_joints
    return np.asarray(np.sqrt(power))


def _clear_of(bad: BoolArray, reach: int) -> BoolArray:
    """Samples at least `reach` away from every bad one."""
    return ~running(np.logical_or, bad, 2 * max(1, reach) + 1)
