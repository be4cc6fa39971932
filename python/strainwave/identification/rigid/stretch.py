"""One record, filtered and decimated for the linear equations of the rigid model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import BoolArray, FloatArray, IntArray, Signals
from strainwave.domain.combinations import FRICTION_COLUMNS
from strainwave.dynamics.arm import Arm
from strainwave.numerics.banded import Banded
from strainwave.numerics.filters import low_pass
from strainwave.signals.standstill import free_friction, responses, running

_ROWS_PER_CUTOFF = 4.0  # rows per period of the cut-off; the filter prevents aliasing
# The equations are nonlinear in the motion, so the motion keeps a higher bandwidth: 8 cut-offs, at
# four samples per period of that frequency. Products with higher frequencies are negligible.
_MOTION_CUTOFFS, _SAMPLES_PER_ROW = 8.0, 8
# Periods of the cut-off after which the filter response has decayed to 0.1 %. Rows nearer to the
# ends of a record are not used: free friction is not defined beyond the ends.
_EDGE_PERIODS = 2.5
_KNOTS_PER_PERIOD = 16.0  # knots of the free friction per period of the cut-off; 8 suffice


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
    # per joint, shape functions of the free friction at the motion's samples: indices (n_near,)
    # with nonzero values and the values (n_near, n_free); empty if rigid
    standing: tuple[tuple[IntArray, Banded], ...]
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
        return np.arange(len(self.signals.time))[
            _motion_slice(self.signals.sample_time, self.bandwidth_hz)
        ]

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


def _motion_slice(sample_time: float, bandwidth_hz: float) -> slice:
    """Samples of the motion among those of the record."""
    step = _motion_step(sample_time, bandwidth_hz)
    return slice(_edge_samples(sample_time, bandwidth_hz) % step, None, step)


def motion_of(signal: FloatArray, bandwidth_hz: float, sample_time: float) -> FloatArray:
    """Low-pass a signal (n_samples, ...) at the motion's samples: (n_motion, ...)."""
    kept = _motion_slice(sample_time, bandwidth_hz)
    return low_pass(signal, _MOTION_CUTOFFS * bandwidth_hz, sample_time, kept=kept)


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
    motion_samples = np.arange(n_samples)[_motion_slice(T, bandwidth_hz)]
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
        motion_of(x, bandwidth_hz, T)
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


def n_compliances(arm: Arm) -> int:
    """Number of compliances: one per joint if any gear is elastic, otherwise 0."""
    return arm.n_joints if any(joint.elastic for joint in arm.joints) else 0


def _column_noise(arm: Arm, signals: Signals, bandwidth_hz: float) -> FloatArray:
    """Standard deviation of the noise in each column, from the noise of the angles.

    White angle noise s, sampled at T and low-passed at f, has the standard deviation s (2 pi f)^k
    sqrt(2 f T / (2 k + 1)) in the k-th derivative.
    """
    f, T = bandwidth_hz, signals.sample_time
    velocity_noise, acceleration_noise = (
        signals.angle_noise * (2.0 * np.pi * f) ** k * np.sqrt(2.0 * f * T / (2 * k + 1))
        for k in (1, 2)
    )
    angle = arm.links_of(signals.motor_angle[:: max(1, len(signals.time) // 200)])
    zero = np.zeros_like(angle)
    static = arm.rigid_regressor(angle, zero, zero)
    power = np.zeros(len(arm.rigid_columns))
    for j in range(arm.n_joints):
        motors = zero.copy()
        motors[:, j] = acceleration_noise[j]
        phi = arm.rigid_regressor(angle, zero, arm.links_of(motors)) - static
        power[: arm.n_body] += np.mean(phi**2, axis=(0, 1))
        power[arm.n_body + FRICTION_COLUMNS * j] = velocity_noise[j] ** 2 / arm.n_joints
    return np.asarray(np.sqrt(power))


def _exclude_neighbours(bad: BoolArray, reach: int) -> BoolArray:
    """Samples that are at least `reach` away from every bad sample."""
    return ~running(np.logical_or, bad, 2 * max(1, reach) + 1)
