"""Extra-insensitive input shapers by their definition, for modes with damping.

Over the frequency of a mode of given damping ratio, the residual vibration of such a shaper is
alternately zero and a maximum of the tolerated height: twice zero for the EI shaper, whose maximum
is at the design frequency, and three times for the two-hump EI shaper.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import root

from strainwave.domain import FloatArray

_DAMPING_STEP = 0.02  # of the continuation; of 0.05 it fails where a zero is already far away
_MAX_RESIDUAL = 1e-9  # of the equations of a design, which are of order one


@dataclass(frozen=True, slots=True, eq=False)
class ZerosAndMaxima:
    """Impulses, and frequencies at which their vibration is alternately zero and largest.

    The frequency in the middle is 1 rad/s.
    """

    amplitudes: FloatArray  # (n_zeros + 1,)
    times: FloatArray  # (n_zeros + 1,)
    omega: FloatArray  # (2 n_zeros - 1,)

    def unknowns(self) -> FloatArray:
        """Amplitudes and times after the first impulse, frequencies but for the middle."""
        others = np.delete(self.omega, len(self.omega) // 2)
        return np.concatenate([self.amplitudes[1:], self.times[1:], others])

    @staticmethod
    def of(unknowns: FloatArray, n_zeros: int) -> ZerosAndMaxima:
        """The inverse of `unknowns`."""
        amplitudes, times, others = np.split(unknowns, [n_zeros, 2 * n_zeros])
        return ZerosAndMaxima(
            np.concatenate([[1.0 - amplitudes.sum()], amplitudes]),
            np.concatenate([[0.0], times]),
            np.insert(others, n_zeros - 1, 1.0),
        )

    def equations(self, damping: float, tolerance: float) -> FloatArray:
        """Zero where the zeros and the maxima of the tolerated height are those of a mode."""
        before_end = self.times - self.times[-1]
        p = damping + 1j * np.sqrt(1.0 - damping**2)
        terms = np.exp(p * np.outer(self.omega, before_end)) * self.amplitudes
        values, slopes = terms.sum(axis=1), terms @ (p * before_end)
        zeros, maxima = values[::2], values[1::2] / tolerance
        height = np.abs(maxima) ** 2 - 1.0
        slope = (maxima.conj() * slopes[1::2]).real / tolerance
        return np.concatenate([zeros.real, zeros.imag, height, slope])

    def damped(self, before: float, after: float) -> ZerosAndMaxima:
        """Approximation for another damping: the impulses of a mode that decays differently."""
        oscillations = [np.sqrt(1.0 - damping**2) for damping in (before, after)]
        decay = after / oscillations[1] - before / oscillations[0]
        amplitudes = self.amplitudes * np.exp(-decay * np.pi * np.arange(len(self.amplitudes)))
        times = self.times * oscillations[0] / oscillations[1]
        return ZerosAndMaxima(amplitudes / amplitudes.sum(), times, self.omega)

    def is_regular(self) -> bool:
        """Whether impulses are positive, and times and frequencies ascend."""
        ascending = (np.diff(self.times) > 0.0).all() and (np.diff(self.omega) > 0.0).all()
        return bool(ascending and (self.amplitudes > 0.0).all())


def design_zeros_and_maxima(
    n_zeros: int, damping: float, tolerance: float
) -> ZerosAndMaxima | None:
    """Shaper with alternate zeros and maxima of the tolerated height around 1 rad/s, if any.

    They follow from the undamped shaper by continuation in the damping ratio (Singhose, Seering
    and Singer, J. Mech. Des. 116, 1994, state the conditions). With growing damping the highest
    zero moves to infinity, beyond which there is no such shaper.
    """
    shaper = _chebyshev(n_zeros, tolerance)
    steps = np.linspace(0.0, damping, int(np.ceil(damping / _DAMPING_STEP)) + 1)
    for before, after in pairwise(steps.tolist()):

        def equations(unknowns: FloatArray, at: float = after) -> FloatArray:
            return ZerosAndMaxima.of(unknowns, n_zeros).equations(at, tolerance)

        with np.errstate(over="ignore", invalid="ignore"):  # on the way to a zero at infinity
            solution = root(equations, shaper.damped(before, after).unknowns(), tol=1e-12)
        shaper = ZerosAndMaxima.of(solution.x, n_zeros)
        if not (np.abs(solution.fun).max() < _MAX_RESIDUAL and shaper.is_regular()):
            return None
    return shaper


def _chebyshev(n_zeros: int, tolerance: float) -> ZerosAndMaxima:
    """Shaper without damping: V = tolerance |T_n(x cos(omega t / 2))|, T_n(x) = 1 / tolerance.

    Chebyshev polynomials have the widest interval with maxima of the tolerated height.
    """
    x = np.cosh(np.arccosh(1.0 / tolerance) / n_zeros)
    angles = np.arange(1, 2 * n_zeros) * np.pi / (2.0 * n_zeros)
    omega = 2.0 / np.pi * np.arccos(np.cos(angles) / x)
    amplitudes = np.poly(np.exp(1j * np.pi * omega[::2])).real
    times = np.pi * np.arange(n_zeros + 1, dtype=float)
    return ZerosAndMaxima(amplitudes / amplitudes.sum(), times, omega)
