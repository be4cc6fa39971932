"""Fits of a two-input, two-output model of order 3, on one core.

The outputs are motor and link velocity of a joint, with coloured and with white noise. The error is
the relative error of the frequency response from 1 to 100 Hz, root mean square over frequencies.
Peers, if installed: SLICOT (IB01AD and IB01BD by Cholesky, also with IB01CD), nfoursid and SIPPY
for the subspace estimate, jax-sysid for the fit.
"""

from __future__ import annotations

import contextlib
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

    with contextlib.suppress(ImportError):  # the limit holds for libraries that are loaded
        import ctrlsys  # noqa: F401
    table = []
    with threadpool_limits(1):
        for samples, goal in ((512, 10e-3), (20_000, 150e-3)):
            for kind, gain in (("coloured", GAIN), ("white", np.zeros_like(GAIN))):
                data = _data(samples, gain)
                time, error = _measure(partial(_fit_pem, data))
                name = f"PEM, N = {samples}, {kind} noise"
                table.append(Row(name, time, "goal", goal, error=error))
        for samples in (512, 20_000):
            table += _output_error(samples)
            table += _subspace(samples)
    return table


def _output_error(samples: int) -> list[Row]:
    """White noise, for which output error is the maximum-likelihood method."""
    data = _data(samples, np.zeros_like(GAIN))
    options = PemOptions(disturbance="none")
    time, error = _measure(partial(_fit_pem, data, options))
    return [
        _compare(
            f"output error, N = {samples}, white noise",
            time,
            error,
            "jax-sysid, L-BFGS",
            jax_sysid,
            data,
        )
    ]


def _subspace(samples: int) -> list[Row]:
    """Both methods against the fastest peer, and the closed-loop one against the others."""
    data = _data(samples, GAIN)
    methods: tuple[Method, ...] = ("moesp", "predictor")
    names = [f"subspace step, {method}, N = {samples}, coloured noise" for method in methods]
    timings = [_measure(partial(_fit_subspace, data, method)) for method in methods]
    table = [
        _compare(name, *timing, "SLICOT, MOESP, Cholesky", slicot, data)
        for name, timing in zip(names, timings, strict=True)
    ]
    least_squares: Tool = partial(slicot, all_samples=True)
    for peer, peer_name in (
        (least_squares, "SLICOT, B by least squares"),
        (nfoursid, "nfoursid"),
        (sippy, "SIPPY, N4SID"),
    ):
        table.append(_compare(names[1], *timings[1], peer_name, peer, data))
    return table


def _fit_pem(data: InputOutput, options: PemOptions | None = None) -> Matrices:
    model = pem(data, ORDER, options=options)
    return model.A, model.B, model.C, model.D


def _fit_subspace(data: InputOutput, method: Method) -> Matrices:
    model = subspace(data, ORDER, method=method, horizon=HORIZON)
    return model.A, model.B, model.C, model.D


def _compare(task: str, time: float, error: float, peer: str, tool: Tool, data: InputOutput) -> Row:
    """Compare with a peer; its time and error are missing if it is not installed."""
    try:
        peer_time, peer_error = _measure(lambda: tool(data.inputs, data.outputs, ORDER, HORIZON))
    except ImportError:
        return Row(task, time, peer, None, error=error)
    return Row(task, time, peer, peer_time, error, peer_error)


def _measure(work: Callable[[], Matrices]) -> tuple[float, float]:
    """Time [s] and relative error of the frequency response."""
    error = response_error(work(), _true_model())
    return best_of(work), error


def response_error(model: Matrices, true: Matrices) -> float:
    """Relative error of G(exp(j w T)), root mean square over frequencies."""
    frequencies = np.geomspace(1.0, 100.0, 200)
    errors = []
    for hz in frequencies:
        z = np.exp(2j * np.pi * hz * SAMPLE_TIME)
        estimate, reference = (
            C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D for A, B, C, D in (model, true)
        )
        errors.append(np.linalg.norm(estimate - reference) / np.linalg.norm(reference))
    return float(np.sqrt(np.mean(np.square(errors))))


def _true_model() -> Matrices:
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
    A, B, C, _ = _true_model()
    rng = np.random.default_rng(0)
    voltage = 10.0 * np.sign(rng.standard_normal(samples))
    u = np.column_stack([voltage, 10.0 * rng.standard_normal(samples)])
    e = NOISE * rng.standard_normal((samples, 2))
    x, outputs = np.zeros(3), np.empty((samples, 2))
    for t in range(samples):
        outputs[t] = C @ x + e[t]
        x = A @ x + B @ u[t] + gain @ e[t]
    return InputOutput(u, outputs, SAMPLE_TIME)
