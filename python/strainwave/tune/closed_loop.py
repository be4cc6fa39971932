"""Control laws of joints, and arms under them as linear systems in discrete time.

Responses of plants to a sampled servo: hold, computation delay, current loop, aliasing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.linalg import expm

from strainwave.domain import BoolArray, ComplexArray, ControlLaw, FloatArray, IntArray
from strainwave.domain.keys import JointIndex
from strainwave.numerics.linalg import eigenvalues
from strainwave.numerics.parallel import run_parallel
from strainwave.tune.margins import band_over
from strainwave.tune.plants import Plants, PoleSums, Resonances

_N_ALIASES = 3  # of each sign; their share falls with the third power of the frequency
_POINTS_PER_DECADE = 40
_POINTS_PER_RESONANCE = 24  # over three half-power bandwidths
_LOWEST_HZ = 0.05
_PART = 100  # plants

POLE_TOLERANCE = 1e-6
"""Rounding of the pole at one of a servo without a position loop."""

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Biquad:
    """Second-order filter (b0 + b1 z^-1 + b2 z^-2) / (1 + a1 z^-1 + a2 z^-2)."""

    b: tuple[float, float, float]
    a: tuple[float, float]
    kind: str  # "notch" or "low-pass"
    frequency_hz: float  # of centre or corner
    width: float = 0.0  # damping ratio of the poles
    depth: float = 0.0  # gain at the centre

    def response(self, z: ComplexArray) -> ComplexArray:
        """Response at points of the unit circle."""
        w = 1.0 / z
        numerator = self.b[0] + self.b[1] * w + self.b[2] * w**2
        return np.asarray(numerator / (1.0 + self.a[0] * w + self.a[1] * w**2))


def notch(frequency_hz: float, width: float, depth: float, period: float) -> Biquad:
    """Notch (s^2 + 2 depth width w s + w^2) / (s^2 + 2 width w s + w^2), sampled.

    The bilinear transformation is warped so that the centre is exact.
    """
    c = 1.0 / math.tan(math.pi * frequency_hz * period)
    low, high = 2.0 * width * c, 2.0 * depth * width * c
    scale = c * c + low + 1.0
    b = ((c * c + high + 1.0) / scale, 2.0 * (1.0 - c * c) / scale, (c * c - high + 1.0) / scale)
    a = (2.0 * (1.0 - c * c) / scale, (c * c - low + 1.0) / scale)
    return Biquad(b, a, "notch", frequency_hz, width, depth)


def low_pass(frequency_hz: float, period: float) -> Biquad:
    """Second-order Butterworth low-pass, sampled by the warped bilinear transformation."""
    c = 1.0 / math.tan(math.pi * frequency_hz * period)
    scale = c * c + math.sqrt(2.0) * c + 1.0
    b = (1.0 / scale, 2.0 / scale, 1.0 / scale)
    a = (2.0 * (1.0 - c * c) / scale, (c * c - math.sqrt(2.0) * c + 1.0) / scale)
    return Biquad(b, a, "low-pass", frequency_hz)


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of a cascade: PI velocity loop, and a position loop around it."""

    kp: float  # [V s/rad]
    ki: float  # [V/rad]
    position_gain: float  # [1/s]
    period: float  # [s]
    filters: tuple[Biquad, ...] = ()

    def slowed(self, share: float) -> Gains:
        """Gains of a share of the bandwidth, with the same ratios of all corner frequencies."""
        kp, ki = share * self.kp, share**2 * self.ki
        return replace(self, kp=kp, ki=ki, position_gain=share * self.position_gain)

    def law(self) -> ControlLaw:
        """The cascade u = F(z) (kp e + ki T sum e), e = w + K (r - y) - (y_k - y_k-1) / T."""
        T, n = self.period, 2 + 2 * len(self.filters)
        A, B, E = np.zeros((n, n)), np.zeros((n, 3)), np.zeros(n)
        names = ["last_angle", "integral"]
        B[0, 2] = 1.0  # the last angle
        error_x = np.zeros(n)
        error_x[0] = 1.0 / T
        error_u = np.array([self.position_gain, 1.0, -self.position_gain - 1.0 / T])
        A[1] += T * error_x
        A[1, 1] += 1.0
        B[1] = T * error_u
        signal_x = self.kp * error_x + self.ki * A[1]
        signal_u = self.kp * error_u + self.ki * B[1]
        for k, one in enumerate(self.filters):
            first, second = 2 + 2 * k, 3 + 2 * k
            names += [f"{one.kind} {k + 1}, {i}" for i in (1, 2)]
            # transposed direct form II: y = b0 s + x1, x1+ = b1 s - a1 y + x2, x2+ = b2 s - a2 y
            output_x, output_u = one.b[0] * signal_x, one.b[0] * signal_u
            output_x[first] += 1.0
            A[first] = one.b[1] * signal_x - one.a[0] * output_x
            A[first, second] += 1.0
            B[first] = one.b[1] * signal_u - one.a[0] * output_u
            A[second] = one.b[2] * signal_x - one.a[1] * output_x
            B[second] = one.b[2] * signal_u - one.a[1] * output_u
            signal_x, signal_u = output_x, output_u
        holds = np.arange(n) == 1
        return ControlLaw(A, B, signal_x, signal_u, E, holds, tuple(names))

    def response(self, z: ComplexArray) -> ComplexArray:
        """Response from the motor angle to minus the voltage, without the law's matrices."""
        T = self.period
        difference = (1.0 - 1.0 / z) / T
        loop = (self.kp + self.ki / difference) * (self.position_gain + difference)
        for one in self.filters:
            loop = loop * one.response(z)
        return np.asarray(loop)


@dataclass(frozen=True, slots=True)
class Clock:
    """Timing of a sampled servo."""

    period: float  # [s] between readings of the encoder
    delay: float = 0.0  # [s] from a reading to the voltage that follows from it

    @property
    def nyquist(self) -> float:
        """Half of the sampling rate [rad/s]."""
        return np.pi / self.period


def frequency_grid(resonances: Resonances, clock: Clock) -> FloatArray:
    """Frequencies [rad/s] up to half of the sampling rate, dense where any plant resonates."""
    lowest = 2.0 * np.pi * _LOWEST_HZ
    count = int(np.ceil(_POINTS_PER_DECADE * np.log10(clock.nyquist / lowest)))
    grids = [np.geomspace(lowest, 0.999 * clock.nyquist, count)]
    for omega, damping in resonances:
        width = 3.0 * np.maximum(damping, 1e-3)
        begin, end = (omega * (1.0 - width)).min(), (omega * (1.0 + width)).max()
        step = 2.0 * float(np.median(width)) / _POINTS_PER_RESONANCE
        begin, end = max(begin, lowest), min(end, 0.999 * clock.nyquist)
        if begin < end:
            grids.append(np.geomspace(begin, end, int(np.ceil(np.log(end / begin) / step)) + 1))
    return np.unique(np.concatenate(grids))


@dataclass(frozen=True, slots=True, eq=False)
class SampledResponses:
    """Responses S diag(drive) of sampled motor angles to voltages that are held for a period.

    The response to a held sequence is the sum over all aliases of the continuous response times
    that of the hold. Beyond half of the sampling rate, motors move as free inertias.
    """

    sums: PoleSums
    omega: FloatArray  # (n_omega,) [rad/s]
    drive: ComplexArray  # (n_joints, n_omega)
    aliases: ComplexArray  # (n_joints, n_omega) of a motor inertia of one, over the drive
    motor_inertias: FloatArray  # (n_plants, n_joints)

    @classmethod
    def of(cls, plants: Plants, omega: FloatArray, clock: Clock) -> SampledResponses:
        """The responses at frequencies up to half of the sampling rate."""

        def drive(alias: FloatArray) -> ComplexArray:  # with hold and delay, over the period
            held = (1.0 - np.exp(-1j * omega * clock.period)) / (1j * alias * clock.period)
            held = held * np.exp(-1j * alias * clock.delay)
            lag = 1.0 + 1j * alias / plants.current_loop[:, None]
            return np.asarray(plants.torque_per_volt[:, None] / lag * held)

        aliases = [k for k in range(-_N_ALIASES, _N_ALIASES + 1) if k]
        free = np.zeros((plants.n_joints, len(omega)), dtype=complex)
        for alias in (omega + k * 2.0 * np.pi / clock.period for k in aliases):
            free -= drive(alias) / alias**2
        own = drive(omega)
        sums, inertias = PoleSums.of(plants, omega), plants.motor_inertias()
        return cls(sums, omega, own, free / own, inertias)

    @property
    def n_entries(self) -> int:
        """Entries of S of one plant."""
        return int(self.sums.numerators.shape[1]) * len(self.omega)

    def symmetric(self, chosen: IntArray) -> ComplexArray:
        """S of pairs of joints for some plants: (n_chosen, n_pairs, n_omega)."""
        responses = self.sums.responses(self.omega, chosen)
        first, second = np.triu_indices(len(self.drive))
        own = np.flatnonzero(first == second)
        responses[:, own] += self.aliases / self.motor_inertias[chosen, :, None]
        return responses


@dataclass(frozen=True, slots=True, eq=False)
class SampledPlants:
    """x_k+1 = A x_k + B u_k, motor angles `motors` x, link angles `links` x."""

    A: FloatArray  # (n_plants, n, n)
    B: FloatArray  # (n_plants, n, n_joints)
    motors: FloatArray  # (n_joints, n)
    links: FloatArray  # (n_joints, n)
    ratios: FloatArray  # (n_joints,) link angle per motor angle without torsion

    def part(self, chosen: slice | IntArray) -> SampledPlants:
        """Some of the plants."""
        return replace(self, A=self.A[chosen], B=self.B[chosen])

    def map(self, function: Callable[[SampledPlants], Result]) -> list[Result]:
        """Results of a function of parts of the plants, in threads with small temporary arrays."""
        n_parts = -(-len(self.A) // _PART)
        pairs = zip(np.array_split(self.A, n_parts), np.array_split(self.B, n_parts), strict=True)
        return run_parallel([partial(function, replace(self, A=A, B=B)) for A, B in pairs])


def sample(plants: Plants, clock: Clock) -> SampledPlants:
    """Exact discretisation for voltages that a hold keeps for a period, after the delay.

    States are coordinates, their velocities, torques behind current loops, and the voltages of the
    last reading if there is a delay of at most one period.
    """
    places = np.array_split(np.arange(len(plants)), -(-len(plants) // _PART))
    parts = run_parallel([partial(_discretised, plants.part(place), clock) for place in places])
    A, B = (np.concatenate(each) for each in zip(*parts, strict=True))
    motors, links = (
        np.pad(rows, ((0, 0), (0, A.shape[1] - rows.shape[1])))
        for rows in (plants.motors, plants.links)
    )
    return SampledPlants(A, B, motors, links, np.diagonal(plants.links @ plants.rigid))


def _discretised(plants: Plants, clock: Clock) -> tuple[FloatArray, FloatArray]:
    """A and B of `SampledPlants`."""
    of_motion, of_torque = plants.equations()
    count, size, n = len(plants), of_motion.shape[1], plants.n_joints
    lags = np.flatnonzero(np.isfinite(plants.current_loop))
    n_states = size + len(lags)
    system = np.zeros((count, n_states + n, n_states + n))
    system[:, :size, :size] = of_motion
    system[:, :size, n_states:] = of_torque * plants.torque_per_volt
    for k, joint in enumerate(lags):
        rate = plants.current_loop[joint]
        system[:, :size, size + k] = of_torque[:, :, joint]
        system[:, :size, n_states + joint] = 0.0
        system[:, size + k, size + k] = -rate
        system[:, size + k, n_states + joint] = rate * plants.torque_per_volt[joint]
    after = expm(system * (clock.period - clock.delay))
    A, B = after[:, :n_states, :n_states], after[:, :n_states, n_states:]
    if clock.delay:
        is_half = clock.delay == clock.period - clock.delay
        before = after if is_half else expm(system * clock.delay)
        old = A @ before[:, :n_states, n_states:]
        below = np.zeros((count, n, n_states + n))
        units = np.broadcast_to(np.eye(n), (count, n, n))
        A = np.concatenate([A @ before[:, :n_states, :n_states], old], axis=2)
        A, B = np.concatenate([A, below], axis=1), np.concatenate([B, units], axis=1)
    return A, B


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """x_k+1 = A x_k + B (r_k, w_k) of some joints, whose link angles are `links` x."""

    A: FloatArray  # (n_plants, n, n)
    B: FloatArray  # (n_plants, n, n_joints, 2)
    links: FloatArray  # (n_joints, n)
    ratios: FloatArray  # (n_joints,) link angle per motor angle without torsion

    def poles(self) -> ComplexArray:
        """Poles (n_plants, n)."""
        return eigenvalues(self.A)

    def are_stable(self, limit: float = 1.0 + POLE_TOLERANCE) -> BoolArray:
        """Whether all poles of plants (n_plants,) are smaller than a limit."""
        return np.asarray(np.abs(self.poles()).max(axis=1) < limit)

    def pulse_responses(self, inputs: Sequence[int], n_samples: int) -> FloatArray:
        """Link angles (n_joints, n_plants, n_samples) after a pulse of each joint's reference.

        `inputs` of the joints are 0 for a pulse of the angle and 1 for one of the velocity.
        """
        # link A^i and A^j b, with i in a block of samples and j its begin
        size = 2 ** math.ceil(math.log2(n_samples) / 2.0)
        blocks = 2 ** math.ceil(math.log2(n_samples / size))
        columns = np.stack([self.B[:, :, i, k] for i, k in enumerate(inputs)], axis=1)
        rows, power = _times_powers(self.links, self.A, size)
        columns, _ = _times_powers(columns, np.swapaxes(power, 1, 2), blocks)
        response = columns.transpose(2, 0, 1, 3) @ rows.transpose(2, 0, 3, 1)
        return response.reshape(len(inputs), len(self.A), -1)[:, :, :n_samples]


def _times_powers(rows: FloatArray, A: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Rows A^k for k below a power of two, (n_plants, count, n_rows, n), and A^count."""
    done, n = rows.shape[-2:]
    table = np.empty((len(A), count * done, n))
    table[:, :done] = rows
    while done < table.shape[1]:
        np.matmul(table[:, :done], A, out=table[:, done : 2 * done])
        A, done = A @ A, 2 * done
    return table.reshape(len(A), count, -1, n), A


def close(
    plants: SampledPlants, laws: Sequence[ControlLaw], joints: Sequence[JointIndex] = ()
) -> ClosedLoop:
    """Close the loops of all joints; the references are those of some joints."""
    count, n = plants.A.shape[:2]
    sizes = [len(law.A) for law in laws]
    starts = n + np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    A = np.zeros((count, starts[-1], starts[-1]))
    B = np.zeros((count, starts[-1], len(joints), 2))
    A[:, :n, :n] = plants.A
    for i, (law, start) in enumerate(zip(laws, starts, strict=False)):
        own, voltage, angle = slice(start, start + len(law.A)), plants.B[:, :, i], plants.motors[i]
        A[:, :n, :n] += voltage[:, :, None] * (law.D[2] * angle)
        A[:, :n, own] = voltage[:, :, None] * law.C
        A[:, own, own] = law.A + np.outer(law.E, law.C)
        A[:, own, :n] = np.outer(law.B[:, 2] + law.E * law.D[2], angle)
        if i in joints:
            k = joints.index(i)
            B[:, :n, k] = voltage[:, :, None] * law.D[:2]
            B[:, own, k] = law.B[:, :2] + np.outer(law.E, law.D[:2])
    some = list(joints)
    links = np.pad(plants.links, ((0, 0), (0, starts[-1] - n)))
    return ClosedLoop(A, B, links[some], plants.ratios[some])


STEP_SECONDS = 2.0
"""Duration of a simulated step."""

_SETTLED = 0.02  # of a step


def settling_times(share: FloatArray, period: float) -> FloatArray:
    """Times [s] to 2 % of steps (n_plants, n_samples); infinite for those that do not settle."""
    is_apart = np.abs(share - 1.0) > _SETTLED
    last = share.shape[1] - np.argmax(is_apart[:, ::-1], axis=1)
    settling = np.where(is_apart.any(axis=1), last, 0) * period
    return np.where(is_apart[:, -1], np.inf, settling)


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Response of the link to a unit step of the reference: an entry per plant."""

    time: FloatArray  # (n_samples,) [s]
    # (n_samples, 3) over the final angle: smallest, of the estimates, largest
    link: FloatArray
    settling: FloatArray  # [s] to 2 %; infinite if it does not settle in the simulated time
    overshoot: FloatArray  # share of the step

    @classmethod
    def of(cls, loop: ClosedLoop, gains: Sequence[Gains]) -> list[Steps]:
        """Steps of the reference angles of a loop's joints, whose servos have some gains.

        A servo without position loop has a velocity reference that is the derivative of the step:
        one pulse. The response to a step of the angle is the sum of those to pulses.
        """
        period, by_velocity = gains[0].period, [not each.position_gain for each in gains]
        n = round(STEP_SECONDS / period)
        pulses = loop.pulse_responses([int(each) for each in by_velocity], n - 1)
        time: FloatArray = period * np.arange(n, dtype=np.float64)
        steps = []
        for ratio, pulse, is_pulse in zip(loop.ratios, pulses, by_velocity, strict=True):
            share = np.zeros((len(pulse), n))
            if is_pulse:
                share[:, 1:] = pulse / (ratio * period)
            else:
                np.cumsum(pulse / ratio, axis=1, out=share[:, 1:])
            overshoot = np.maximum(share.max(axis=1) - 1.0, 0.0)
            steps.append(cls(time, band_over(share), settling_times(share, period), overshoot))
        return steps
