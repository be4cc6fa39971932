"""Motors of an elastic arm, linearised about a posture.

    A q_L = K_s T q_M,   A = M s^2 + D_L s + G + K_s,   K_s = diag(k + d_G s),   T = C N
    u = (m_M s + d_M) w + T^T K_s (T q_M - q_L),   w = s q_M

With Z(s) of u = Z w, the poles of Z are the modes with all motors held, the anti-resonances. 1/Z_ii
is the response of a motor with the others held; Z^-1 with the others free.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from strainwave.domain import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class LinearisedArms:
    """One or many arms of n joints with linear gears, linearised about a posture."""

    transmission: FloatArray  # (n, n) T, link angles per motor angle
    motor_inertia: FloatArray  # (..., n) m_M [kg m^2]
    motor_viscous_friction: FloatArray  # (..., n) d_M [N m s/rad]
    link_viscous_friction: FloatArray  # (..., n) d_L [N m s/rad]
    gear_stiffness: FloatArray  # (..., n) k [N m/rad]
    gear_damping: FloatArray  # (..., n) d_G [N m s/rad]
    inertia: FloatArray  # (..., n, n) M of the links in the posture [kg m^2]
    gravity: FloatArray  # (..., n, n) G, derivative of gravity torques [N m/rad]

    def derivative(
        self, above: LinearisedArms, below: LinearisedArms, step: float
    ) -> LinearisedArms:
        """Central differences of the parameters, with the transmission of this arm."""
        names = [each.name for each in fields(self)[1:]]
        changes = [(getattr(above, name) - getattr(below, name)) / (2.0 * step) for name in names]
        return LinearisedArms(self.transmission, *changes)

    def motor(
        self, s: ComplexArray, torque: ComplexArray, velocity: ComplexArray, row: int
    ) -> MotorMotion:
        """Motion of motor `row`, from 0, at the measured velocities (n_lines, n) of all motors.

        `s` (n_lines,) [rad/s] must not be zero. `torque` (n_lines,) is that of the motor without
        Coulomb friction.
        """
        own = self.transmission[:, row] / s[:, None]
        turned = np.stack([velocity @ self.transmission.T / s[:, None], own], axis=-1)
        gear = self.gear_stiffness[..., None, :] + self.gear_damping[..., None, :] * s[:, None]
        links = _solve(self._dynamic_stiffness(s, gear), gear[..., None] * turned)
        torsion = turned - links
        motor = self.motor_inertia[..., None, row] * s + self.motor_viscous_friction[..., None, row]
        gears = ((self.transmission[:, row] * gear)[..., None] * torsion).sum(axis=-2)
        impedance = motor + gears[..., 1]
        error = (motor * velocity[:, row] + gears[..., 0] - torque) / impedance
        return MotorMotion(s, row, velocity[:, row], links, torsion, impedance, error)

    def _dynamic_stiffness(self, s: ComplexArray, gear: ComplexArray) -> ComplexArray:
        """A(s), (..., n_lines, n, n) [N m/rad]."""
        identity, s2 = np.eye(len(self.transmission)), s[:, None, None]
        viscous = self.link_viscous_friction[..., None, :, None] * identity
        stiffness = self.inertia[..., None, :, :] * s2**2 + viscous * s2
        return np.asarray(stiffness + self.gravity[..., None, :, :] + gear[..., None] * identity)


@dataclass(frozen=True, slots=True)
class MotorMotion:
    """One motor at the measured velocities of all motors, or at a velocity of one of its own."""

    s: ComplexArray  # (n_lines,)
    row: int  # the motor, from 0
    velocity: ComplexArray  # (n_lines,) measured
    links: ComplexArray  # (..., n_lines, n, 2) motion of the links, for both
    torsion: ComplexArray  # (..., n_lines, n, 2) of the gears, for both
    impedance: ComplexArray  # (..., n_lines) Z_ii
    error: ComplexArray  # (..., n_lines) velocity minus that of measured torque and other motors

    def derivatives(self, changes: LinearisedArms) -> tuple[ComplexArray, ComplexArray]:
        """Derivatives of `error` and `impedance` of one arm by the parameters.

        `changes` are the derivatives of the arm by n_coordinates, their first axis. Both results
        are (n_coordinates, n_lines). Reciprocity gives them without another solution: A is
        symmetric, so that the links' motion at unit velocity weighs the torques of all gears.
        """
        s, count = self.s, len(self.s)
        motor = changes.motor_inertia[:, self.row, None] * s
        motor = motor + changes.motor_viscous_friction[:, self.row, None]
        torque = []
        for moving, velocity in ((0, self.velocity), (1, np.ones_like(s))):
            strain = (self.torsion[..., 1] * self.torsion[..., moving]).T
            product = self.links[:, :, None, 1] * self.links[:, None, :, moving]
            flat, own = product.reshape(count, -1).T, np.diagonal(product, axis1=1, axis2=2).T
            links = changes.inertia.reshape(len(motor), -1) @ (flat * s**2)
            links += changes.gravity.reshape(len(motor), -1) @ flat
            links += changes.link_viscous_friction @ (own * s)
            gears = changes.gear_stiffness @ strain + changes.gear_damping @ (strain * s)
            torque.append(motor * velocity + s * (gears + links))
        return (torque[0] - self.error * torque[1]) / self.impedance, torque[1]


def _solve(matrices: ComplexArray, right: ComplexArray) -> ComplexArray:
    """Solutions of small systems (..., n, n). Closed forms up to n = 2 are ten times faster."""
    n = matrices.shape[-1]
    if n > 2:
        return np.asarray(np.linalg.solve(matrices, right))
    if n == 1:
        return np.asarray(right / matrices)
    a, b, c, d = (matrices[..., i, k, None] for i in (0, 1) for k in (0, 1))
    first, second = right[..., 0, :], right[..., 1, :]
    solution = np.stack([d * first - b * second, a * second - c * first], axis=-2)
    return np.asarray(solution / (a * d - b * c)[..., None, :])
