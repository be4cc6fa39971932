"""A periodic motion of all joints that tells the rigid parameters apart as well as limits allow.

A Fourier series a joint (Swevers et al. 1997), chosen for the condition number of the rigid
regressor (5)-(7), every column scaled to one. Joint, velocity and voltage limits are not
constraints of the search: any series is made feasible by scaling, and what is searched over is its
shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.cores import one_blas_thread
from strainwave.design.plan import Limits
from strainwave.parameters import Values
from strainwave.records import FloatArray, Study
from strainwave.regressor import body_regressor, gear_ratios
from strainwave.simulation import build_arm, parameter_vector

HARMONICS = 8  # a period of eight seconds or more stays below 1 Hz
_GRID = 128  # points a period: 16 in the highest harmonic's
_DRAWN = 60  # random series, of which the best are starts
_ITERATIONS = 40
_CUTS = 3
_LEAST_SCALE = 1e-3  # where gravity alone takes the voltage: told apart by its poor condition
_STANDING = 0.01  # of the largest velocity, over which the sign of the friction is rounded
# What is left of each limit for the servo's error, the gears' vibration and the way in and out.
_SHARE_ANGLE, _SHARE_VELOCITY, _SHARE_VOLTAGE = 0.95, 0.90, 0.80

Motion = tuple[FloatArray, FloatArray, FloatArray]
"""(n_samples, n_joints) link angles, velocities, accelerations."""

Waves = tuple[FloatArray, FloatArray, FloatArray]
"""Rates of harmonics, their sines, their cosines."""


@dataclass(frozen=True, slots=True)
class Fourier:
    """q = offset + sum_k [s_k sin(k w t) - c_k cos(k w t)]/(k w), w = 2 pi/period."""

    period: float  # [s]
    offset: FloatArray  # (n_joints,) [rad]
    sine: FloatArray  # (n_harmonics, n_joints) [rad/s] s_k
    cosine: FloatArray  # (n_harmonics, n_joints) [rad/s] c_k

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

    Parameters
    ----------
    period : float [s]
    harmonics : int
    time : (n_samples,) [s]

    Returns
    -------
    (n_harmonics,), (n_samples, n_harmonics), (n_samples, n_harmonics)
    """
    rate: FloatArray = 2.0 * np.pi / period * np.arange(1, harmonics + 1, dtype=np.float64)
    angle = np.outer(time, rate)
    return rate, np.sin(angle), np.cos(angle)


def full_regressor(study: Study, motion: Motion) -> FloatArray:
    """Motor torques per unknown of the rigid model, friction included: (5)-(7).

    The direction of sliding is rounded over a hundredth of the largest velocity, so that a search
    can follow it.

    Parameters
    ----------
    study : Study
    motion : tuple of (n_samples, n_joints)

    Returns
    -------
    (n_samples, n_joints, n_unknowns)
        Columns as in `strainwave.regressor.columns_of`.
    """
    velocity = motion[1] / gear_ratios(study)
    parts = [body_regressor(study, *motion)]
    for i in range(study.n_joints):
        friction = np.zeros((*velocity.shape, 3))
        rounded = _STANDING * max(float(np.abs(velocity[:, i]).max()), 1e-12)
        friction[:, i, 0] = velocity[:, i]
        friction[:, i, 1] = np.tanh(velocity[:, i] / rounded)
        friction[:, i, 2] = 1.0
        parts.append(friction)
    return np.concatenate(parts, axis=2)


def condition_number(study: Study, limits: Limits, motion: Motion) -> float:
    """How well a motion tells the rigid parameters apart; one is best.

    Rows are torques in shares of what each drive can give, columns are scaled to one: it depends
    on no unit and on no parameter's size.

    Parameters
    ----------
    study : Study
    limits : Limits
    motion : tuple of (n_samples, n_joints)

    Returns
    -------
    float
    """
    strongest = np.array(limits.voltage) * torque_per_volt(study)
    rows = full_regressor(study, motion) / strongest[:, None]
    rows = rows.reshape(-1, rows.shape[2])
    norms = np.linalg.norm(rows, axis=0)
    if norms.min() <= 0.0:
        return float("inf")
    values = np.linalg.svd(rows / norms, compute_uv=False)
    return float(values[0] / max(values[-1], 1e-300))


def torque_per_volt(study: Study) -> FloatArray:
    """e, or one where torque is commanded: (n_joints,)."""
    return np.array([joint.torque_per_volt or 1.0 for joint in study.joints])


def optimised(
    study: Study, values: Values, limits: Limits, *, period: float, starts: int, seed: int
) -> tuple[Fourier, ...]:
    """Motions of low condition number within the limits, the best first.

    Parameters
    ----------
    study : Study
    values : dict
        (name, joint) -> value of the guessed arm, for its voltages.
    limits : Limits
    period : float [s]
    starts : int
        Searches, each from another of the best of many random series.
    seed : int

    Returns
    -------
    tuple of Fourier
        One a start.
    """
    from scipy.optimize import minimize

    search = Search(study, values, limits, period)
    rng = np.random.default_rng(seed)
    with one_blas_thread():
        drawn = rng.normal(size=(_DRAWN, search.n_unknowns))
        first = sorted(drawn, key=search.cost)[:starts]
        ended = [
            minimize(search.cost, x, method="L-BFGS-B", options={"maxiter": _ITERATIONS})
            for x in first
        ]
    return tuple(search.series(found.x) for found in sorted(ended, key=lambda found: found.fun))


class Search:
    """Shapes as points without constraints.

    Parameters
    ----------
    study : Study
    values : dict
    limits : Limits
    period : float [s]
    """

    def __init__(self, study: Study, values: Values, limits: Limits, period: float) -> None:
        self.study, self.limits, self.period = study, limits, period
        self.arm = build_arm(study)
        self.vector = parameter_vector(self.arm, values, study)
        self.time: FloatArray = period / _GRID * np.arange(_GRID, dtype=np.float64)
        self.waves = waves(period, HARMONICS, self.time)
        self.n_unknowns = study.n_joints * (2 * HARMONICS + 1)

    def cost(self, point: FloatArray) -> float:
        """Logarithm of the condition number of the feasible series that a point stands for."""
        return float(np.log(condition_number(self.study, self.limits, self.motion_of(point))))

    def motion_of(self, point: FloatArray) -> Motion:
        """One period of the series that a point stands for."""
        return self.series(point).of(self.waves)

    def series(self, point: FloatArray) -> Fourier:
        """The largest feasible series of a point's shape and centre.

        Parameters
        ----------
        point : (n_joints * (2 * harmonics + 1),)
            Per joint its centre, through tanh, and the shape's coefficients.

        Returns
        -------
        Fourier
        """
        table = point.reshape(-1, self.study.n_joints)
        most = _SHARE_ANGLE * np.array(self.limits.angle)
        offset = 0.8 * most * np.tanh(table[0])
        shape = Fourier(
            self.period, np.zeros_like(offset), table[1 : HARMONICS + 1], table[HARMONICS + 1 :]
        )
        angle, velocity, _ = shape.of(self.waves)
        fastest = _SHARE_VELOCITY * np.array(self.limits.velocity) * gear_ratios(self.study)
        room = np.minimum((most - offset) / angle.max(0), (most + offset) / -angle.min(0))
        largest = np.minimum(room, fastest / np.abs(velocity).max(0))
        whole = Fourier(self.period, offset, shape.sine, shape.cosine).scaled(largest)
        return whole.scaled(self._voltage_factor(whole))

    def _voltage_factor(self, series: Fourier) -> float:
        """What a series must be scaled by to be within the voltage limits.

        Nearly straight in the scale, and curving upward: false position comes from below.
        """
        high, above = 1.0, self.voltage_use(series.of(self.waves))
        if above <= 1.0:
            return 1.0
        low, below = 0.0, self.voltage_use(series.scaled(0.0).of(self.waves))
        for _ in range(_CUTS):
            if below >= 1.0:
                break
            middle = low + (1.0 - below) / (above - below) * (high - low)
            use = self.voltage_use(series.scaled(middle).of(self.waves))
            if use <= 1.0:
                low, below = middle, use
            else:
                high, above = middle, use
        return max(low, _LEAST_SCALE)

    def voltage_use(self, motion: Motion) -> float:
        """Share that a motion of the rigid arm takes of what the drives may give it."""
        torque = self.arm.inverse_dynamics(self.vector, *(np.ascontiguousarray(x) for x in motion))
        given = _SHARE_VOLTAGE * np.array(self.limits.voltage) * torque_per_volt(self.study)
        return float((np.abs(torque) / given).max())

    def within(self, motion: Motion) -> bool:
        """Whether a motion keeps to all limits, with something to spare."""
        fastest = _SHARE_VELOCITY * np.array(self.limits.velocity) * gear_ratios(self.study)
        near = np.abs(motion[0]).max(0) <= _SHARE_ANGLE * np.array(self.limits.angle) + 1e-12
        slow = np.abs(motion[1]).max(0) <= fastest + 1e-12
        return bool(near.all() and slow.all()) and self.voltage_use(motion) <= 1.0 + 1e-9
