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

from strainwave.domain import FloatArray, Joint
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import JointNumber
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import TwoInertia
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm
from strainwave.io.joint_covariance import IdentifiedNoise
from strainwave.tune.closed_loop import Clock
from strainwave.tune.link_measurements import Measurement, measurements_of
from strainwave.tune.plants import Condition, LinksAt, base_vector

_DEFAULT_BAND_HZ = 5.0  # of torque errors, if the result has none
_DEFAULT_ERROR_SHARE = 0.02  # of the torque at one volt: torque error, if the result has none
_INTERACTION_RATIO = 5.0  # of unknown interaction torques over the dry friction, at the motor
_BIAS_TIME = 10.0  # [s] in which a bias drifts by the noise of one sample

_MOTION = ("motor_angle", "motor_velocity", "link_angle", "link_velocity")

_DISTURBANCE, _DRIVE_TORQUE, _LAST_INPUT = "motor_torque_error", "drive_torque", "last_input"
"""Names of states."""


@dataclass(frozen=True, slots=True)
class _DrivenJoint(TwoInertia):
    """Motor, gear and link of one joint behind its drive."""

    number: int
    joint: Joint
    dry_friction: float
    torque_per_volt: float

    @classmethod
    def of(cls, arm: IdentifiedArm, model: Arm, number: int, link_inertia: float) -> Self:
        """The joint with the geometric mean of the lowest and highest slope of its gear."""
        joint, values = arm.joint(number), arm.values
        slopes = joint.law.stiffness_range(joint.law.of_joint(values, number))

        return cls(
            number=number,
            joint=joint,
            gear_ratio=joint.gear_ratio,
            motor_inertia=arm.need("motor_inertia", number),
            link_inertia=link_inertia,
            gear_stiffness=math.sqrt(slopes[0] * slopes[1]),
            gear_damping=arm.need("gear_damping", number),
            motor_viscous_friction=values.get(("motor_viscous_friction", number), 0.0),
            link_viscous_friction=values.get(("link_viscous_friction", number), 0.0),
            dry_friction=values.get(("motor_coulomb_friction", number), 0.0),
            torque_per_volt=float(model.torque_per_volt[number - 1]),
        )

    @property
    def mode_hz(self) -> float:
        """Frequency of the link while the motor is held."""
        return math.sqrt(self.gear_stiffness / self.link_inertia) / math.tau

    @property
    def gear(self) -> FloatArray:
        """Torque of the gear over angle and velocity of motor and link: (4,)."""
        n, k, c = self.gear_ratio, self.gear_stiffness, self.gear_damping
        return np.array([n * k, n * c, -k, -c])

    def at_rest(self, names: Sequence[str]) -> FloatArray:
        """States at rest over motor angle, interaction torque and input: (n, 3).

        Dry friction holds what gear and drive leave.
        """
        n, rest = self.gear_ratio, np.zeros((len(names), 3))
        rest[0, 0], rest[2, :2] = 1.0, (n, -1.0 / self.gear_stiffness)
        rest[4] = 0.0, n, -self.torque_per_volt
        if _DRIVE_TORQUE in names:
            rest[names.index(_DRIVE_TORQUE), 2] = self.torque_per_volt
        if _LAST_INPUT in names:
            rest[names.index(_LAST_INPUT), 2] = 1.0
        return rest

    def equations(self, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """F (n, n) and G (n, 2) of dx = F x + G (u, t_int) for the states of `names`."""
        F, G = np.zeros((len(names), len(names))), np.zeros((len(names), 2))
        F[0, 1] = F[2, 3] = 1.0
        F[1, :4] = -self.gear_ratio * self.gear / self.motor_inertia
        F[1, 1] -= self.motor_viscous_friction / self.motor_inertia
        F[3, :4] = self.gear / self.link_inertia
        F[3, 3] -= self.link_viscous_friction / self.link_inertia
        F[1, names.index(_DISTURBANCE)] = 1.0 / self.motor_inertia
        G[3, 1] = -1.0 / self.link_inertia
        if _DRIVE_TORQUE in names:
            at, rate = names.index(_DRIVE_TORQUE), math.tau * (self.joint.current_loop_hz or 0.0)
            F[1, at], F[at, at] = 1.0 / self.motor_inertia, -rate
            G[at, 0] = rate * self.torque_per_volt
        else:
            G[1, 0] = self.torque_per_volt / self.motor_inertia
        return F, G


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

    joint: JointNumber
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

    @property
    def torsion(self) -> FloatArray:
        """Rows (2, n) of the torsion, n th - q, and of its rate, n w - v, over the states."""
        rows = np.zeros((2, len(self.names)))
        rows[[0, 1], [0, 1]], rows[[0, 1], [2, 3]] = self.gear_ratio, -1.0
        return rows


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
    inertias = np.diagonal(LinksAt.of(model, condition).inertia(base_vector(model, arm.values)))
    observers = []
    for number, joint in enumerate(model.joints, start=1):
        if not joint.elastic or number in model.coupled_joints:
            continue  # a torsion behind a coupled transmission depends on several motors
        plant = _DrivenJoint.of(arm, model, number, float(inertias[number - 1]))
        used, unused = measurements_of(arm, number, plant.mode_hz, clock.period, noise)
        if not uses_link_sensors:
            used, unused = used[:1], ()
        densities = _noise_densities(plant, noise, knows_interaction=knows_interaction)
        observers.append(_observer(plant, clock, densities, used, unused))
    return tuple(observers)


def _noise_densities(
    plant: _DrivenJoint, noise: IdentifiedNoise, *, knows_interaction: bool
) -> tuple[float, float]:
    """Process noise of link velocity and disturbance: densities [unit^2 s] of the rates.

    The disturbance is a random walk, so that a constant one leaves no error of the link. It
    changes by torque error and dry friction together within the band of the torque error.
    Behind the gear, an error of the same size moves the link; an unknown interaction torque is
    some times as large as the dry friction.
    """
    band = math.tau * (noise.torque_band_hz or _DEFAULT_BAND_HZ)
    error = noise.torques.get(plant.number) or _DEFAULT_ERROR_SHARE * plant.torque_per_volt
    unknown = 0.0 if knows_interaction else _INTERACTION_RATIO * plant.dry_friction
    of_link = math.hypot(error, unknown) / plant.gear_ratio / plant.link_inertia
    return 2.0 / band * of_link**2, 2.0 * band * (error**2 + plant.dry_friction**2)


def _observer(
    plant: _DrivenJoint,
    clock: Clock,
    noise: tuple[float, float],
    measurements: tuple[Measurement, ...],
    unused: tuple[str, ...],
) -> Observer:
    names = [*_MOTION, _DISTURBANCE]
    if plant.joint.current_loop_hz:
        names.append(_DRIVE_TORQUE)
    names += [f"{one.label}_bias" for one in measurements if one.has_bias]
    F, G = plant.equations(names)
    densities = np.zeros(len(names))
    densities[[3, 4]] = noise
    biases = [one.std**2 / _BIAS_TIME for one in measurements if one.has_bias]
    densities[len(names) - len(biases) :] = biases
    A, B, Q = _sampled(F, G, densities, clock)
    if clock.delay:
        names.append(_LAST_INPUT)
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
        gear_ratio=plant.gear_ratio,
        mode=math.tau * plant.mode_hz,
        link_inertia=plant.link_inertia,
    )


def _sampled(
    F: FloatArray, G: FloatArray, densities: FloatArray, clock: Clock
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A, B and the covariance Q of the process noise over a period (Van Loan, 1978).

    With a delay the last input is one more state.
    """
    n, T, late = len(F), clock.period, clock.delay
    system = np.pad(np.hstack([F, G]), ((0, 2), (0, 0)))
    after, before = expm(system * (T - late)), expm(system * late)
    A = after[:n, :n] @ before[:n, :n]
    old = after[:n, :n] @ before[:n, n:]
    B = after[:n, n:].copy()
    B[:, 1] += old[:, 1]  # the interaction torque acts without the delay
    exponential = expm(np.block([[-F, np.diag(densities)], [np.zeros_like(F), F.T]]) * T)
    Q = exponential[n:, n:].T @ exponential[:n, n:]
    Q = 0.5 * (Q + Q.T)
    if not late:
        return A, B, Q
    A = np.block([[A, old[:, :1]], [np.zeros((1, n + 1))]])
    return A, np.vstack([B, [1.0, 0.0]]), np.pad(Q, ((0, 1), (0, 1)))


def _readings(
    plant: _DrivenJoint,
    measurements: Sequence[Measurement],
    names: Sequence[str],
    F: FloatArray,
    G: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """C (n_readings, n) and D (n_readings,) of y = C x + D t_int."""
    C, D = np.zeros((len(measurements), len(names))), np.zeros(len(measurements))
    rows: dict[Quantity, FloatArray] = {
        "motor_angle": np.array([1.0, 0.0, 0.0, 0.0]),
        "link_angle": np.array([0.0, 0.0, 1.0, 0.0]),
        "link_velocity": np.array([0.0, 0.0, 0.0, 1.0]),
        "torsion": np.array([plant.gear_ratio, 0.0, -1.0, 0.0]),
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
