"""Linear start of the fit: equations of motion with the servo's law in place of torques.

Divided by the gain of joint 1 where no gain is known, the equations are linear for a given delay:

    Y(q, dq, ddq) pi + d dq + f sgn(dq) + f_0 - kp (ref(t - T) - q) = 0

The delay is that of the least absolute residual, over which samples at the torque limit have little
influence. Where most samples are there, those with the smallest errors are left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import BoolArray, FloatArray
from strainwave.domain.arm.parameter_table import COULOMB, OFFSET
from strainwave.domain.keys import Values
from strainwave.domain.results.estimates import physical_range
from strainwave.identification.position_servo.loop import (
    DELAY,
    KD,
    KP,
    LIMIT,
    SCALE,
    VELOCITY_LAG,
    VISCOUS,
    ServoLoop,
)
from strainwave.identification.position_servo.records import MAX_DELAY, ServoRecord
from strainwave.numerics.filters import differentiate, low_pass, signal_band
from strainwave.numerics.linalg import triangular_factor

_DELAY_STEP = 2e-3  # [s] of the search; the fit converges from half a period of the fastest servo
_MAX_ROWS = 20_000  # of a regression
_SHARES = (1.0, 0.4, 0.15)  # of samples, if a torque limit makes a regression poor
_POOR_COST = 0.2  # residual over position errors, of which a regression usually leaves a tenth
_POOR_RATIO = 2.0  # of residuals of minima, over that of the least
_PASSES = 8  # of the least absolute residual
_LEAST_SHARE = 1e-3  # of the largest residual: smoothing of absolute values
_KD_SHARE = 0.5  # of the servo in the damping, which a start does not know
_LEAST_INERTIA = 1e-2  # of a positive base parameter, over the largest of its unit
_LIMIT_MARGIN = 1.05  # a limit above all torques, where none is reached


@dataclass(frozen=True, slots=True)
class LinearStart:
    """Values that the fit starts from, with the residual of the equations."""

    values: Values
    cost: float  # mean absolute residual


def linear_starts(loop: ServoLoop, records: Sequence[ServoRecord]) -> list[LinearStart]:
    """Starts at the delays of the local minima of the residual, the best first."""
    motions = [_Motion.of(loop, record) for record in records]
    known = [loop.servo.delay_of(i + 1) for i in range(loop.arm.n_joints)]
    grid = np.arange(0.0, MAX_DELAY + 0.5 * _DELAY_STEP, _DELAY_STEP)
    if None not in known:
        grid = grid[:1]
    delays = [[delay if each is None else each for each in known] for delay in grid.tolist()]
    starts = list[LinearStart]()
    for share in _SHARES:
        others = [_solve(loop, motions, each, share) for each in delays]
        starts = min(starts, others, key=_least_cost)
        if _least_cost(starts) < _POOR_COST:
            break
    costs = [start.cost for start in starts]
    padded = [np.inf, *costs, np.inf]
    minima = [k for k, cost in enumerate(costs) if cost <= padded[k] and cost <= padded[k + 2]]
    minima = [k for k in minima if costs[k] < _POOR_RATIO * min(costs)]
    return [starts[k] for k in sorted(minima, key=costs.__getitem__)]


def _least_cost(starts: Sequence[LinearStart]) -> float:
    return min((start.cost for start in starts), default=np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """Filtered motion of a record, with all regressors that do not depend on the delay."""

    record: ServoRecord
    cutoff_hz: float
    kept: slice
    angle: FloatArray  # (n, n_joints), low-passed
    body: FloatArray  # (n, n_joints, n_body) torques of the joints per base parameter
    payload: FloatArray  # (n, n_joints) torques of the payload
    velocity: FloatArray  # (n, n_joints)
    direction: FloatArray  # (n, n_joints)

    @classmethod
    def of(cls, loop: ServoLoop, record: ServoRecord) -> _Motion:
        arm, T = loop.arm, record.sample_time
        cutoff = max(signal_band(angle, T) for angle in record.angle.T)
        edge = int(np.ceil(max(1.0 / (cutoff * T), (MAX_DELAY + 0.01) / T)))
        stride = max(1, len(record.time) // _MAX_ROWS)
        kept = slice(edge, len(record.time) - edge, stride)
        angle = low_pass(record.angle, cutoff, T)
        velocity = differentiate(angle, T)
        motion = [each[kept] for each in (angle, velocity, differentiate(velocity, T))]
        body = arm.rigid_regressor(*motion)
        payload = np.zeros_like(motion[0])
        if record.payload is not None:
            payload = arm.payload_torques(record.payload, *motion)
        ratios = arm.gear_ratios
        noise = np.std(record.angle - angle, axis=0) * cutoff * 2.0 * np.pi
        return cls(
            record,
            cutoff,
            kept,
            motion[0],
            body / ratios[:, None],
            payload / ratios,
            motion[1],
            np.tanh(motion[1] / (noise + 1e-9)),
        )

    def errors(self, loop: ServoLoop, delays: Sequence[float]) -> FloatArray:
        """Low-passed ref(t - T) - q: (n, n_joints)."""
        record = self.record
        late = [
            record.commands(record.time - delay, i, loop.hold, record.sample_time)
            for i, delay in enumerate(delays)
        ]
        passed = low_pass(np.column_stack(late), self.cutoff_hz, record.sample_time)
        return np.asarray(passed[self.kept] - self.angle)


def _solve(
    loop: ServoLoop, motions: Sequence[_Motion], delays: Sequence[float], share: float
) -> LinearStart:
    """Least absolute residual of the equations of a share of the samples, with small errors."""
    arm, n = loop.arm, loop.arm.n_joints
    stated = loop.servo.gain(1)
    gains = _gains(loop, motions, delays, share)
    columns, targets = [], []
    for motion in motions:
        errors = motion.errors(loop, delays)
        for i in range(n):
            friction = np.zeros((len(errors), n, 3))
            friction[:, i, 0], friction[:, i, 1] = motion.velocity[:, i], motion.direction[:, i]
            friction[:, i, 2] = 1.0
            own = [motion.body[:, i], friction.reshape(len(errors), -1), motion.payload[:, i]]
            columns.append(np.column_stack(own) / gains[i])
            targets.append(errors[:, i])
    table, target = np.vstack(columns), np.concatenate(targets)
    kept = np.concatenate([_small(each, share) for each in targets])
    solution, residual = _least_absolute(table[kept], target[kept])
    n_body = len(arm.base.columns)
    values: Values = dict(
        zip((column.key for column in arm.base.columns), solution.tolist(), strict=False)
    )
    for column in arm.base.columns:  # errors of a regression can make an arm that cannot exist
        if physical_range(column.name) != "any":
            alike = [abs(values[c.key]) for c in arm.base.columns if c.unit == column.unit]
            values[column.key] = max(values[column.key], _LEAST_INERTIA * max(alike))
    scale = solution[-1] if table[:, -1].any() else 0.0
    required = np.split(np.abs(table @ solution), np.cumsum([len(t) for t in targets])[:-1])
    for i in range(n):
        ratio = abs(float(arm.gear_ratios[i]))
        damping, coulomb, offset = solution[n_body + 3 * i : n_body + 3 * i + 3].tolist()
        known_kd = loop.servo.damping_gain(i + 1)
        kd = _KD_SHARE * max(damping, 0.0) if known_kd is None else known_kd
        values[KD, i + 1], values[VISCOUS, i + 1] = kd, max(damping - kd, 0.0)
        values[VELOCITY_LAG, i + 1] = 0.5
        values[COULOMB, i + 1] = max(coulomb, 0.0) * ratio
        values[OFFSET, i + 1] = offset * float(arm.gear_ratios[i])
        values[KP, i + 1] = gains[i]
        values[DELAY, i + 1] = delays[i]
        largest = max(float(np.max(each)) for each in required[i::n])
        values[LIMIT, i + 1] = _LIMIT_MARGIN * gains[i] * largest
    if stated is None and scale > 0.0:
        values[SCALE] = 1.0 / scale
    elif stated is not None and len({motion.record.payload for motion in motions}) > 1:
        values[SCALE] = 1.0 / scale if scale > 0.0 else 1.0
    return LinearStart(values, float(np.mean(np.abs(residual)) / np.mean(np.abs(target[kept]))))


def _small(errors: FloatArray, share: float) -> BoolArray:
    """The share of samples with the smallest position errors: these are below a torque limit."""
    return np.asarray(np.abs(errors) <= np.quantile(np.abs(errors), share))


def _gains(
    loop: ServoLoop, motions: Sequence[_Motion], delays: Sequence[float], share: float
) -> list[float]:
    """Gains of the joints [N m/rad], over that of joint 1 where it is not known.

    The equations of each joint have all values over its own gain; those that two joints share have
    the ratio of the gains.
    """
    n_body = len(loop.arm.base.columns)
    stated = [loop.servo.gain(i + 1) for i in range(loop.arm.n_joints)]
    gains = [each or 1.0 for each in stated]
    if None not in stated[1:]:
        return gains
    errors = [motion.errors(loop, delays) for motion in motions]
    own, sizes = [], []
    for i in range(len(gains)):
        rows = [
            np.column_stack([m.body[:, i], m.velocity[:, i], m.direction[:, i], m.payload[:, i]])
            for m in motions
        ]
        table, target = np.vstack(rows), np.concatenate([each[:, i] for each in errors])
        kept = np.concatenate([_small(each[:, i], share) for each in errors])
        solution, _ = _least_absolute(table[kept], target[kept])
        own.append(solution[:n_body])
        sizes.append(np.linalg.norm(table[kept, :n_body], axis=0))
    for i, known in enumerate(stated):
        if i > 0 and known is None:
            first, other = (np.where(sizes[i] > 0.0, sizes[0] * own[k], 0.0) for k in (0, i))
            ratio = float(first @ other) / float(other @ other)
            gains[i] = gains[0] * ratio if ratio > 0.0 else gains[0]
    return gains


def _least_absolute(table: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solution and residual of least absolute values, by reweighting."""
    norms = np.linalg.norm(table, axis=0)
    norms[norms == 0.0] = 1.0
    scaled, weights = table / norms, np.ones(len(target))
    for _ in range(_PASSES):
        factor = triangular_factor(np.column_stack([scaled, target]) * weights[:, None])
        x = np.linalg.lstsq(factor[:, :-1], factor[:, -1])[0]
        residual = target - scaled @ x
        size = np.abs(residual)
        weights = 1.0 / np.sqrt(size + _LEAST_SHARE * (size.max() + np.finfo(float).tiny))
    return x / norms, residual
