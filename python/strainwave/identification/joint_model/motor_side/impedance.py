"""What torque an elastic arm asks of its motors for their motion, linear about a posture.

    (M s^2 + D_L s + G + K_s) q_L = K_s N q_M,     K_s = diag(k + d_G s)
    Z(s) = diag(m_M s + d_M) + N K_s [I - (M s^2 + D_L s + G + K_s)^-1 K_s] N / s

Torques are Z(s) times motor velocities. Its poles are the arm's modes with every motor held, the
anti-resonances; 1/Z_ii is a motor's response with the others held, and Z^-1 that with them free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class LinearArm:
    """An arm of n joints with linear gears, or many such arms at once."""

    gear_ratio: FloatArray  # (n,)
    motor_inertia: FloatArray  # (..., n) m_M [kg m^2]
    motor_viscous_friction: FloatArray  # (..., n) d_M [N m s/rad]
    link_viscous_friction: FloatArray  # (..., n) d_L [N m s/rad]
    gear_stiffness: FloatArray  # (..., n) k [N m/rad]
    gear_damping: FloatArray  # (..., n) d_G [N m s/rad]
    inertia: FloatArray  # (..., n, n) M of the links in the posture [kg m^2]
    gravity: FloatArray  # (..., n, n) G, slope of gravity's torques there [N m/rad]

    def impedance(self, s: ComplexArray) -> ComplexArray:
        """Z(s), motor torques over motor velocities.

        `s` (n_lines,) [rad/s]: Not zero.

        Returns: [N m s/rad].
        """
        n = len(self.gear_ratio)
        one = np.eye(n)
        s1, s2 = s[:, None], s[:, None, None]
        gear = self.gear_stiffness[..., None, :] + self.gear_damping[..., None, :] * s1
        gears = gear[..., None] * one
        drag = self.link_viscous_friction[..., None, :, None] * one
        held = self.inertia[..., None, :, :] * s2**2 + drag * s2
        held = held + self.gravity[..., None, :, :] + gears
        carried = gears - gears @ _inverse(held) @ gears
        own = self.motor_inertia[..., None, :] * s1 + self.motor_viscous_friction[..., None, :]
        ratio = self.gear_ratio
        return np.asarray(own[..., None] * one + ratio[:, None] * carried * ratio / s2)


def _inverse(matrices: ComplexArray) -> ComplexArray:
    """Of many small matrices, (..., n, n); those of two joints in closed form, ten times faster."""
    if matrices.shape[-1] > 2:
        return np.asarray(np.linalg.inv(matrices))
    if matrices.shape[-1] == 1:
        return np.asarray(1.0 / matrices)
    a, b, c, d = (matrices[..., i, k] for i in (0, 1) for k in (0, 1))
    found = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    return np.asarray(found / (a * d - b * c)[..., None, None])


def velocities(
    impedance: ComplexArray, torque: ComplexArray, velocity: ComplexArray, row: int
) -> ComplexArray:
    """One motor's velocity from its torque, with the other motors moving as they do.

    w_i = (u_i - sum over j of Z_ij w_j) / Z_ii, j not i: right whether the others are free, held
    or servoed, because only their motion counts.

    `torque` (n_lines,): Of that motor, less its dry friction.
    `velocity` (n_lines, n): Of all motors.
    `row`: i, from 0.
    """
    Z = impedance[..., row, :]
    others = (Z * velocity).sum(axis=-1) - Z[..., row] * velocity[:, row]
    return np.asarray((torque - others) / Z[..., row])
