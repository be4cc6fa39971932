"""A sample of the stream of a load on a chain of seven joints, and the same work in NumPy.

The limit of a loop is 50 us. Samples at which rows of the equations are due are the slowest.
NumPy has the compiled regressor, array operations for filters and columns, and a QR decomposition
for the rows.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from benchmarks.studies.drawn_chains import draw_chain
from benchmarks.timing import Row
from strainwave.domain import FloatArray, RigidModel
from strainwave.dynamics.arm import Arm
from strainwave.identification.payload import ArmPrior
from strainwave.identification.payload_stream import LoadStream

_SEED = 5  # of a chain with seven joints
_SAMPLE_TIME, _BANDWIDTH_HZ = 1e-3, 8.0
_ROWS_EVERY = int(1.0 / (4.0 * _BANDWIDTH_HZ * _SAMPLE_TIME))
_SAMPLES, _SETTLED = 100 * _ROWS_EVERY, 10  # of which the first periods have no rows
_POLES_HZ = 64.0, _BANDWIDTH_HZ / 0.435  # of the motion and of the equations


def rows() -> list[Row]:
    arm, stream, angle, torque = _stream()
    own = _sample_times(stream, angle, torque)
    peer = _sample_times(_NumPyStream(arm), angle, torque)
    return [
        Row("a sample of 7 joints, mean", float(own.mean()), "NumPy", float(peer.mean())),
        Row("the slowest sample", float(own.max()), "NumPy", float(peer.max())),
    ]


def _sample_times(
    stream: LoadStream | _NumPyStream, angle: FloatArray, torque: FloatArray
) -> FloatArray:
    """Shortest time of each sample of a period of the rows over many periods: (n_samples,)."""
    times = []
    for q, tau in zip(angle, torque, strict=True):
        begin = time.perf_counter()
        stream.update(q, tau)
        times.append(time.perf_counter() - begin)
    periods = np.array(times).reshape(-1, _ROWS_EVERY)[_SETTLED:]
    return np.asarray(periods.min(axis=0))


def _stream() -> tuple[Arm, LoadStream, FloatArray, FloatArray]:
    """An arm with known parameters, its stream, and a motion."""
    chain = draw_chain(_SEED)
    described = chain.study.arm
    joints = [replace(j, spring="rigid", torque_per_volt=None) for j in described.joints]
    arm = Arm.of(described.with_joints(joints))
    at = _SAMPLE_TIME * np.arange(_SAMPLES)[:, None]
    rates = 2.0 * np.pi * (0.5 + 0.1 * np.arange(arm.n_joints))
    q: FloatArray = np.sin(rates * at)
    dq = np.asarray(rates * np.cos(rates * at), dtype=np.float64)
    ddq = np.asarray(-(rates**2) * q, dtype=np.float64)
    motion = [arm.motor_accelerations(x) for x in (q, dq, ddq)]
    values = {k: v for k, v in chain.values.items() if not k[0].startswith("gear_")}
    torque = arm.inverse_dynamics(arm.parameter_vector(values), q, dq, ddq)
    n = len(arm.rigid_columns)
    solution, covariance = np.ones(n), 1e-4 * np.eye(n)
    zeros, shares = np.zeros(arm.n_joints), np.full(arm.n_joints, 0.5)
    known = np.ones(n, dtype=bool)
    prior = ArmPrior(solution, covariance, known, zeros, zeros, shares, _BANDWIDTH_HZ)
    model = RigidModel(
        parameters=(),
        solution=solution,
        covariance=covariance,
        condition_number=1.0,
        fit_percent={},
        bandwidth_hz=_BANDWIDTH_HZ,
        decimation=1,
        n_rows=0,
        status="determined",
        motion=np.stack(motion),
    )
    stream = LoadStream(arm, prior, model, sample_time=_SAMPLE_TIME)
    return arm, stream, motion[0], torque


class _LowPass:
    """Four equal poles by the bilinear transform."""

    def __init__(self, poles_hz: float, signals: int) -> None:
        self.pole = 2.0 * np.pi * poles_hz
        x = 0.5 * self.pole * _SAMPLE_TIME
        self.keep, self.take = (1.0 - x) / (1.0 + x), x / (1.0 + x)
        self.stages = np.zeros((5, signals))

    def update(self, signals: FloatArray) -> None:
        for k in range(4):
            after = self.keep * self.stages[k + 1] + self.take * (signals + self.stages[k])
            self.stages[k], signals = signals, after
        self.stages[4] = signals


class _NumPyStream:
    """Filters, columns, factor and products as in the core."""

    def __init__(self, arm: Arm) -> None:
        self.arm, n = arm, arm.n_joints
        self.columns = len(arm.base_names) + 1 + 3 + 10 + 1
        self.motion = _LowPass(_POLES_HZ[0], 2 * n)
        self.equations = _LowPass(_POLES_HZ[1], n * self.columns)
        self.factor = np.zeros((3 * n + 11, 3 * n + 11))
        self.products = np.zeros((3 * n + 10, len(arm.base_names) + n))
        self.base = np.ones(len(arm.base_names))
        self.samples = 0

    def update(self, angle: FloatArray, torque: FloatArray) -> None:
        arm, n, w = self.arm, self.arm.n_joints, self.motion.pole
        self.motion.update(np.concatenate([angle, torque]))
        *_, second, third, last = self.motion.stages
        slope = w * (third - last)
        curvature = w * (w * (second - third) - slope)
        links = (arm.links_of(x[None, :n]) for x in (last, slope, curvature))
        body = arm.base_regressor(*links)[0] * arm.gear_ratios[:, None]
        X = np.empty((n, self.columns))
        X[:, :-15] = body
        X[:, -15] = curvature[:n]
        X[:, -14:-11] = np.column_stack([slope[:n], np.clip(slope[:n], -1.0, 1.0), np.ones(n)])
        X[:, -11:-1] = body[:, -10:]
        X[:, -1] = last[n:] - body @ self.base
        self.equations.update(X.ravel())
        self.samples += 1
        if self.samples % _ROWS_EVERY == 0:
            self._append(self.equations.stages[4].reshape(n, -1))

    def _append(self, filtered: FloatArray) -> None:
        n = self.arm.n_joints
        wide = np.zeros((n, 3 * n + 11))
        for i in range(n):
            wide[i, 3 * i : 3 * i + 3] = filtered[i, -14:-11]
        wide[:, 3 * n :] = filtered[:, -11:]
        of_arm = np.concatenate([filtered[:, :-15], np.diag(filtered[:, -15])], axis=1)
        self.products += wide[:, :-1].T @ of_arm
        _, self.factor = np.linalg.qr(np.concatenate([self.factor, wide]))
