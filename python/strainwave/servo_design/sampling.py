"""Responses of plants to a sampled servo: hold, computation delay, current loop, aliasing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import ComplexArray, FloatArray
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
