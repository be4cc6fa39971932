"""Periodic motion of all joints that separates the rigid parameters as well as the limits allow.

Each joint follows a Fourier series (Swevers et al. 1997) that minimises the condition number of the
rigid regressor (5)-(7) with scaled columns. The limits of angle, velocity and voltage are not
constraints of the search: each series is scaled until it satisfies them, and the search varies its
shape.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, Parameter
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.parameters import complete_values
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.excite.guessed_arm import GuessedArm, smallest_distance
from strainwave.excite.plan import Limits, Motion, clock_of
from strainwave.numerics.parallel import one_blas_thread, run_parallel

LOW_PASS_RATIO = 5.0
"""Bandwidth of the rigid step over the highest frequency of the motion."""

N_HARMONICS = 8  # a period of 8 s or more stays below 1 Hz
_N_SAMPLES = 128  # per period: 16 per period of the highest harmonic
_N_RANDOM_SERIES = 60  # the best of them are starting values
_MAX_ITERATIONS = 40  # of each search
_DIFFERENCE_STEP = 1e-8  # of forward differences: square root of the rounding error
_N_SECANT_STEPS = 3  # of the scale that satisfies the voltage limits
_MIN_SCALE = 1e-3  # if gravity alone takes the voltage; the poor condition number shows it
_FRICTION_SMOOTHING = 0.01  # of the largest velocity, over which the sign of friction changes
_MAX_OFFSET_SHARE = 0.8  # of the angle limit for the centre of a series
# Usable share of each limit. Servo error, vibration and the lead-in take the rest.
_ANGLE_SHARE, _VELOCITY_SHARE, _VOLTAGE_SHARE = 0.95, 0.90, 0.80
_DISTANCE_FACTOR = 1.1  # distance between links at which the search aims, over its limit
_DISTANCE_WEIGHT = 100.0  # 10 % less than that distance costs as much as e times the condition


@dataclass(frozen=True, slots=True)
class Fourier:
    """Fourier series of the link angles, w = 2 pi/period.

    q = offset + sum_k [s_k sin(k w t) - c_k cos(k w t)]/(k w)
    """

    period: float  # [s]
    offset: FloatArray  # (..., 1, n_joints) [rad]
    sine: FloatArray  # (..., n_harmonics, n_joints) [rad/s] s_k
    cosine: FloatArray  # (..., n_harmonics, n_joints) [rad/s] c_k

    def at(self, time: FloatArray) -> Motion:
        """Motion at given times."""
        return self.of(*waves(self.period, len(self.sine), time))

    def of(self, rate: FloatArray, sine: FloatArray, cosine: FloatArray) -> Motion:
        """Motion from precomputed `waves`."""
        angle = (sine / rate) @ self.sine - (cosine / rate) @ self.cosine
        velocity = cosine @ self.sine + sine @ self.cosine
        acceleration = (cosine * rate) @ self.cosine - (sine * rate) @ self.sine
        return self.offset + angle, velocity, acceleration

    def scaled(self, factor: float | FloatArray) -> Fourier:
        """The same shape around the same centre with another size."""
        return Fourier(self.period, self.offset, factor * self.sine, factor * self.cosine)


def waves(
    period: float, harmonics: int, time: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angular frequencies (n_harmonics,) [rad/s] of a period, their sines and cosines at `time`."""
    rate: FloatArray = 2.0 * np.pi / period * np.arange(1, harmonics + 1, dtype=np.float64)
    angle = np.outer(time, rate)
    return rate, np.sin(angle), np.cos(angle)


def full_regressor(arm: Arm, motion: Motion) -> FloatArray:
    """Motor torques per unknown of the rigid model, friction included, (5)-(7).

    Columns are those of `Arm.rigid_columns`. The sign of the velocity changes smoothly over 1 % of
    the largest velocity, so that the condition number is differentiable.
    """
    velocity = arm.motor_accelerations(motion[1])
    n = arm.n_joints
    bodies = arm.rigid_regressor(*(x.reshape(-1, n) for x in motion))
    parts = [bodies.reshape(*velocity.shape, bodies.shape[-1])]
    for i in range(n):
        friction = np.zeros((*velocity.shape, 3))
        rate = velocity[..., i]
        largest = np.maximum(np.abs(rate).max(axis=-1, keepdims=True), 1e-12)
        friction[..., i, 0] = rate
        friction[..., i, 1] = np.tanh(rate / (_FRICTION_SMOOTHING * largest))
        friction[..., i, 2] = 1.0
        parts.append(friction)
    parts.append(arm.shared_friction_regressor(velocity))
    return np.concatenate(parts, axis=-1)


def condition_number(arm: Arm, limits: Limits, motion: Motion) -> FloatArray:
    """Condition number of the rigid regressor for motions; 1 is best.

    Infinite if a column is zero.
    """
    rows = scaled_regressor(arm, limits, motion)
    values = np.linalg.svd(rows, compute_uv=False)
    is_excited = np.abs(rows).max(axis=-2).min(axis=-1) > 0.0
    return np.where(is_excited, values[..., 0] / np.maximum(values[..., -1], 1e-300), np.inf)


def scaled_regressor(arm: Arm, limits: Limits, motion: Motion) -> FloatArray:
    """Rigid regressor of motions, (..., n_samples * n_joints, n_columns).

    Rows are torques over the largest torque of each drive, and columns have norm one, so that the
    condition number does not depend on units or on the sizes of the parameters.
    """
    largest_torque = np.array(limits.voltage) * arm.torque_per_volt
    rows = full_regressor(arm, motion) / largest_torque[:, None]
    rows = rows.reshape(*rows.shape[:-3], -1, rows.shape[-1])
    norms = np.linalg.norm(rows, axis=-2, keepdims=True)
    return np.asarray(rows / np.maximum(norms, 1e-300))


def optimise(search: MotionSearch, starts: int, seed: int) -> tuple[Fourier, ...]:
    """Motions of low condition number within the limits, one per start, the best first.

    Each search starts from one of the best of many random series.
    """
    from scipy.optimize import minimize

    rng = np.random.default_rng(seed)
    options = {"maxiter": _MAX_ITERATIONS}
    search_from = partial(
        minimize, search.with_gradient, jac=True, method="L-BFGS-B", options=options
    )
    with one_blas_thread():
        candidates = rng.normal(size=(_N_RANDOM_SERIES, search.n_unknowns))
        best = candidates[np.argsort(search.cost(candidates))][:starts]
        results = run_parallel([partial(search_from, x) for x in best])
    return tuple(search.feasible(r.x)[0] for r in sorted(results, key=lambda result: result.fun))


class MotionSearch:
    """Unconstrained search space of series with a period [s].

    A point holds the centre, through tanh, and the coefficients of each joint: n_joints * (2 *
    harmonics + 1) numbers.
    """

    def __init__(self, guess: GuessedArm, period: float) -> None:
        self.guess, self.period = guess, period
        self.arm, self.values, self.limits = guess.arm, guess.values, guess.limits
        self.vector = self.arm.parameter_vector(self.values)
        self.time: FloatArray = period / _N_SAMPLES * np.arange(_N_SAMPLES, dtype=np.float64)
        self.waves = waves(period, N_HARMONICS, self.time)
        self.n_unknowns = self.arm.n_joints * (2 * N_HARMONICS + 1)

    def cost(self, points: FloatArray) -> FloatArray:
        """Logarithm of the condition numbers of the feasible series of points."""
        motion = self.feasible(points)[1]
        return np.log(condition_number(self.arm, self.limits, motion)) + self._nearness(motion)

    def _nearness(self, motion: Motion) -> FloatArray:
        """Cost of links that come too near to each other: (...)."""
        limit = _DISTANCE_FACTOR * self.limits.distance
        if limit == 0.0:
            return np.zeros(motion[0].shape[:-2])
        distance = smallest_distance(self.arm, self.values, motion[0], self.limits.distance)
        missing = np.maximum(0.0, 1.0 - distance.min(axis=-1) / limit)
        return np.asarray(_DISTANCE_WEIGHT * missing**2)

    def with_gradient(self, point: FloatArray) -> tuple[float, FloatArray]:
        """Cost of a point and its forward differences, in one evaluation.

        The differences of the regressor A give those of its singular values, u' dA v, so that one
        decomposition suffices.
        """
        _, motion = self.feasible(np.vstack([point, point + _DIFFERENCE_STEP * np.eye(len(point))]))
        rows, nearness = scaled_regressor(self.arm, self.limits, motion), self._nearness(motion)
        left, values, right = np.linalg.svd(rows[0], full_matrices=False)
        largest, smallest = values[0], max(float(values[-1]), 1e-300)
        products = rows @ right[[0, -1]].T  # A v of the largest and the smallest one
        moved = np.einsum("prk,rk->pk", products, left[:, [0, -1]])
        slopes = (moved[1:] - moved[0]) / [largest, smallest]
        costs = slopes[:, 0] - slopes[:, 1] + nearness[1:] - nearness[0]
        return float(np.log(largest / smallest) + nearness[0]), costs / _DIFFERENCE_STEP

    def feasible(self, points: FloatArray) -> tuple[Fourier, Motion]:
        """Largest feasible series of points, and one period: arrays (..., n_samples, n_joints)."""
        n = self.arm.n_joints
        table = points.reshape(*points.shape[:-1], -1, n)
        limit = _ANGLE_SHARE * np.array(self.limits.angle)
        shift = _MAX_OFFSET_SHARE * limit * np.tanh(table[..., :1, :])
        offset = self.limits.centre + shift
        sine, cosine = table[..., 1 : N_HARMONICS + 1, :], table[..., N_HARMONICS + 1 :, :]
        centred = Fourier(self.period, np.zeros_like(offset), sine, cosine)
        angle, velocity, acceleration = centred.of(*self.waves)
        fastest = self.arm.link_velocity_limits(_VELOCITY_SHARE * np.array(self.limits.velocity))
        highest, lowest = (f(angle, axis=-2, keepdims=True) for f in (np.max, np.min))
        room = np.minimum((limit - shift) / highest, (limit + shift) / -lowest)
        scale = np.minimum(room, fastest / np.abs(velocity).max(axis=-2, keepdims=True))
        scaled = (scale * angle, scale * velocity, scale * acceleration)
        factor = self._voltage_factor(offset, scaled)
        motion = offset + factor * scaled[0], factor * scaled[1], factor * scaled[2]
        return replace(centred.scaled(factor * scale), offset=offset), motion

    def _voltage_factor(self, offset: FloatArray, motion: Motion) -> FloatArray:
        """Factor (..., 1, 1) with which series satisfy the voltage limits.

        The voltage is nearly linear in the factor and convex, so the method of false position
        converges from below.
        """

        def use(factor: FloatArray) -> FloatArray:
            angle, velocity, acceleration = (factor * x for x in motion)
            return self.voltage_use((offset + angle, velocity, acceleration))[..., None, None]

        high = np.ones((*motion[0].shape[:-2], 1, 1))
        above = use(high)
        if (above <= 1.0).all():
            return high
        is_feasible, low = above <= 1.0, np.zeros_like(high)
        below = use(low)
        is_holdable = below < 1.0
        for _ in range(_N_SECANT_STEPS):
            slope = np.where(is_holdable & ~is_feasible, (above - below) / (high - low), np.inf)
            middle = low + (1.0 - below) / slope
            value = use(middle)
            fits = is_holdable & (value <= 1.0)
            low, below = np.where(fits, middle, low), np.where(fits, value, below)
            high, above = np.where(fits, high, middle), np.where(fits, above, value)
        return np.where(is_feasible, 1.0, np.maximum(low, _MIN_SCALE))

    def voltage_use(self, motion: Motion) -> FloatArray:
        """Largest voltage of motions of the rigid arm over the usable limit: (...)."""
        shape = motion[0].shape
        rows = (x.reshape(-1, shape[-1]) for x in motion)
        torque = self.arm.inverse_dynamics(self.vector, *rows).reshape(shape)
        available = _VOLTAGE_SHARE * np.array(self.limits.voltage) * self.arm.torque_per_volt
        return np.asarray((np.abs(torque) / available).max(axis=(-2, -1)))

    def within(self, motion: Motion) -> bool:
        """Whether a motion satisfies all limits with a margin."""
        fastest = self.arm.link_velocity_limits(_VELOCITY_SHARE * np.array(self.limits.velocity))
        moved = np.abs(motion[0] - self.limits.centre).max(0)
        is_near = moved <= _ANGLE_SHARE * np.array(self.limits.angle) + 1e-12
        is_slow = np.abs(motion[1]).max(0) <= fastest + 1e-12
        if not (is_near.all() and is_slow.all()):
            return False
        return bool(self.voltage_use(motion) <= 1.0 + 1e-9)


def standard_deviations(
    search: MotionSearch, motion: Motion, top_hz: float, torque_errors: FloatArray | float = 0.0
) -> FloatArray:
    """Standard deviations of `Arm.rigid_columns` after one period of a motion.

    The encoder's rounding has the variance q^2/12 at each tick. After the rigid step's low-pass B
    it becomes an error of the acceleration with variance (2 pi)^4 B^5/5 S, S = 2 tick q^2/12.
    Multiplied by the rigid inertia it is an error of the torque, independent 2 B times per second.
    `torque_errors` (n_joints,) are further errors of the torques over their rms values. `motion`
    has one period of `search`, `top_hz` is its highest frequency. Infinite for parameters that the
    motion does not determine.
    """
    arm = search.arm
    bandwidth = LOW_PASS_RATIO * top_hz
    rounding = np.array([joint.encoder_resolution for joint in arm.joints])
    density = 2.0 * clock_of(arm) * rounding**2 / 12.0
    acceleration = np.sqrt((2.0 * np.pi) ** 4 * bandwidth**5 / 5.0 * density)
    torque = arm.inverse_dynamics(search.vector, *motion)
    further = torque_errors * np.sqrt(np.mean(torque**2, axis=0))
    n = arm.n_joints
    rest, of_motors = np.zeros((n, n)), arm.links_of(np.eye(n))
    accelerated = arm.inverse_dynamics(search.vector, rest, rest, of_motors)
    static = arm.inverse_dynamics(search.vector, rest, rest, rest)
    error = np.hypot(np.diagonal(accelerated - static) * acceleration, further)
    rows = full_regressor(arm, motion) / error[:, None]
    n_independent = 2.0 * bandwidth * search.period
    rows = rows.reshape(-1, rows.shape[2]) * np.sqrt(n_independent / len(motion[0]))
    norms = np.linalg.norm(rows, axis=0)
    scale = np.where(norms > 0.0, norms, 1.0)
    _, singular, directions = np.linalg.svd(rows / scale, full_matrices=False)
    with np.errstate(divide="ignore"):
        return np.asarray(np.linalg.norm(directions / singular[:, None], axis=0) / scale)


def predicted_rigid_parameters(arm: Arm, values: Values, std: FloatArray) -> Iterator[Parameter]:
    """The guessed rigid parameters with their predicted intervals."""
    known = complete_values(values, arm)
    for column, each in zip(arm.rigid_columns, std.tolist(), strict=True):
        parts = {key: weight for key, weight in column.parts.items() if key in known}
        value = value_of(parts, known)
        if np.isfinite(each):
            yield Parameter.estimated(column.key, value, each, column.unit, "rigid")
        else:
            yield Parameter(*column.key, None, None, column.unit, "rigid")


def reference_sizes(arm: Arm, values: Values) -> dict[int, float]:
    """Sizes by which standard deviations are judged, by column; parameters of size zero have none.

    They are the guessed magnitudes. Base parameters that combine parameters of links may be nearly
    zero, so the largest of the same unit counts.
    """
    sizes = [abs(values.get(column.key, 0.0)) for column in arm.rigid_columns]
    if arm.base.has_groups:
        known = complete_values(values, arm)
        columns = arm.base.columns
        of_base = [abs(value_of(column.parts, known)) for column in columns]
        for k, column in enumerate(columns):
            pairs = zip(of_base, columns, strict=True)
            sizes[k] = max(size for size, other in pairs if other.unit == column.unit)
    return {k: size for k, size in enumerate(sizes) if size > 0.0}
