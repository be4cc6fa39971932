"""Errors of prediction-error fits against the bound of Cramer and Rao.

`python -m benchmarks.studies.prediction_error` fits short records of several linear systems. Of
every system it prints the errors' root mean square over the least that an unbiased estimate can
have, chi-square per degree of freedom of the errors by the stated covariance, and how often 95 %
intervals hold the truth. `--first-seed` draws other records.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from strainwave.domain import ContinuousStateSpace, FloatArray, Hold, InputOutput, StateSpace
from strainwave.statespace import modes, pem, propagate, to_continuous
from strainwave.statespace._entries import Matrices, rescale
from strainwave.statespace._evaluate import Evaluator
from strainwave.statespace._stack import stack

HOLD: tuple[Hold, Hold] = ("zero", "first")
COLOURED = np.array([[0.0, 1e-3], [0.3, 0.5], [0.001, 0.3]])


@dataclass(frozen=True, slots=True)
class System:
    """A motor and a link with a spring between them, sampled, and the noise of its sensors.

    States: n theta_M - theta_L, dtheta_M, dtheta_L. Inputs: voltage, held, and interaction torque,
    joined by straight lines. Outputs: the two velocities.
    """

    motor_inertia: float  # [kg m^2]
    link_inertia: float  # [kg m^2]
    ratio: float
    stiffness: float  # [N m/rad]
    damping: float  # [N m s/rad]
    motor_friction: float  # [N m s/rad]
    link_friction: float  # [N m s/rad]
    torque_per_volt: float  # [N m/V]
    sample_time: float  # [s]
    gain: FloatArray  # K of the innovations form
    noise: tuple[float, float]  # standard deviation of the innovations [rad/s]
    amplitude: tuple[float, float] = (10.0, 10.0)  # [V], [N m]
    feedback: float = 0.0  # [V s/rad] of a velocity servo, one sample late

    @property
    def truth(self) -> FloatArray:
        """m_M, m_L, k, d_G."""
        return np.array([self.motor_inertia, self.link_inertia, self.stiffness, self.damping])

    def continuous(self) -> ContinuousStateSpace:
        m, mL, n, k, d = (
            self.motor_inertia,
            self.link_inertia,
            self.ratio,
            self.stiffness,
            self.damping,
        )
        A = np.array(
            [
                [0.0, n, -1.0],
                [-n * k / m, -(self.motor_friction + n * n * d) / m, n * d / m],
                [k / mL, n * d / mL, -(self.link_friction + d) / mL],
            ]
        )
        B = np.array([[0.0, 0.0], [self.torque_per_volt / m, 0.0], [0.0, 1.0 / mL]])
        return ContinuousStateSpace(A, B, np.eye(3)[1:], np.zeros((2, 2)))

    def sampled(self) -> StateSpace:
        from scipy.linalg import expm

        model, n, T = self.continuous(), 3, self.sample_time
        M = np.zeros((n + 3, n + 3))  # torque = start + slope t
        M[:n, :n], M[:n, n : n + 2] = model.A, model.B
        M[n + 1, n + 2] = 1.0 / T
        whole = expm(M * T)
        A, B, ramp = whole[:n, :n], whole[:n, n : n + 2].copy(), whole[:n, [n + 2]]
        B[:, [1]] += A @ ramp - ramp
        D = np.hstack([np.zeros((2, 1)), model.C @ ramp])
        nothing = np.zeros((1, n))
        return StateSpace(
            A=A, B=B, C=model.C, D=D, K=self.gain, noise_covariance=np.diag(np.square(self.noise)),
            initial_states=nothing, sample_time=T, hold=HOLD, method="pem", status="estimated",
            fit_percent=(), prediction_fit_percent=(), n_samples=0, n_parameters=0,
            log_likelihood=0.0,
        )  # fmt: skip

    def data(self, seed: int, samples: int) -> InputOutput:
        rng = np.random.default_rng([int(seed), samples])
        model = self.sampled()
        drive = self.amplitude[0] * np.sign(rng.standard_normal(samples))
        torque = self.amplitude[1] * rng.standard_normal(samples)
        e = np.array(self.noise) * rng.standard_normal((samples, 2))
        u, y = np.empty((samples, 2)), np.empty((samples, 2))
        x, before = np.zeros(3), 0.0
        for k in range(samples):
            u[k] = drive[k] - self.feedback * before, torque[k]
            y[k] = model.C @ x + model.D @ u[k] + e[k]
            x = model.A @ x + model.B @ u[k] + model.K @ e[k]
            before = y[k, 0]
        return InputOutput(u, y, self.sample_time, HOLD)

    def physical(self, model: ContinuousStateSpace) -> FloatArray:
        """m_M, m_L, k, d_G: C B holds e / m_M and 1 / m_L, the zeros are the link's alone."""
        high = model.C @ model.B
        m_M, m_L = self.torque_per_volt / high[0, 0], 1.0 / high[1, 1]
        zero = modes(replace(model, covariance=None), 0, 0).anti_resonance
        if zero is None:
            return np.full(4, np.nan)
        w = 2.0 * np.pi * zero.frequency_hz
        d = 2.0 * zero.damping * w * m_L - self.link_friction
        return np.array([m_M, m_L, w * w * m_L, d])

    def bound(self, data: InputOutput) -> FloatArray:
        """Cramer-Rao bound of the physical parameters at the truth, the initial state unknown."""
        model, stacked = self.sampled(), stack(data)
        n, m, p = 3, 2, 2
        own = Matrices(model.A, model.B, model.C, model.D, model.K, np.zeros((1, n)))
        J = Evaluator(stacked, n).core.jacobian(rescale(own, stacked).pack())
        J = (J * (stacked.output_scale / np.array(self.noise))[:, None]).reshape(-1, J.shape[2])
        free = np.ones(J.shape[1], dtype=bool)
        start = n * (n + m + p)
        free[[start, start + m]] = False  # the voltage, held, acts on no output at once
        size = np.linalg.norm(J[:, free], axis=0)
        _, s, Vt = np.linalg.svd(J[:, free] / size, full_matrices=False)
        kept = free.sum() - n * n  # the rest are changes of coordinates
        half = np.zeros((len(free), kept))
        half[free] = Vt[:kept].T / s[:kept] / size[:, None]
        u, y = stacked.input_scale, stacked.output_scale
        parts = [np.ones((n, n)), np.ones((n, 1)) / u, y[:, None] * np.ones((1, n))]
        parts += [y[:, None] / u, np.ones((n, 1)) / y]
        half = half[: start + p * m + n * p]
        half = half * np.concatenate([np.ravel(part) for part in parts])[:, None]
        known = replace(model, covariance=half @ half.T)
        return np.asarray(propagate(to_continuous(known), self.physical)[1])


ARM = System(
    1.5e-4, 3.0, 0.01, 1.6e4, 20.0, 2e-4, 0.5, 0.08, 1e-3, COLOURED, (0.3, 0.005)
)  # fmt: skip

SYSTEMS = {
    "arm, coloured noise": ARM,
    "arm, white noise": replace(ARM, gain=np.zeros((3, 2))),
    "arm, ten times the noise": replace(ARM, noise=(3.0, 0.05)),
    "arm, closed loop": replace(ARM, feedback=0.2),
    "small arm": System(
        4e-6, 0.05, 0.0125, 9e3, 1.2, 5e-6, 0.02, 0.02, 5e-4, COLOURED, (0.5, 0.02), (6.0, 2.0)
    ),
    "stiff joint, 250 Hz": System(
        1.5e-4, 1.0, 0.02, 4e3, 6.0, 4e-4, 0.3, 0.08, 4e-3, COLOURED, (0.2, 0.01), (8.0, 8.0)
    ),
}  # fmt: skip


def tried(name: str, samples: int, seed: int) -> dict[str, Any]:
    """One record: the estimate, its stated covariance, its status and the least covariance."""
    system = SYSTEMS[name]
    data = system.data(seed, samples)
    model = pem(data, 3)
    found: dict[str, Any] = {"status": model.status, "kind": model.covariance_kind}
    if model.covariance is None:
        return found
    values, covariance = propagate(to_continuous(model), system.physical)
    return found | {
        "error": values - system.truth,
        "stated": covariance,
        "least": system.bound(data),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=0, help="-1: a fresh one")
    parser.add_argument("--samples", type=int, default=512)
    parser.add_argument("--systems", nargs="*", default=list(SYSTEMS), choices=list(SYSTEMS))
    parser.add_argument("--cores", type=int, default=2)
    chosen = parser.parse_args()
    first = chosen.first_seed
    if first < 0:
        first = int(np.random.default_rng().integers(2**31))
    console = Console()
    console.print(f"{chosen.seeds} records of {chosen.samples} samples, seeds from {first}")
    table = Table(
        "system", "converged", "error / bound", "m_M, m_L, k, d_G", "bias / error",
        "stated / bound", "chi^2 / degree", "p", "95 % hold", box=None,
    )  # fmt: skip
    with ProcessPoolExecutor(chosen.cores, mp_context=get_context("spawn")) as pool:
        for name in chosen.systems:
            work: Callable[[int], dict[str, Any]] = partial(tried, name, chosen.samples)
            found = list(pool.map(work, range(first, first + chosen.seeds), chunksize=10))
            table.add_row(name, *summary(found))
    console.print(table)


def summary(found: list[dict[str, Any]]) -> list[str]:
    """Cells of one system."""
    from scipy.stats import chi2

    good = [each for each in found if "error" in each and np.isfinite(each["error"]).all()]
    errors = np.array([each["error"] for each in good])
    stated = np.array([each["stated"] for each in good])
    least = np.array([each["least"] for each in good])
    std = np.sqrt(np.einsum("kii->ki", stated))
    bound = np.sqrt(np.mean(np.einsum("kii->ki", least), axis=0))
    rms = np.sqrt(np.mean(errors**2, axis=0))
    ratios = rms / bound
    total = float(np.sum([e @ np.linalg.solve(S, e) for e, S in zip(errors, stated, strict=True)]))
    degrees = errors.size
    inside = np.mean(np.abs(errors) <= 1.96 * std)
    converged = sum(each["status"] == "converged" for each in found)
    return [
        f"{converged} of {len(found)}",
        f"{np.sqrt(np.mean(ratios**2)):.3f}",
        ", ".join(f"{ratio:.3f}" for ratio in ratios),
        ", ".join(f"{value:+.2f}" for value in np.mean(errors, axis=0) / rms),
        f"{np.sqrt(np.mean(std**2 / bound**2)):.3f}",
        f"{total / degrees:.3f}",
        f"{chi2.sf(total, degrees):.2g}",
        f"{100.0 * inside:.1f}",
    ]


if __name__ == "__main__":
    main()
