"""Fits of a two-input, two-output model of order 3, on one core.

A joint's motor and link velocity, with coloured and with white noise. Beside the time stands the
error: of the frequency response from 1 to 100 Hz, root mean square over the frequencies, relative
to the true one. Peers, where they are installed: SLICOT (IB01AD and IB01BD by Cholesky), nfoursid
and SIPPY for the subspace step, jax-sysid for the fit.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.peers.state_space import Matrices, jax_sysid, nfoursid, sippy, slicot
from benchmarks.timing import Row, best_of
from strainwave.domain import FloatArray, InputOutput
from strainwave.statespace import PemOptions, pem, subspace
from strainwave.statespace.subspace import Method

Tool = Callable[[FloatArray, FloatArray, int, int], Matrices]

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
                time, error = _timed(partial(_pem, data))
                name = f"PEM, N = {samples}, {kind} noise"
                found.append(Row(name, time, "goal", goal, ours_error=error))
        for samples in (512, 20_000):
            found += _output_error(samples)
            found += _subspace(samples)
    return found


def _output_error(samples: int) -> list[Row]:
    """White noise, where the simulation error is the best that can be minimised."""
    data = _data(samples, np.zeros_like(GAIN))
    options = PemOptions(disturbance="none")
    time, error = _timed(partial(_pem, data, options))
    return [
        _beside(
            f"output error, N = {samples}, white noise",
            time,
            error,
            "jax-sysid, L-BFGS",
            jax_sysid,
            data,
        )
    ]


def _subspace(samples: int) -> list[Row]:
    """Both of ours against the fastest peer, and the one for closed loops against the others."""
    data = _data(samples, GAIN)
    ways: tuple[Method, ...] = ("moesp", "predictor")
    whats = [f"subspace step, {way}, N = {samples}, coloured noise" for way in ways]
    timed = [_timed(partial(_subspaced, data, way)) for way in ways]
    found = [
        _beside(what, *ours, "SLICOT, MOESP, Cholesky", slicot, data)
        for what, ours in zip(whats, timed, strict=True)
    ]
    for peer, called in ((nfoursid, "nfoursid"), (sippy, "SIPPY, N4SID")):
        found.append(_beside(whats[1], *timed[1], called, peer, data))
    return found


def _pem(data: InputOutput, options: PemOptions | None = None) -> Matrices:
    model = pem(data, ORDER, options=options)
    return model.A, model.B, model.C, model.D


def _subspaced(data: InputOutput, way: Method) -> Matrices:
    model = subspace(data, ORDER, method=way, horizon=HORIZON)
    return model.A, model.B, model.C, model.D


def _beside(
    what: str, ours: float, ours_error: float, peer: str, tool: Tool, data: InputOutput
) -> Row:
    """A row with a peer's time and error; without them where it is not installed."""
    try:
        time, error = _timed(lambda: tool(data.inputs, data.outputs, ORDER, HORIZON))
    except ImportError:
        return Row(what, ours, peer, None, ours_error=ours_error)
    return Row(what, ours, peer, time, ours_error=ours_error, peers_error=error)


def _timed(work: Callable[[], Matrices]) -> tuple[float, float]:
    """Time [s], and relative error of the frequency response."""
    error = response_error(work(), _truth())
    return best_of(work), error


def response_error(found: Matrices, true: Matrices) -> float:
    """Of G(exp(j w T)) over frequencies, each relative to its own size."""
    frequencies = np.geomspace(1.0, 100.0, 200)
    errors = []
    for hz in frequencies:
        z = np.exp(2j * np.pi * hz * SAMPLE_TIME)
        ours, truth = (
            C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D for A, B, C, D in (found, true)
        )
        errors.append(np.linalg.norm(ours - truth) / np.linalg.norm(truth))
    return float(np.sqrt(np.mean(np.square(errors))))


def _truth() -> Matrices:
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
    return A, B, C, np.zeros((2, 2))


def _data(samples: int, gain: FloatArray) -> InputOutput:
    A, B, C, _ = _truth()
    rng = np.random.default_rng(0)
    voltage = 10.0 * np.sign(rng.standard_normal(samples))
    u = np.column_stack([voltage, 10.0 * rng.standard_normal(samples)])
    e = NOISE * rng.standard_normal((samples, 2))
    x, outputs = np.zeros(3), np.empty((samples, 2))
    for t in range(samples):
        outputs[t] = C @ x + e[t]
        x = A @ x + B @ u[t] + gain @ e[t]
    return InputOutput(u, outputs, SAMPLE_TIME)
