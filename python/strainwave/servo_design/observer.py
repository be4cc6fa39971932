"""Observers of the links: Kalman filters of two-inertia joints with known interaction torque.

The motor and the link of joint i follow

    J_M dw = e u + d - f_v w - n t,   J_L dv = t - f_L v - t_int,   t = k (n th - q) + c (n w - v)

with the torque t of the gear and the interaction torque t_int, which contains gravity and the
acceleration of the other joints. d is what the linear model of the motor lacks: dry friction and
the torques that the rigid model does not explain. The interaction torque is an input, as in the
decoupling identification, so that each joint has an observer of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from strainwave.domain import FloatArray
from strainwave.domain.link_sensors.link_space import Quantity
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm
from strainwave.io.joint_covariance import IdentifiedNoise
from strainwave.servo_design.closed_loop import Clock
from strainwave.servo_design.joint_plant import (
    DISTURBANCE,
    DRIVE_TORQUE,
    LAST_INPUT,
    MOTION,
    TwoInertia,
)
from strainwave.servo_design.link_measurements import Measurement, measurements_of
from strainwave.servo_design.plants import Condition, link_inertias

_DEFAULT_BAND_HZ = 5.0  # of torque errors, if the result has none
_DEFAULT_ERROR_SHARE = 0.02  # of the torque at one volt: torque error, if the result has none
_INTERACTION_RATIO = 5.0  # of unknown interaction torques over the dry friction, at the motor
_BIAS_TIME = 10.0  # [s] in which a bias drifts by the noise of one sample


OUTPUTS = ("link_angle", "link_velocity")
"""Outputs of an observer."""


@dataclass(frozen=True, slots=True, eq=False)
class ObserverSystem:
    """x+ = A x + B v, (q, dq) = C x + D v with the inputs v = (u, t_int, readings)."""

    A: FloatArray  # (n, n)
    B: FloatArray  # (n, 2 + n_readings)
    C: FloatArray  # (2, n)
    D: FloatArray  # (2, 2 + n_readings); zero for u, which follows the readings
    inputs: tuple[str, ...]
    states: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Observer:
    """Observer of one joint.

    At each period, with readings y, the interaction torque t_int and the input u that follows:

        xh = x + L (y - C x - D t_int),   x+ = A xh + B (u, t_int)
    """

    joint: int  # from 1
    period: float  # [s]
    A: FloatArray  # (n, n)
    B: FloatArray  # (n, 2)
    C: FloatArray  # (n_readings, n)
    D: FloatArray  # (n_readings,)
    L: FloatArray  # (n, n_readings)
    at_rest: FloatArray  # (n, 3) states at rest over (motor angle, t_int, u)
    names: tuple[str, ...]  # of the states
    measurements: tuple[Measurement, ...]
    unused: tuple[str, ...]  # sensors of the study that are not used, and why
    gear_ratio: float
    mode: float  # [rad/s] of the link while the motor is held
    link_inertia: float  # J_L [kg m^2] at the posture of the design
    link_std: float  # [rad] of the estimated link angle, by the model

    @property
    def system(self) -> ObserverSystem:
        """The observer as one linear system."""
        after = np.eye(len(self.A)) - self.L @ self.C
        of_torque = -self.L @ self.D
        rows = np.eye(len(self.A))[[2, 3]]
        return ObserverSystem(
            A=self.A @ after,
            B=np.column_stack([self.B[:, 0], self.B[:, 1] + self.A @ of_torque, self.A @ self.L]),
            C=rows @ after,
            D=np.column_stack([np.zeros(2), rows @ of_torque, rows @ self.L]),
            inputs=("input", "interaction_torque", *(one.label for one in self.measurements)),
            states=self.names,
        )

    def correct(self, x: FloatArray, readings: FloatArray, interaction: float) -> FloatArray:
        """Estimate (n,) from the prediction and the readings."""
        return np.asarray(x + self.L @ (readings - self.C @ x - self.D * interaction))

    def predict(self, estimate: FloatArray, voltage: float, interaction: float) -> FloatArray:
        """Prediction (n,) for the next period."""
        return np.asarray(self.A @ estimate + self.B @ (voltage, interaction))

    def rest(self, motor_angle: float, link_angle: float) -> FloatArray:
        """State (n,) at rest without known torques."""
        x = np.zeros(len(self.names))
        x[[0, 2]] = motor_angle, link_angle
        return x

    @property
    def torsion(self) -> FloatArray:
        """Row (n,) of the torsion, n th - q, over the states."""
        row = np.zeros(len(self.names))
        row[0], row[2] = self.gear_ratio, -1.0
        return row

    @property
    def torsion_rate(self) -> FloatArray:
        """Row (n,) of the torsion's rate, n w - v, over the states."""
        row = np.zeros(len(self.names))
        row[1], row[3] = self.gear_ratio, -1.0
        return row

    @property
    def poles(self) -> FloatArray:
        """Magnitudes of the poles of the estimation error."""
        closed = self.A @ (np.eye(len(self.A)) - self.L @ self.C)
        return np.sort(np.abs(np.linalg.eigvals(closed)))


def design_observers(
    arm: IdentifiedArm,
    condition: Condition,
    clock: Clock,
    noise: IdentifiedNoise,
    *,
    uses_link_sensors: bool = True,
    knows_interaction: bool = True,
) -> tuple[Observer, ...]:
    """Observers of the elastic joints, at a posture with a payload.

    Joints that several motors move have none. Without `uses_link_sensors` the observers read the
    motor encoders alone. Without `knows_interaction` the interaction torque counts as noise.
    """
    model = Arm.of(arm.study.arm)
    inertias = link_inertias(arm, model, condition)
    observers = []
    for number, joint in enumerate(model.joints, start=1):
        if not joint.elastic or number in model.coupled_joints:
            continue  # a torsion behind a coupled transmission depends on several motors
        plant = TwoInertia.of(arm, model, number, float(inertias[number - 1]))
        used, unused = measurements_of(arm, number, plant.mode_hz, clock.period, noise)
        if not uses_link_sensors:
            used, unused = used[:1], ()
        densities = _NoiseDensities.of(plant, noise, knows_interaction=knows_interaction)
        observers.append(_observer(plant, clock, densities, used, unused))
    return tuple(observers)


@dataclass(frozen=True, slots=True)
class _NoiseDensities:
    """Process noise of a joint: densities [unit^2 s] of the rates."""

    disturbance: float
    link_velocity: float

    @classmethod
    def of(cls, plant: TwoInertia, noise: IdentifiedNoise, *, knows_interaction: bool) -> Self:
        """Noise by the torque error of the identification.

        The disturbance is a random walk, so that a constant one leaves no error of the link. It
        changes by torque error and dry friction together within the band of the torque error.
        Behind the gear, an error of the same size moves the link; an unknown interaction torque is
        some times as large as the dry friction.
        """
        band = math.tau * (noise.torque_band_hz or _DEFAULT_BAND_HZ)
        error = noise.torques.get(plant.number) or _DEFAULT_ERROR_SHARE * plant.torque_per_volt
        unknown = 0.0 if knows_interaction else _INTERACTION_RATIO * plant.dry_friction
        of_link = math.hypot(error, unknown) / plant.joint.gear_ratio / plant.link_inertia
        return cls(2.0 * band * (error**2 + plant.dry_friction**2), 2.0 / band * of_link**2)


def _observer(
    plant: TwoInertia,
    clock: Clock,
    noise: _NoiseDensities,
    measurements: tuple[Measurement, ...],
    unused: tuple[str, ...],
) -> Observer:
    """Kalman filter of one joint."""
    names = [*MOTION, DISTURBANCE]
    if plant.joint.current_loop_hz:
        names.append(DRIVE_TORQUE)
    names += [f"{one.label}_bias" for one in measurements if one.has_bias]
    F, G = plant.equations(names)
    densities = np.zeros(len(names))
    densities[[3, 4]] = noise.link_velocity, noise.disturbance
    biases = [one.std**2 / _BIAS_TIME for one in measurements if one.has_bias]
    densities[len(names) - len(biases) :] = biases
    A, B, Q = _sampled(F, G, densities, clock)
    if clock.delay:
        names.append(LAST_INPUT)
    C, D = _readings(plant, measurements, names, F, G)
    R = np.diag([one.std**2 for one in measurements])
    try:
        P = solve_discrete_are(A.T, C.T, Q, R)
    except np.linalg.LinAlgError as error:
        raise InvalidInput(
            f"the states of joint {plant.number} cannot be estimated from its sensors",
            where="the observer",
            remedy="check gear_ratio and torque_per_volt of the joint",
        ) from error
    L = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    remaining = P - L @ C @ P
    return Observer(
        joint=plant.number,
        period=clock.period,
        A=A,
        B=B,
        C=C,
        D=D,
        L=L,
        at_rest=plant.at_rest(names),
        names=tuple(names),
        measurements=measurements,
        unused=unused,
        gear_ratio=plant.joint.gear_ratio,
        mode=math.tau * plant.mode_hz,
        link_inertia=plant.link_inertia,
        link_std=float(np.sqrt(max(remaining[2, 2], 0.0))),
    )


def _sampled(
    F: FloatArray, G: FloatArray, densities: FloatArray, clock: Clock
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A, B and the covariance Q of the process noise over a period (Van Loan, 1978).

    With a delay the last input is one more state.
    """
    n, T, late = len(F), clock.period, clock.delay
    system = np.zeros((n + 2, n + 2))
    system[:n, :n], system[:n, n:] = F, G
    after, before = expm(system * (T - late)), expm(system * late)
    A = after[:n, :n] @ before[:n, :n]
    old = after[:n, :n] @ before[:n, n:]
    B = after[:n, n:].copy()
    B[:, 1] += old[:, 1]  # the interaction torque acts without the delay
    pair = np.zeros((2 * n, 2 * n))
    pair[:n, :n], pair[:n, n:], pair[n:, n:] = -F, np.diag(densities), F.T
    exponential = expm(pair * T)
    Q = exponential[n:, n:].T @ exponential[:n, n:]
    Q = 0.5 * (Q + Q.T)
    if not late:
        return A, B, Q
    A = np.block([[A, old[:, :1]], [np.zeros((1, n + 1))]])
    return A, np.vstack([B, [1.0, 0.0]]), np.pad(Q, ((0, 1), (0, 1)))


def _readings(
    plant: TwoInertia,
    measurements: Sequence[Measurement],
    names: Sequence[str],
    F: FloatArray,
    G: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """C (n_readings, n) and D (n_readings,) of y = C x + D t_int."""
    C, D = np.zeros((len(measurements), len(names))), np.zeros(len(measurements))
    ratio = plant.joint.gear_ratio
    rows: dict[Quantity, FloatArray] = {
        "motor_angle": np.array([1.0, 0.0, 0.0, 0.0]),
        "link_angle": np.array([0.0, 0.0, 1.0, 0.0]),
        "link_velocity": np.array([0.0, 0.0, 0.0, 1.0]),
        "torsion": np.array([ratio, 0.0, -1.0, 0.0]),
        "gear_torque": plant.gear,
        "link_acceleration": F[3, :4],
    }
    for k, one in enumerate(measurements):
        C[k, :4] = one.factor * rows[one.quantity]
        if one.quantity == "link_acceleration":
            D[k] = one.factor * G[3, 1]
        if one.has_bias:
            C[k, names.index(f"{one.label}_bias")] = 1.0
    return C, D
