"""Linear model of one joint: motor, gear and link; (11), (12), (17), (18) and their inverse.

    m_M dw_M + d_M w_M = u - n (k delta + d_G ddelta)
    m_L dw_L + d_L w_L = k delta + d_G ddelta + tau,     ddelta = n w_M - w_L

u is the motor torque, so e = 1 in the equations of the source.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from strainwave.domain import ContinuousStateSpace, FloatArray, Mode

_RELATIVE_STEP = 1e-6  # of central differences: rounding and truncation errors near 1e-11


@dataclass(frozen=True, slots=True)
class TwoInertia:
    """The six physical parameters and the gear ratio."""

    motor_inertia: float  # m_M [kg m^2]
    motor_viscous_friction: float  # d_M [N m s/rad]
    link_inertia: float  # m_L [kg m^2]
    link_viscous_friction: float  # d_L [N m s/rad]
    gear_stiffness: float  # k [N m/rad]
    gear_damping: float  # d_G [N m s/rad]
    gear_ratio: float  # n

    @property
    def vector(self) -> FloatArray:
        """The six parameters in the order of the fields."""
        return np.array([getattr(self, name) for name in NAMES])


def joint_of(vector: FloatArray, gear_ratio: float) -> TwoInertia:
    """A joint from its six parameters in the order of the fields."""
    motor, d_motor, link, d_link, k, d = (float(value) for value in vector)
    return TwoInertia(motor, d_motor, link, d_link, k, d, gear_ratio)


NAMES = tuple(field.name for field in fields(TwoInertia))[:6]
"""Names of the six physical parameters in order."""


def state_space(p: TwoInertia) -> ContinuousStateSpace:
    """Minimal model.

    The states are delta, w_M, w_L, the inputs u, tau, and the outputs w_M, w_L. The fourth state of
    (11), a common rotation of both sides, is not observable from velocities.
    """
    n, k, d = p.gear_ratio, p.gear_stiffness, p.gear_damping
    motor, link = p.motor_inertia, p.link_inertia
    A = np.array(
        [
            [0.0, n, -1.0],
            [-n * k / motor, -(p.motor_viscous_friction + n * n * d) / motor, n * d / motor],
            [k / link, n * d / link, -(p.link_viscous_friction + d) / link],
        ]
    )
    B = np.array([[0.0, 0.0], [1.0 / motor, 0.0], [0.0, 1.0 / link]])
    C = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return ContinuousStateSpace(A, B, C, np.zeros((2, 2)))


def coefficients(p: TwoInertia) -> tuple[FloatArray, FloatArray]:
    """Coefficients (b0, b1, b2) and (a0, a1, a2, a3) of (17).

    G11 = (b0 + b1 s + b2 s^2) / (a0 + a1 s + a2 s^2 + a3 s^3)
    """
    n2, k, d = p.gear_ratio**2, p.gear_stiffness, p.gear_damping
    motor, d_motor = p.motor_inertia, p.motor_viscous_friction
    link, d_link = p.link_inertia, p.link_viscous_friction
    b = np.array([1.0, (d_link + d) / k, link / k])
    a = np.array(
        [
            d_motor + n2 * d_link,
            motor + n2 * link + (n2 * d * d_link + d_motor * d_link + d_motor * d) / k,
            (motor * d_link + motor * d + link * d_motor + n2 * link * d) / k,
            motor * link / k,
        ]
    )
    return b, a


def from_coefficients(b: FloatArray, d: FloatArray, c: FloatArray, gear_ratio: float) -> TwoInertia:
    """Physical parameters from (18) in closed form.

        G11 = (1 + b1 s + b2 s^2) / ((c0 + c1 s)(1 + d1 s + d2 s^2))

    Comparison with (17) gives m_M = c1 d2 / b2, m_L = (c1 - m_M) / n^2, k = m_L / b2, and three
    linear equations for the dampings. `b` holds b1, b2 of the zeros, `d` holds d1, d2 of the pole
    pair, and `c` holds c0 = d_M + n^2 d_L, c1 = m_M + n^2 m_L of the rigid model. Negative results
    show that the coefficients do not belong to such a joint.
    """
    (b1, b2), (d1, d2), (c0, c1), n2 = b, d, c, gear_ratio**2
    motor = c1 * d2 / b2
    link = (c1 - motor) / n2
    k = link / b2
    A = b1 * k
    B = ((c1 * d1 + c0 * d2) * k - motor * A) / link
    return TwoInertia(
        motor_inertia=motor,
        motor_viscous_friction=(B + c0 - n2 * A) / 2.0,
        link_inertia=link,
        link_viscous_friction=(n2 * A - B + c0) / (2.0 * n2),
        gear_stiffness=k,
        gear_damping=(n2 * A + B - c0) / (2.0 * n2),
        gear_ratio=gear_ratio,
    )


def anti_resonance(p: TwoInertia, covariance: FloatArray | None = None) -> Mode:
    """Zero pair of motor torque to motor velocity.

    The covariance (6, 6) of the parameters gives its standard deviations.
    """
    return _mode(p, covariance, lambda q: coefficients(q)[0])


def resonance(p: TwoInertia, covariance: FloatArray | None = None) -> Mode:
    """Pole pair of motor torque to motor velocity.

    The covariance (6, 6) of the parameters gives its standard deviations.
    """
    return _mode(p, covariance, lambda q: coefficients(q)[1])


def _mode(
    p: TwoInertia, covariance: FloatArray | None, polynomial: Callable[[TwoInertia], FloatArray]
) -> Mode:
    """Mode of the least damped root of a polynomial of the parameters."""

    def frequency_and_damping(vector: FloatArray) -> FloatArray:
        root = _least_damped(polynomial(joint_of(vector, p.gear_ratio)))
        return np.array([abs(root) / (2.0 * np.pi), -root.real / abs(root)])

    root = _least_damped(polynomial(p))
    frequency, damping = frequency_and_damping(p.vector)
    std: list[float | None] = [None, None]
    if covariance is not None:
        J = jacobian(frequency_and_damping, p.vector)
        std = np.sqrt(np.clip(np.diag(J @ covariance @ J.T), 0.0, None)).tolist()
    return Mode(root, float(frequency), float(damping), std[0], std[1])


def _least_damped(ascending: FloatArray) -> complex:
    """Complex root of a polynomial with the smallest damping ratio, or else a real root."""
    roots = np.roots(ascending[::-1]).astype(np.complex128)
    candidates = roots[roots.imag > 0.0] if (roots.imag > 0.0).any() else roots
    moduli = np.maximum(np.abs(candidates), np.finfo(float).tiny)
    return complex(candidates[np.argmax(candidates.real / moduli)])


def jacobian(function: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Central differences with relative steps: (n_results, n_entries)."""
    columns = []
    for k in range(len(at)):
        step = np.zeros(len(at))
        step[k] = _RELATIVE_STEP * (abs(at[k]) or 1.0)
        columns.append((function(at + step) - function(at - step)) / (2.0 * step[k]))
    return np.column_stack(columns)
