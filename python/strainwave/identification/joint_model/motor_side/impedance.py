"""Mechanical impedance of an elastic arm at its motors, linearised about a posture.

    (M s^2 + D_L s + G + K_s) q_L = K_s N q_M,     K_s = diag(k + d_G s)
    Z(s) = diag(m_M s + d_M) + N K_s [I - (M s^2 + D_L s + G + K_s)^-1 K_s] N / s

Motor torques are Z(s) times motor velocities. The poles of Z are the modes with all motors held,
the anti-resonances. 1/Z_ii is the response of a motor with the others held; Z^-1 with the others
free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class LinearArm:
    """One or many arms of n joints with linear gears, linearised about a posture."""

    gear_ratio: FloatArray  # (n,)
    motor_inertia: FloatArray  # (..., n) m_M [kg m^2]
    motor_viscous_friction: FloatArray  # (..., n) d_M [N m s/rad]
    link_viscous_friction: FloatArray  # (..., n) d_L [N m s/rad]
    gear_stiffness: FloatArray  # (..., n) k [N m/rad]
    gear_damping: FloatArray  # (..., n) d_G [N m s/rad]
    inertia: FloatArray  # (..., n, n) M of the links in the posture [kg m^2]
    gravity: FloatArray  # (..., n, n) G, derivative of gravity torques [N m/rad]

    def impedance(self, s: ComplexArray) -> ComplexArray:
        """Z(s), motor torques over motor velocities, (..., n_lines, n, n) [N m s/rad].

        `s` (n_lines,) [rad/s] must not be zero.
        """
        n = len(self.gear_ratio)
        identity = np.eye(n)
        s1, s2 = s[:, None], s[:, None, None]
        gear = self.gear_stiffness[..., None, :] + self.gear_damping[..., None, :] * s1
        gears = gear[..., None] * identity
        viscous = self.link_viscous_friction[..., None, :, None] * identity
        dynamic_stiffness = self.inertia[..., None, :, :] * s2**2 + viscous * s2
        dynamic_stiffness = dynamic_stiffness + self.gravity[..., None, :, :] + gears
        transmitted = gears - gears @ _inverse(dynamic_stiffness) @ gears
        motor = self.motor_inertia[..., None, :] * s1 + self.motor_viscous_friction[..., None, :]
        ratio = self.gear_ratio
        return np.asarray(motor[..., None] * identity + ratio[:, None] * transmitted * ratio / s2)


def _inverse(matrices: ComplexArray) -> ComplexArray:
    """Inverse of small matrices (..., n, n). The closed form for n = 2 is ten times faster."""
    if matrices.shape[-1] > 2:
        return np.asarray(np.linalg.inv(matrices))
    if matrices.shape[-1] == 1:
        return np.asarray(1.0 / matrices)
    a, b, c, d = (matrices[..., i, k] for i in (0, 1) for k in (0, 1))
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    return np.asarray(adjugate / (a * d - b * c)[..., None, None])


def velocities(
    impedance: ComplexArray, torque: ComplexArray, velocity: ComplexArray, row: int
) -> ComplexArray:
    """Velocity of one motor from its torque and the measured velocities of the other motors.

    w_i = (u_i - sum over j != i of Z_ij w_j) / Z_ii. This holds whether the other motors are free,
    held or servoed.

    `torque` (n_lines,) is that of motor `row` (from 0) without Coulomb friction; `velocity`
    (n_lines, n) contains all motors.
    """
    Z = impedance[..., row, :]
    other_torque = (Z * velocity).sum(axis=-1) - Z[..., row] * velocity[:, row]
    return np.asarray((torque - other_torque) / Z[..., row])
