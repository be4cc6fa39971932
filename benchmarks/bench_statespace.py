"""Fits of a two-input, two-output model of order 3, on one core.

A joint's motor and link velocity, with coloured and with white noise. The subspace step stands
beside SLICOT's (IB01AD and IB01BD by Cholesky) where its Python package `ctrlsys` is installed; the
other peers are goals.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.timing import Row, best_of
from strainwave.records import FloatArray, InputOutput
from strainwave.statespace import PemOptions, pem
from strainwave.statespace._stack import stack
from strainwave.statespace.subspace import realise

SAMPLE_TIME = 1e-3
HORIZON = 25
ORDER = 3

# Two-inertia arm: states n theta_M - theta_L, dtheta_M, dtheta_L; voltage and interaction torque.
MOTOR_INERTIA, LINK_INERTIA, RATIO, STIFFNESS, DAMPING = 1.5e-4, 3.0, 0.01, 1.6e4, 20.0
GAIN = np.array([[0.0, 1e-3], [0.3, 0.5], [0.001, 0.3]])
NOISE = np.array([0.3, 0.005])  # [rad/s]


def rows() -> list[Row]:
    from threadpoolctl import threadpool_limits

    found = []
    with threadpool_limits(1):
        for samples, goal in ((512, 10e-3), (20_000, 150e-3)):
            for kind, gain in (("coloured", GAIN), ("white", np.zeros_like(GAIN))):
                data = _data(samples, gain)
                name = f"PEM, N = {samples}, {kind} noise"
                found.append(Row(name, _pem(data), "goal", goal))
        white = _data(20_000, np.zeros_like(GAIN))
        time = _pem(white, PemOptions(disturbance="none"))
        found.append(Row("output error, N = 20000, white noise", time, "goal", 150e-3))
        for samples in (512, 20_000):
            found += _subspace(samples)
    return found


def _pem(data: InputOutput, options: PemOptions | None = None) -> float:
    return best_of(lambda: pem(data, ORDER, options=options))


def _subspace(samples: int) -> list[Row]:
    data = stack(_data(samples, GAIN))
    u, y = np.asfortranarray(data.inputs), np.asfortranarray(data.outputs)
    slicot = _slicot(u, y)
    peers = None if slicot is None else best_of(slicot)
    times = [
        best_of(lambda: realise(data, ORDER, "moesp", HORIZON, (False, True))),
        best_of(lambda: realise(data, ORDER, "predictor", HORIZON, (False, True))),
    ]
    return [
        Row(f"subspace step, {way}, N = {samples}", time, "SLICOT, MOESP, Cholesky", peers)
        for way, time in zip(("MOESP", "predictor"), times, strict=True)
    ]


def _slicot(u: FloatArray, y: FloatArray) -> Callable[[], Any] | None:
    try:
        import ctrlsys
    except ImportError:
        return None
    (samples, m), p = u.shape, y.shape[1]

    def run() -> Any:
        R = ctrlsys.ib01ad("M", "C", "N", "O", "N", "N", HORIZON, m, p, u, y, 0.0, -1.0)[1]
        return ctrlsys.ib01bd("M", "A", "K", HORIZON, ORDER, m, p, samples, R, 0.0)

    return run


def _data(samples: int, gain: FloatArray) -> InputOutput:
    from scipy.signal import cont2discrete

    m, mL, n, k, d = MOTOR_INERTIA, LINK_INERTIA, RATIO, STIFFNESS, DAMPING
    plant = np.array(
        [
            [0.0, n, -1.0],
            [-n * k / m, -(2e-4 + n * n * d) / m, n * d / m],
            [k / mL, n * d / mL, -(0.5 + d) / mL],
        ]
    )
    drive = np.array([[0.0, 0.0], [0.08 / m, 0.0], [0.0, 1.0 / mL]])
    C = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    A, B, *_ = cont2discrete((plant, drive, C, np.zeros((2, 2))), SAMPLE_TIME)
    rng = np.random.default_rng(0)
    voltage = 10.0 * np.sign(rng.standard_normal(samples))
    u = np.column_stack([voltage, 10.0 * rng.standard_normal(samples)])
    e = NOISE * rng.standard_normal((samples, 2))
    x, outputs = np.zeros(3), np.empty((samples, 2))
    for t in range(samples):
        outputs[t] = C @ x + e[t]
        x = A @ x + B @ u[t] + gain @ e[t]
    return InputOutput(u, outputs, SAMPLE_TIME)
