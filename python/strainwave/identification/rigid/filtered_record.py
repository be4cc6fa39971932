"""One record, filtered and decimated for the linear equations of the rigid model."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from strainwave.domain import BoolArray, FloatArray, IntArray, Signals
from strainwave.domain.arm.combinations import FRICTION_COLUMNS
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import (
    MAX_STICTION_SHARE,
    body_regressor,
    link_motion,
    torsion_motion,
)
from strainwave.numerics.filters import impulse_response, low_pass
from strainwave.numerics.linalg import Banded
from strainwave.signals.standstill import free_friction, responses, running

Value = TypeVar("Value", np.bool_, np.float64)

_ROWS_PER_CUTOFF = 4.0  # rows per period of the cut-off; the filter prevents aliasing
# The equations are nonlinear in the motion, so the motion keeps a higher bandwidth: 8 cut-offs, at
# four samples per period of that frequency. Products with higher frequencies are negligible.
_MOTION_CUTOFFS, _SAMPLES_PER_ROW = 8.0, 8
# Periods of the cut-off after which the filter response has decayed to 0.1 %. Rows nearer to the
# ends of a record are not used: free friction is not defined beyond the ends.
_EDGE_PERIODS = 2.5
# Share of a record up to which each end is left out. Shorter records of rigid joints are mirrored
# at both ends, because the equations hold in any order of the samples. Those of elastic joints do
# not: the gear torque is differentiated.
_MAX_EDGE_SHARE = 0.1
# Weight of the standstill in a filtered sample from which its friction is unknown. Where most
# samples of a joint are such, the others would not determine its residuals.
_MAX_STICTION_WEIGHT = 0.95
_KNOTS_PER_PERIOD = 16.0  # knots of the free friction per period of the cut-off; 8 suffice
_MAX_MOTION_SAMPLES = 400  # of the motion in the result; exports have the nearest torques at them


@dataclass(frozen=True, slots=True)
class FilteredRecord:
    """Parts of one record's equations that do not depend on the parameters."""

    signals: Signals  # mirrored at the ends if the record is short
    bandwidth_hz: float
    motion_step: int  # samples between successive rows of `motion`
    motion: tuple[FloatArray, ...]  # angle, velocity, acceleration: (n_motion, n_joints)
    drive: tuple[FloatArray, FloatArray]  # torque and direction, as `motion`
    torsion: tuple[FloatArray, ...]  # measured and its derivatives, as `motion`; otherwise empty
    links: tuple[FloatArray, ...]  # motion of the links, as `motion`, without unknown torsions
    body: FloatArray  # (n_rows, n_joints, n_body) regressor of the links if rigid, otherwise empty
    rows: IntArray  # (n_rows,) sample indices
    # (n_equations,) of each equation, joint by joint: joint from 0, and index of its row
    joint: IntArray
    row: IntArray
    torque: FloatArray  # (n_rows, n_joints)
    friction: FloatArray  # (n_rows, n_joints, 3) per dq, sgn(dq), 1
    # per joint, shape functions of the free friction at the motion's samples: indices (n_near,)
    # with nonzero values and the values (n_near, n_free); empty if rigid
    stiction_shapes: tuple[tuple[IntArray, Banded], ...]
    free: tuple[Banded, ...]  # per joint (n_kept, n_free), filtered shape functions
    noise: FloatArray  # (n_parameters,) standard deviation of the noise of each column
    period: float  # [samples] of the motion; the whole record if it does not repeat
    sliding_time: float  # [s] in one period of the motion, the mean of the joints
    slides: BoolArray  # (2, n_joints) whether they slide forward, and backward

    def blocks(self, count: int) -> IntArray:
        """Block number of each row, (n_rows,): one of `count` equal parts of the period."""
        offset = self.rows - self.rows[:1]
        step = decimation(self.signals.sample_time, self.bandwidth_hz)
        span = min(self.period, step * len(self.rows))
        # a block contains the same part of all periods
        return np.asarray((offset % span) * count / span, dtype=np.int64)

    @property
    def repetition(self) -> IntArray:
        """Number of the period of each row, (n_rows,)."""
        return np.asarray((self.rows - self.rows[:1]) // self.period, dtype=np.int64)

    def motion_samples(self) -> IntArray:
        """Sample indices of the motion; they include the rows of the equations."""
        return np.arange(len(self.signals.time))[
            _motion_slice(self.signals.sample_time, self.bandwidth_hz)
        ]

    def filtered(self, signal: FloatArray) -> FloatArray:
        """Apply the equations' filter to a signal at the motion's samples: (n_rows, ...)."""
        step, T = self.motion_step, self.signals.sample_time
        at = self.rows // step
        if not len(at):
            return signal[:0]
        kept = slice(int(at[0]), int(at[-1]) + 1, decimation(T, self.bandwidth_hz) // step)
        return low_pass(signal, self.bandwidth_hz, T, decimated=step, kept=kept)


def count_rows(arm: Arm, signals: Signals, bandwidth_hz: float) -> int:
    """Number of rows of a record, before those without information are left out."""
    T, n = signals.sample_time, len(signals.time)
    edge = _edge_samples(T, bandwidth_hz)
    is_mirrored = not n_compliances(arm) and edge > _MAX_EDGE_SHARE * n
    return max(0, n - 2 * edge * (not is_mirrored)) // decimation(T, bandwidth_hz)


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


def sample_motion(records: Sequence[Signals], bandwidth_hz: float) -> FloatArray:
    """Samples of the motion of records, as in `RigidModel.motion`: as many of each record."""
    parts, count = [], -(-_MAX_MOTION_SAMPLES // len(records))
    for s in records:
        rows = slice(None, None, -(-len(s.time) // count))
        channels = s.motor_angle, s.motor_velocity, s.motor_acceleration
        motion = low_pass(np.stack(channels, axis=1), bandwidth_hz, s.sample_time, kept=rows)
        motion[:, 1] *= s.direction[rows] != 0.0
        parts.append(np.swapaxes(motion, 0, 1))
    return np.concatenate(parts, axis=1)


def _edge_samples(sample_time: float, bandwidth_hz: float) -> int:
    """Number of samples between an end of the record and the nearest equation."""
    return int(_EDGE_PERIODS / (bandwidth_hz * sample_time))


def prepare(arm: Arm, signals: Signals, bandwidth_hz: float, period: float) -> FilteredRecord:
    """Filter and decimate one record's torque, friction columns and free friction.

    `period` [samples] is that of the motion, or the whole record if it does not repeat.
    """
    T = signals.sample_time
    edge = _edge_samples(T, bandwidth_hz)
    elastic = n_compliances(arm) > 0
    if not elastic and edge > _MAX_EDGE_SHARE * len(signals.time):
        signals = _mirror_ends(signals, min(edge, len(signals.time) - 1))
    n_samples, n_joints = signals.motor_torque.shape
    cutoff_period = 1.0 / (bandwidth_hz * T)  # samples per period of the cut-off
    step = _motion_step(T, bandwidth_hz)
    rows = np.arange(edge, n_samples - edge, decimation(T, bandwidth_hz))
    motion_samples = np.arange(n_samples)[_motion_slice(T, bandwidth_hz)]
    kernel, motion_kernel = (
        impulse_response(_edge_samples(T, cutoff), cutoff, T)
        for cutoff in (bandwidth_hz, _MOTION_CUTOFFS * bandwidth_hz)
    )
    keep, stiction_shapes, free = [], [], []
    for i in range(n_joints):
        spacing = max(2, round(cutoff_period / _KNOTS_PER_PERIOD))
        shapes = free_friction(signals.direction[:, i], spacing)
        if elastic:
            at_rest = signals.direction[:, i] == 0.0
            near = np.flatnonzero(~_exclude_neighbours(at_rest, len(motion_kernel))[motion_samples])
            stiction_shapes.append((near, responses(shapes, motion_samples[near], motion_kernel)))
        friction = responses(shapes, rows, kernel)
        informative = _exclude_neighbours(~signals.valid[:, i], int(cutoff_period / 2))[rows]
        if np.mean(signals.direction[:, i] == 0.0) > MAX_STICTION_SHARE:
            informative &= friction.entries.sum(axis=1) < _MAX_STICTION_WEIGHT
        keep.append(informative)
        no_shapes = Banded(0 * rows, np.zeros((len(rows), 0)), 0)
        used = friction if elastic or informative.any() else no_shapes
        free.append(used.rows(informative))
    channels = [
        signals.motor_angle,
        signals.motor_velocity,
        signals.motor_acceleration,
        signals.motor_torque,
        signals.direction,
    ]
    joined = np.empty((n_samples, len(channels) * n_joints))
    columns = itertools.chain.from_iterable(x.T for x in channels)
    for target, column in zip(joined.T, columns, strict=True):
        target[:] = column  # faster than one concatenation of narrow arrays
    filtered = motion_of(joined, bandwidth_hz, T)
    angle, velocity, acceleration, torque, direction = (
        np.ascontiguousarray(x) for x in np.split(filtered, len(channels), axis=1)
    )
    motion = (angle, velocity, acceleration)
    torsion = tuple(motion_of(x, bandwidth_hz, T) for x in torsion_motion(signals))
    links = tuple(link_motion(arm, motion, torsion))
    unfiltered = np.stack([torque, velocity, direction, np.ones_like(torque)], axis=2)
    joint, row = np.nonzero(keep)
    stretch = FilteredRecord(
        signals=signals,
        bandwidth_hz=bandwidth_hz,
        motion_step=step,
        motion=motion,
        drive=(torque, direction),
        torsion=torsion,
        links=links,
        body=np.zeros(0),
        rows=rows,
        joint=joint,
        row=row,
        torque=np.zeros(0),
        friction=np.zeros(0),
        stiction_shapes=tuple(stiction_shapes),
        free=tuple(free),
        noise=_column_noise(arm, signals, bandwidth_hz),
        period=period,
        sliding_time=period * T * float(np.mean(signals.direction != 0.0)),
        slides=np.array([[x.max() > 0.0, x.min() < 0.0] for x in signals.direction.T]).T,
    )
    # one filter for both sides at the same samples, so that edge effects are equal
    filtered = stretch.filtered(unfiltered)
    stretch = replace(stretch, torque=filtered[:, :, 0], friction=filtered[:, :, 1:])
    if elastic:
        return stretch
    body = body_regressor(arm, links, torsion)
    return replace(stretch, body=stretch.filtered(body))


def _mirror_ends(signals: Signals, count: int) -> Signals:
    """Continue a record by `count` samples in reverse order at each end."""

    def mirrored(x: NDArray[Value]) -> NDArray[Value]:
        return np.pad(x, [(count, count), *[(0, 0)] * (x.ndim - 1)], mode="reflect")

    T = signals.sample_time
    return replace(
        signals,
        time=signals.time[0] + T * np.arange(-count, len(signals.time) + count),
        motor_torque=mirrored(signals.motor_torque),
        motor_angle=mirrored(signals.motor_angle),
        motor_velocity=mirrored(signals.motor_velocity),
        motor_acceleration=mirrored(signals.motor_acceleration),
        direction=mirrored(signals.direction),
        valid=mirrored(signals.valid),
        torsion=None if signals.torsion is None else mirrored(signals.torsion),
    )


def n_compliances(arm: Arm) -> int:
    """Number of compliances: one per joint if any gear is elastic, otherwise 0."""
    return arm.n_joints if arm.is_elastic.any() else 0


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
    if arm.n_shared:
        shared = arm.shared_friction_regressor(np.diag(velocity_noise))
        power[-arm.n_shared :] = np.sum(shared**2, axis=(0, 1)) / arm.n_joints
    return np.asarray(np.sqrt(power))


def _exclude_neighbours(bad: BoolArray, reach: int) -> BoolArray:
    """Samples that are at least `reach` away from every bad sample."""
    return ~running(np.logical_or, bad, 2 * max(1, reach) + 1)
