"""Linear start of the fit: equations of motion with the servo's law in place of torques.

Divided by the gain of joint 1 where no gain is known, the equations are linear for a given delay:

    Y(q, dq, ddq) pi + d dq + f sgn(dq) + f_0 - kp (ref(t - T) - q) = 0

The delay is that of the least absolute residual, over which samples at the torque limit have little
influence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
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
    """Starts at the delays of all local minima of the residual, the best first."""
    motions = [_Motion.of(loop, record) for record in records]
    known = [loop.servo.delay_of(i + 1) for i in range(loop.arm.n_joints)]
    grid = np.arange(0.0, MAX_DELAY + 0.5 * _DELAY_STEP, _DELAY_STEP)
    if None not in known:
        grid = grid[:1]
    starts = []
    for delay in grid.tolist():
        delays = [delay if each is None else each for each in known]
        starts.append(_solve(loop, motions, delays))
    costs = [start.cost for start in starts]
    padded = [np.inf, *costs, np.inf]
    minima = [k for k, cost in enumerate(costs) if cost <= padded[k] and cost <= padded[k + 2]]
    return [starts[k] for k in sorted(minima, key=costs.__getitem__)]


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


def _solve(loop: ServoLoop, motions: Sequence[_Motion], delays: Sequence[float]) -> LinearStart:
    """Least absolute residual of the equations of all records."""
    arm, n = loop.arm, loop.arm.n_joints
    gains = [loop.servo.gain(i + 1) for i in range(n)]
    reference = gains[0] or 1.0  # torques have this unit
    columns, targets = [], []
    for motion in motions:
        errors = motion.errors(loop, delays)
        for i in range(n):
            friction = np.zeros((len(errors), n, 3))
            friction[:, i, 0], friction[:, i, 1] = motion.velocity[:, i], motion.direction[:, i]
            friction[:, i, 2] = 1.0
            others = np.zeros((len(errors), n))
            if i > 0 and gains[i] is None:
                others[:, i] = -errors[:, i]
            columns.append(
                np.column_stack(
                    [
                        motion.body[:, i],
                        friction.reshape(len(errors), -1),
                        others[:, 1:],
                        motion.payload[:, i],
                    ]
                )
            )
            known = gains[i] if i > 0 else reference
            targets.append((known or 0.0) * errors[:, i])
    table, target = np.vstack(columns), np.concatenate(targets)
    solution, residual = _least_absolute(table, target)
    n_body = len(arm.base.columns)
    values: Values = dict(
        zip((column.key for column in arm.base.columns), solution.tolist(), strict=False)
    )
    for column in arm.base.columns:  # errors of a regression can make an arm that cannot exist
        if physical_range(column.name) != "any":
            alike = [abs(values[c.key]) for c in arm.base.columns if c.unit == column.unit]
            values[column.key] = max(values[column.key], _LEAST_INERTIA * max(alike))
    scale = solution[-1] if table[:, -1].any() else 0.0
    of_motion = np.ones(table.shape[1], dtype=bool)
    of_motion[n_body + 3 * n : -1] = False  # unknown gains times errors
    required = np.abs(table[:, of_motion] @ solution[of_motion])
    torques = np.split(required, np.cumsum([len(t) for t in targets])[:-1])
    for i in range(n):
        ratio = abs(float(arm.gear_ratios[i]))
        damping, coulomb, offset = solution[n_body + 3 * i : n_body + 3 * i + 3].tolist()
        gain = gains[i] or (1.0 if i == 0 else float(solution[n_body + 3 * n + i - 1]))
        known_kd = loop.servo.damping_gain(i + 1)
        kd = _KD_SHARE * max(damping, 0.0) if known_kd is None else known_kd
        values[KD, i + 1], values[VISCOUS, i + 1] = kd, max(damping - kd, 0.0)
        values[VELOCITY_LAG, i + 1] = 0.5
        values[COULOMB, i + 1] = max(coulomb, 0.0) * ratio
        values[OFFSET, i + 1] = offset * float(arm.gear_ratios[i])
        values[KP, i + 1] = gain if gain > 0.0 else 1.0
        values[DELAY, i + 1] = delays[i]
        values[LIMIT, i + 1] = _LIMIT_MARGIN * max(float(np.max(t)) for t in torques[i::n])
    if gains[0] is None and scale > 0.0:
        values[SCALE] = 1.0 / scale
    elif gains[0] is not None and len({motion.record.payload for motion in motions}) > 1:
        values[SCALE] = 1.0 / scale if scale > 0.0 else 1.0
    return LinearStart(values, float(np.mean(np.abs(residual)) / np.mean(np.abs(target))))


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
