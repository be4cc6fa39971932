"""Two-inertia joint with an exact discrete-time model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from strainwave.domain import ContinuousStateSpace, FloatArray, InputOutput, StateSpace

SAMPLE_TIME = 1e-3
HOLD = ("zero", "first")


@dataclass(frozen=True)
class TwoInertia:
    """Inputs: voltage [V], interaction torque [N m]. Outputs: motor and link velocity [rad/s]."""

    motor_inertia: float = 1.5e-4
    link_inertia: float = 3.0
    gear_ratio: float = 0.01
    gear_stiffness: float = 1.6e4
    gear_damping: float = 20.0
    motor_viscous_friction: float = 2e-4
    link_viscous_friction: float = 0.5
    torque_per_volt: float = 0.08

    def continuous(self) -> ContinuousStateSpace:
        """Continuous-time model with states n theta_M - theta_L, dtheta_M, dtheta_L."""
        m, mL, n, k = self.motor_inertia, self.link_inertia, self.gear_ratio, self.gear_stiffness
        d = self.gear_damping
        A = np.array(
            [
                [0.0, n, -1.0],
                [-n * k / m, -(self.motor_viscous_friction + n * n * d) / m, n * d / m],
                [k / mL, n * d / mL, -(self.link_viscous_friction + d) / mL],
            ]
        )
        B = np.array([[0.0, 0.0], [self.torque_per_volt / m, 0.0], [0.0, 1.0 / mL]])
        C = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        return ContinuousStateSpace(A, B, C, np.zeros((2, 2)))

    def anti_resonance(self) -> complex:
        """Zero from voltage to motor velocity."""
        roots = np.roots(
            [
                self.link_inertia,
                self.gear_damping + self.link_viscous_friction,
                self.gear_stiffness,
            ]
        )
        return complex(roots[np.argmax(roots.imag)])

    def sampled(self, K: FloatArray | None = None, noise: FloatArray | None = None) -> StateSpace:
        """Exact discrete-time model with zero-order hold of u and first-order hold of tau."""
        model = self.continuous()
        n, T = 3, SAMPLE_TIME
        M = np.zeros((n + 4, n + 4))  # u constant, tau + (t / T) slope
        M[:n, :n] = model.A
        M[:n, n : n + 2] = model.B
        M[n + 1, n + 3] = 1.0 / T
        whole = expm(M * T)
        A, held, ramp = whole[:n, :n], whole[:n, n : n + 2], whole[:n, [n + 3]]
        # x~ = x - ramp tau[k] removes tau[k+1] from the state equation
        B = held.copy()
        B[:, [1]] += A @ ramp - ramp
        D = np.zeros((2, 2))
        D[:, [1]] = model.C @ ramp
        return state_space(A, B, model.C, D, K, noise)


def state_space(
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    K: FloatArray | None = None,
    noise: FloatArray | None = None,
    hold: tuple[str, ...] = HOLD,
) -> StateSpace:
    """State-space model with matrices only."""
    n, p = len(A), len(C)
    return StateSpace(
        A=A,
        B=B,
        C=C,
        D=D,
        K=np.zeros((n, p)) if K is None else K,
        noise_covariance=np.zeros((p, p)) if noise is None else noise,
        initial_states=np.zeros((1, n)),
        sample_time=SAMPLE_TIME,
        hold=hold,  # type: ignore[arg-type]
        method="pem",
        status="estimated",
        fit_percent=(),
        prediction_fit_percent=(),
        n_samples=0,
        n_parameters=0,
        log_likelihood=0.0,
    )


def excitation(rng: np.random.Generator, samples: int) -> FloatArray:
    """Random voltage steps of 10 V and an interaction torque of about 10 N m."""
    voltage = 10.0 * np.sign(rng.standard_normal(samples))
    return np.column_stack([voltage, 10.0 * rng.standard_normal(samples)])


def simulate(
    model: StateSpace,
    inputs: FloatArray,
    innovations: FloatArray | None = None,
    initial_state: FloatArray | None = None,
) -> InputOutput:
    """Simulate x+ = A x + B u + K e, y = C x + D u + e."""
    e = np.zeros((len(inputs), len(model.C))) if innovations is None else innovations
    x = np.zeros(model.order) if initial_state is None else initial_state
    outputs = np.empty_like(e)
    drive = inputs @ model.B.T + e @ model.K.T
    for k in range(len(inputs)):
        outputs[k] = model.C @ x
        x = model.A @ x + drive[k]
    outputs += inputs @ model.D.T + e
    return InputOutput(inputs, outputs, model.sample_time, model.hold)
