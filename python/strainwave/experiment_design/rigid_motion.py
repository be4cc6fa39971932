"""A periodic motion of all joints that separates the rigid parameters as well as limits allow.

A Fourier series a joint (Swevers et al. 1997), chosen for the condition number of the rigid
regressor (5)-(7), every column scaled to one. Joint, velocity and voltage limits are not
constraints of the search: any series is made feasible by scaling, and what is searched over is its
shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.experiment_design.plan import Limits
from strainwave.numerics.parallel import one_blas_thread

HARMONICS = 8  # a period of eight seconds or more stays below 1 Hz
_GRID = 128  # points a period: 16 in the highest harmonic's
_DRAWN = 60  # random series, of which the best are starts
_ITERATIONS = 40
_STEP = 1e-8  # of forward differences of a cost near one: the root of the rounding
_CUTS = 3
_LEAST_SCALE = 1e-3  # where gravity alone takes the voltage: recognised by its poor condition
_STANDING = 0.01  # of the largest velocity, over which the sign of the friction is rounded
# The share of each limit for the servo's error, the gears' vibration and the way in and out.
_SHARE_ANGLE, _SHARE_VELOCITY, _SHARE_VOLTAGE = 0.95, 0.90, 0.80

Motion = tuple[FloatArray, FloatArray, FloatArray]
"""(n_samples, n_joints) link angles, velocities, accelerations."""

Waves = tuple[FloatArray, FloatArray, FloatArray]
"""Rates of harmonics, their sines, their cosines."""


@dataclass(frozen=True, slots=True)
class Fourier:
    """q = offset + sum_k [s_k sin(k w t) - c_k cos(k w t)]/(k w), w = 2 pi/period."""

    period: float  # [s]
    offset: FloatArray  # (..., 1, n_joints) [rad]
    sine: FloatArray  # (..., n_harmonics, n_joints) [rad/s] s_k
    cosine: FloatArray  # (..., n_harmonics, n_joints) [rad/s] c_k

    def at(self, time: FloatArray) -> Motion:
        """Link angles, velocities and accelerations at given times."""
        return self.of(waves(self.period, len(self.sine), time))

    def of(self, basis: Waves) -> Motion:
        """The same where the series' waves are at hand, as `waves` gives them."""
        rate, sine, cosine = basis
        angle = (sine / rate) @ self.sine - (cosine / rate) @ self.cosine
        velocity = cosine @ self.sine + sine @ self.cosine
        acceleration = (cosine * rate) @ self.cosine - (sine * rate) @ self.sine
        return self.offset + angle, velocity, acceleration

    def scaled(self, factor: float | FloatArray) -> Fourier:
        """The same shape about the same centre, larger or smaller."""
        return Fourier(self.period, self.offset, factor * self.sine, factor * self.cosine)


def waves(period: float, harmonics: int, time: FloatArray) -> Waves:
    """Rates (n_harmonics,) [rad/s] of a period's harmonics, their sines and cosines at given times.

    `period` [s]. `time` (n_samples,) [s]. Returns (n_harmonics,).
    """
    rate: FloatArray = 2.0 * np.pi / period * np.arange(1, harmonics + 1, dtype=np.float64)
    angle = np.outer(time, rate)
    return rate, np.sin(angle), np.cos(angle)


def full_regressor(arm: Arm, motion: Motion) -> FloatArray:
    """Motor torques per unknown of the rigid model, friction included: (5)-(7).

    The direction of sliding is rounded over a hundredth of the largest velocity, so that a search
    can follow it.

    Returns: Columns as in `Arm.rigid_columns`.
    """
    velocity = motion[1] / arm.gear_ratios
    n = arm.n_joints
    bodies = arm.rigid_regressor(*(x.reshape(-1, n) for x in motion))
    parts = [bodies.reshape(*velocity.shape, bodies.shape[-1])]
    for i in range(n):
        friction = np.zeros((*velocity.shape, 3))
        of_it = velocity[..., i]
        rounded = _STANDING * np.maximum(np.abs(of_it).max(axis=-1, keepdims=True), 1e-12)
        friction[..., i, 0] = of_it
        friction[..., i, 1] = np.tanh(of_it / rounded)
        friction[..., i, 2] = 1.0
        parts.append(friction)
    return np.concatenate(parts, axis=-1)


def condition_number(arm: Arm, limits: Limits, motion: Motion) -> FloatArray:
    """How well motions separate the rigid parameters; one is best.

    Rows are torques in shares of what each drive can give, columns are scaled to one: it depends
    on no unit and on no parameter's size.
    """
    strongest = np.array(limits.voltage) * arm.torque_per_volt
    rows = full_regressor(arm, motion) / strongest[:, None]
    rows = rows.reshape(*rows.shape[:-3], -1, rows.shape[-1])
    norms = np.linalg.norm(rows, axis=-2, keepdims=True)
    values = np.linalg.svd(rows / np.maximum(norms, 1e-300), compute_uv=False)
    excited = norms.min(axis=(-2, -1)) > 0.0
    return np.where(excited, values[..., 0] / np.maximum(values[..., -1], 1e-300), np.inf)


def optimised(
    arm: Arm, values: Values, limits: Limits, *, period: float, starts: int, seed: int
) -> tuple[Fourier, ...]:
    """Motions of low condition number within the limits, the best first.

    `values`: (name, joint) -> value of the guessed arm, for its voltages. `period` [s]. `starts`:
    Searches, each from another of the best of many random series. Returns: One a start.
    """
    from scipy.optimize import minimize

    search = Search(arm, values, limits, period)
    rng = np.random.default_rng(seed)
    with one_blas_thread():
        drawn = rng.normal(size=(_DRAWN, search.n_unknowns))
        first = drawn[np.argsort(search.cost(drawn))][:starts]
        ended = [
            minimize(
                search.with_gradient,
                x,
                jac=True,
                method="L-BFGS-B",
                options={"maxiter": _ITERATIONS},
            )
            for x in first
        ]
    return tuple(search.series(found.x) for found in sorted(ended, key=lambda found: found.fun))


class Search:
    """Shapes as points without constraints.

    `period` [s].
    """

    def __init__(self, arm: Arm, values: Values, limits: Limits, period: float) -> None:
        self.arm, self.limits, self.period = arm, limits, period
        self.vector = arm.parameter_vector(values)
        self.time: FloatArray = period / _GRID * np.arange(_GRID, dtype=np.float64)
        self.waves = waves(period, HARMONICS, self.time)
        self.n_unknowns = arm.n_joints * (2 * HARMONICS + 1)

    def cost(self, points: FloatArray) -> FloatArray:
        """Logarithm of the condition number of the feasible series that points stand for."""
        return np.log(condition_number(self.arm, self.limits, self.motion_of(points)))

    def with_gradient(self, point: FloatArray) -> tuple[float, FloatArray]:
        """Cost of one point and its forward differences, all at once."""
        costs = self.cost(np.vstack([point, point + _STEP * np.eye(len(point))]))
        return float(costs[0]), (costs[1:] - costs[0]) / _STEP

    def motion_of(self, points: FloatArray) -> Motion:
        """One period of the series that each point stands for: three (..., n_samples, n_joints)."""
        return self._feasible(points)[1]

    def series(self, point: FloatArray) -> Fourier:
        """The largest feasible series of a point's shape and centre.

        `point` (n_joints * (2 * harmonics + 1): Per joint its centre, through tanh, and the shape's
        coefficients.
        """
        shape, _, scale = self._feasible(point)
        return shape.scaled(scale)

    def _feasible(self, points: FloatArray) -> tuple[Fourier, Motion, FloatArray]:
        """Shapes, their feasible motions, and the joints' scales (..., 1, n_joints) from these."""
        n = self.arm.n_joints
        table = points.reshape(*points.shape[:-1], -1, n)
        most = _SHARE_ANGLE * np.array(self.limits.angle)
        offset = 0.8 * most * np.tanh(table[..., :1, :])
        sine, cosine = table[..., 1 : HARMONICS + 1, :], table[..., HARMONICS + 1 :, :]
        angle, velocity, acceleration = Fourier(
            self.period, np.zeros_like(offset), sine, cosine
        ).of(self.waves)
        fastest = _SHARE_VELOCITY * np.array(self.limits.velocity) * self.arm.gear_ratios
        highest, lowest = (f(angle, axis=-2, keepdims=True) for f in (np.max, np.min))
        room = np.minimum((most - offset) / highest, (most + offset) / -lowest)
        scale = np.minimum(room, fastest / np.abs(velocity).max(axis=-2, keepdims=True))
        moving = (scale * angle, scale * velocity, scale * acceleration)
        factor = self._voltage_factor(offset, moving)
        motion = offset + factor * moving[0], factor * moving[1], factor * moving[2]
        return Fourier(self.period, offset, sine, cosine), motion, factor * scale

    def _voltage_factor(self, offset: FloatArray, moving: Motion) -> FloatArray:
        """What series must be scaled by to be within the voltage limits: (..., 1, 1).

        Nearly straight in the scale, and curving upward: false position comes from below.
        """

        def use(factor: FloatArray) -> FloatArray:
            angle, velocity, acceleration = (factor * x for x in moving)
            return self.voltage_use((offset + angle, velocity, acceleration))[..., None, None]

        high = np.ones((*moving[0].shape[:-2], 1, 1))
        above = use(high)
        if (above <= 1.0).all():
            return high
        whole, low = above <= 1.0, np.zeros_like(high)
        below = use(low)
        held = below < 1.0
        for _ in range(_CUTS):
            slope = np.where(held & ~whole, (above - below) / (high - low), np.inf)
            middle = low + (1.0 - below) / slope
            used = use(middle)
            fits = held & (used <= 1.0)
            low, below = np.where(fits, middle, low), np.where(fits, used, below)
            high, above = np.where(fits, high, middle), np.where(fits, above, used)
        return np.where(whole, 1.0, np.maximum(low, _LEAST_SCALE))

    def voltage_use(self, motion: Motion) -> FloatArray:
        """Share that motions of the rigid arm take of what the drives may give it: (...)."""
        shape = motion[0].shape
        rows = (x.reshape(-1, shape[-1]) for x in motion)
        torque = self.arm.inverse_dynamics(self.vector, *rows).reshape(shape)
        given = _SHARE_VOLTAGE * np.array(self.limits.voltage) * self.arm.torque_per_volt
        return np.asarray((np.abs(torque) / given).max(axis=(-2, -1)))

    def within(self, motion: Motion) -> bool:
        """Whether a motion keeps to all limits, with something to spare."""
        fastest = _SHARE_VELOCITY * np.array(self.limits.velocity) * self.arm.gear_ratios
        near = np.abs(motion[0]).max(0) <= _SHARE_ANGLE * np.array(self.limits.angle) + 1e-12
        slow = np.abs(motion[1]).max(0) <= fastest + 1e-12
        return bool(near.all() and slow.all()) and bool(self.voltage_use(motion) <= 1.0 + 1e-9)
