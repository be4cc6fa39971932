"""Arms under sampled control laws as linear systems in discrete time.

Responses of plants to a sampled servo: hold, computation delay, current loop, aliasing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from strainwave.domain import ComplexArray, ControlLaw, FloatArray, IntArray
from strainwave.servo_design.plants import Plants

_N_ALIASES = 3  # of each sign; their share falls with the third power of the frequency
_POINTS_PER_DECADE = 40
_POINTS_PER_RESONANCE = 24  # over three half-power bandwidths
_LOWEST_HZ = 0.05


@dataclass(frozen=True, slots=True)
class Clock:
    """Timing of a sampled servo."""

    period: float  # [s] between readings of the encoder
    delay: float = 0.0  # [s] from a reading to the voltage that follows from it

    @property
    def nyquist(self) -> float:
        """Half of the sampling rate [rad/s]."""
        return np.pi / self.period


def frequency_grid(plants: Plants, clock: Clock) -> FloatArray:
    """Frequencies [rad/s] up to half of the sampling rate, dense where any plant resonates."""
    lowest = 2.0 * np.pi * _LOWEST_HZ
    count = int(np.ceil(_POINTS_PER_DECADE * np.log10(clock.nyquist / lowest)))
    grids = [np.geomspace(lowest, 0.999 * clock.nyquist, count)]
    for omega, damping in plants.resonances():
        width = 3.0 * np.maximum(damping, 1e-3)
        begin, end = (omega * (1.0 - width)).min(), (omega * (1.0 + width)).max()
        step = 2.0 * float(np.median(width)) / _POINTS_PER_RESONANCE
        begin, end = max(begin, lowest), min(end, 0.999 * clock.nyquist)
        if begin < end:
            grids.append(np.geomspace(begin, end, int(np.ceil(np.log(end / begin) / step)) + 1))
    return np.unique(np.concatenate(grids))


def sampled_responses(plants: Plants, omega: FloatArray, clock: Clock) -> ComplexArray:
    """Responses of sampled motor angles to voltages that are held for a period.

    The response to a held sequence is the sum over all aliases of the continuous response times
    that of the hold. Beyond half of the sampling rate, motors move as free inertias. Returns
    (n_plants, n_omega, n_joints, n_joints), angle by voltage.
    """
    total = plants.responses(omega) * _hold(omega, 0, clock)[:, None, None]
    free = np.zeros((len(omega), plants.n_joints), dtype=complex)  # of an inertia of one
    for k in (k for k in range(-_N_ALIASES, _N_ALIASES + 1) if k):
        alias = (omega + k * 2.0 * np.pi / clock.period)[:, None]
        drive = plants.torque_per_volt / (1.0 + 1j * alias / plants.current_loop)
        free -= drive / alias**2 * _hold(omega, k, clock)[:, None]
    joints = np.arange(plants.n_joints)
    total[:, :, joints, joints] += free / plants.motor_inertias()[:, None]
    return np.asarray(total)


def _hold(omega: FloatArray, k: int, clock: Clock) -> ComplexArray:
    """Response of hold and delay at the k-th alias, over the period."""
    alias = omega + k * 2.0 * np.pi / clock.period
    held = (1.0 - np.exp(-1j * omega * clock.period)) / (1j * alias * clock.period)
    return np.asarray(held * np.exp(-1j * alias * clock.delay))


_PART = 500  # plants


@dataclass(frozen=True, slots=True, eq=False)
class SampledPlants:
    """x_k+1 = A x_k + B u_k, motor angles `motors` x, link angles `links` x."""

    A: FloatArray  # (n_plants, n, n)
    B: FloatArray  # (n_plants, n, n_joints)
    motors: FloatArray  # (n_joints, n)
    links: FloatArray  # (n_joints, n)
    ratios: FloatArray  # (n_joints,) link angle per motor angle without torsion

    def parts(self) -> list[SampledPlants]:
        """The plants in parts, for threads and small temporary arrays."""
        n_parts = -(-len(self.A) // _PART)
        pairs = zip(np.array_split(self.A, n_parts), np.array_split(self.B, n_parts), strict=True)
        return [replace(self, A=A, B=B) for A, B in pairs]


def sample(plants: Plants, clock: Clock, chosen: IntArray | slice = slice(None)) -> SampledPlants:
    """Exact discretisation for voltages that a hold keeps for a period, after the delay.

    States are coordinates, their velocities, torques behind current loops, and the voltages of the
    last reading if there is a delay of at most one period.
    """
    mass, damping, stiffness = plants.mass[chosen], plants.damping[chosen], plants.stiffness[chosen]
    count, size, n = len(mass), mass.shape[1], plants.n_joints
    inputs = np.broadcast_to(plants.motors.T, (count, size, n))
    response = np.linalg.solve(mass, np.concatenate([-stiffness, -damping, inputs], axis=2))
    lags = np.flatnonzero(np.isfinite(plants.current_loop))
    n_states = 2 * size + len(lags)
    system = np.zeros((count, n_states + n, n_states + n))
    system[:, :size, size : 2 * size] = np.eye(size)
    system[:, size : 2 * size, : 2 * size] = response[:, :, : 2 * size]
    of_torque = response[:, :, 2 * size :]
    system[:, size : 2 * size, n_states:] = of_torque * plants.torque_per_volt
    for k, joint in enumerate(lags):
        rate = plants.current_loop[joint]
        system[:, size : 2 * size, 2 * size + k] = of_torque[:, :, joint]
        system[:, size : 2 * size, n_states + joint] = 0.0
        system[:, 2 * size + k, 2 * size + k] = -rate
        system[:, 2 * size + k, n_states + joint] = rate * plants.torque_per_volt[joint]
    A, B, old = _held(system, n_states, clock)
    motors, links = (_padded(rows, A.shape[1]) for rows in (plants.motors, plants.links))
    if clock.delay:
        A, B = _with_last_voltage(A, B, old)
        motors, links = (_padded(rows, A.shape[1]) for rows in (plants.motors, plants.links))
    ratios = np.diagonal(plants.links @ plants.rigid)
    return SampledPlants(A, B, motors, links, ratios)


def _held(
    system: FloatArray, n_states: int, clock: Clock
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Transition over a period, and responses to the new and to the last voltage."""
    after = expm(system * (clock.period - clock.delay))
    new, A = after[:, :n_states, n_states:], after[:, :n_states, :n_states]
    if not clock.delay:
        return A, new, np.zeros_like(new)
    before = expm(system * clock.delay)
    last = A @ before[:, :n_states, n_states:]
    return A @ before[:, :n_states, :n_states], new, last


def _with_last_voltage(
    A: FloatArray, B: FloatArray, old: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Adds the last voltages to the states."""
    count, n, n_inputs = B.shape
    below = np.zeros((count, n_inputs, n + n_inputs))
    units = np.broadcast_to(np.eye(n_inputs), (count, n_inputs, n_inputs))
    return (
        np.concatenate([np.concatenate([A, old], axis=2), below], axis=1),
        np.concatenate([B, units], axis=1),
    )


def _padded(rows: FloatArray, n: int) -> FloatArray:
    return np.hstack([rows, np.zeros((len(rows), n - rows.shape[1]))])


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """x_k+1 = A x_k + B (r_k, w_k) of one joint; its link angle, and link by motor angle."""

    A: FloatArray  # (n_plants, n, n)
    B: FloatArray  # (n_plants, n, 2)
    link: FloatArray  # (n,)
    ratio: float  # link angle per motor angle without torsion

    def poles(self) -> ComplexArray:
        """Poles (n_plants, n)."""
        return np.asarray(np.linalg.eigvals(self.A))

    def step(self, n_samples: int, first: FloatArray, held: FloatArray) -> FloatArray:
        """Link angles (n_plants, n_samples) from rest.

        The reference (r, w) is `first` at the first sample and `held` afterwards.
        """
        count, n = self.A.shape[:2]
        system = np.zeros((count, n + 1, n + 1))  # the held reference is a constant state
        system[:, :n, :n], system[:, :n, n], system[:, n, n] = self.A, self.B @ held, 1.0
        state = np.concatenate([self.B @ first, np.ones((count, 1))], axis=1)[..., None]
        # rows of a block of samples over the state at its begin
        size = int(np.ceil(np.sqrt(n_samples)))
        rows = np.empty((count, size, n + 1))
        rows[:, 0] = _end(self.link, n + 1)
        for k in range(1, size):
            rows[:, k] = (rows[:, k - 1, None] @ system)[:, 0]
        over_block = np.linalg.matrix_power(system, size)
        blocks = [np.zeros((count, 1))]
        with np.errstate(over="ignore", invalid="ignore"):  # unstable loops diverge
            for _ in range(size):
                blocks.append((rows @ state)[..., 0])
                state = over_block @ state
        return np.concatenate(blocks, axis=1)[:, :n_samples]


def close(plants: SampledPlants, laws: Sequence[ControlLaw], joint: int) -> ClosedLoop:
    """Close the loops of all joints; the reference is that of one joint, from 0."""
    count, n = plants.A.shape[:2]
    sizes = [len(law.A) for law in laws]
    starts = n + np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    A, B = np.zeros((count, starts[-1], starts[-1])), np.zeros((count, starts[-1], 2))
    A[:, :n, :n] = plants.A
    for i, (law, start) in enumerate(zip(laws, starts, strict=False)):
        own = slice(start, start + len(law.A))
        voltage = plants.B[:, :, i]
        angle = plants.motors[i]
        A[:, :n, :n] += voltage[:, :, None] * (law.D[2] * angle)
        A[:, :n, own] = voltage[:, :, None] * law.C
        A[:, own, own] = law.A + np.outer(law.E, law.C)
        A[:, own, :n] = np.outer(law.B[:, 2] + law.E * law.D[2], angle)
        if i == joint:
            B[:, :n] = voltage[:, :, None] * law.D[:2]
            B[:, own] = law.B[:, :2] + np.outer(law.E, law.D[:2])
    size = int(starts[-1])
    return ClosedLoop(A, B, _end(plants.links[joint], size), float(plants.ratios[joint]))


def _end(row: FloatArray, n: int) -> FloatArray:
    return np.concatenate([row, np.zeros(n - len(row))])


STEP_SECONDS = 2.0
"""Duration of a simulated step."""

_SETTLED = 0.02  # of a step


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Response of the link to a unit step of the reference: an entry per plant."""

    time: FloatArray  # (n_samples,) [s]
    # (n_samples, 3) over the final angle: smallest, of the estimates, largest
    link: FloatArray
    settling: FloatArray  # [s] to 2 %; infinite if it does not settle in the simulated time
    overshoot: FloatArray  # share of the step

    @classmethod
    def of(cls, loop: ClosedLoop, period: float, *, by_velocity: bool = False) -> Steps:
        """Step of the reference angle, or of a servo without position loop.

        For the latter (`by_velocity`) the velocity reference is the derivative of the step: one
        pulse.
        """
        n = round(STEP_SECONDS / period)
        step, pulse, rest = np.array([1.0, 0.0]), np.array([0.0, 1.0 / period]), np.zeros(2)
        link = loop.step(n, pulse, rest) if by_velocity else loop.step(n, step, step)
        share = link / loop.ratio
        is_apart = np.abs(share - 1.0) > _SETTLED
        last = n - np.argmax(is_apart[:, ::-1], axis=1)
        settling = np.where(
            is_apart[:, -1], np.inf, np.where(is_apart.any(axis=1), last, 0) * period
        )
        band = np.stack([share.min(axis=0), share[0], share.max(axis=0)], axis=1)
        time: FloatArray = period * np.arange(n, dtype=np.float64)
        return cls(time, band, settling, np.maximum(share.max(axis=1) - 1.0, 0.0))

    @classmethod
    def join(cls, parts: Sequence[Steps]) -> Steps:
        """Steps of all plants from those of parts of them, the estimates first."""
        bands = np.stack([part.link for part in parts])
        link = np.stack([bands[..., 0].min(0), bands[0, :, 1], bands[..., 2].max(0)], axis=1)
        return cls(
            parts[0].time,
            link,
            np.concatenate([part.settling for part in parts]),
            np.concatenate([part.overshoot for part in parts]),
        )
