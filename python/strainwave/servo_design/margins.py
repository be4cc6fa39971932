"""Stability margins of servo loops over many plants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Requirements:
    """Margins that every plant must keep."""

    gain_db: float = 6.0
    phase_deg: float = 30.0
    modulus: float = 0.5  # smallest distance of the loop from -1


@dataclass(frozen=True, slots=True, eq=False)
class Margins:
    """Margins of one loop: an entry per plant."""

    gain_db: FloatArray  # smallest change of the gain, up or down, to the stability limit
    gain_hz: FloatArray  # where it is
    phase_deg: FloatArray
    phase_hz: FloatArray
    modulus: FloatArray
    modulus_hz: FloatArray
    bandwidth_hz: FloatArray  # highest frequency at which the loop's gain is one

    @classmethod
    def join(cls, parts: Sequence[Margins]) -> Margins:
        """Margins of all plants from those of parts of them."""
        names = (field.name for field in fields(cls))
        return cls(*(np.concatenate([getattr(one, name) for one in parts]) for name in names))

    def share(self, required: Requirements) -> FloatArray:
        """Smallest margin over the required one, per plant; at least one if all are kept."""
        shares = (
            self.gain_db / required.gain_db,
            self.phase_deg / required.phase_deg,
            self.modulus / required.modulus,
        )
        return np.asarray(np.minimum.reduce(shares))

    def worst(self, required: Requirements) -> int:
        """Index of the plant with the smallest margins."""
        return int(np.argmin(self.share(required)))


def margins_of(loop: ComplexArray, omega: FloatArray) -> Margins:
    """Margins of open-loop responses (n_plants, n_omega) at frequencies [rad/s].

    Crossings are interpolated between neighbouring frequencies. A loop that never crosses has
    infinite margins.
    """
    hz = omega / (2.0 * np.pi)
    every = np.arange(len(loop))
    distance = np.abs(1.0 + loop)
    at = np.argmin(distance, axis=1)
    gain_db, gain_hz = _gain_margins(loop, hz)
    phase_deg, phase_hz, bandwidth = _phase_margins(loop, hz)
    return Margins(gain_db, gain_hz, phase_deg, phase_hz, distance[every, at], hz[at], bandwidth)


def _gain_margins(loop: ComplexArray, hz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance of the gain from one [dB] where the loop crosses the negative real axis."""
    imaginary, real = loop.imag, loop.real
    crosses = imaginary[:, :-1] * imaginary[:, 1:] <= 0.0
    span = imaginary[:, 1:] - imaginary[:, :-1]
    share = np.divide(-imaginary[:, :-1], span, out=np.zeros_like(span), where=span != 0.0)
    at_axis = real[:, :-1] + share * (real[:, 1:] - real[:, :-1])
    crosses &= at_axis < 0.0
    level = np.abs(np.where(crosses, at_axis, 1.0))
    db = np.where(crosses, np.abs(20.0 * np.log10(np.maximum(level, 1e-300))), np.inf)
    return _least(db, hz, share)


def _phase_margins(loop: ComplexArray, hz: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distance of the phase from -180 degrees where the gain is one, and the highest such place."""
    level = np.log(np.maximum(np.abs(loop), 1e-300))
    crosses = level[:, :-1] * level[:, 1:] <= 0.0
    span = level[:, 1:] - level[:, :-1]
    share = np.divide(-level[:, :-1], span, out=np.zeros_like(span), where=span != 0.0)
    phase = np.angle(-loop)  # zero at -1
    turn = np.angle(loop[:, 1:] / np.where(loop[:, :-1] == 0.0, 1.0, loop[:, :-1]))
    degrees = np.where(crosses, np.abs(np.degrees(_wrapped(phase[:, :-1] + share * turn))), np.inf)
    least, where = _least(degrees, hz, share)
    last = crosses.shape[1] - 1 - np.argmax(crosses[:, ::-1], axis=1)
    every = np.arange(len(loop))
    highest = hz[last] + share[every, last] * (hz[last + 1] - hz[last])
    bandwidth = np.where(crosses.any(axis=1), highest, 0.0)
    return least, where, bandwidth


def _wrapped(angle: FloatArray) -> FloatArray:
    """Angles between -pi and pi."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _least(values: FloatArray, hz: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least value of each row, and its frequency; NaN where there is none."""
    every, at = np.arange(len(values)), np.argmin(values, axis=1)
    where = hz[at] + share[every, at] * (hz[at + 1] - hz[at])
    least = values[every, at]
    return least, np.where(np.isfinite(least), where, np.nan)


def effective_plants(plants: ComplexArray, controllers: ComplexArray, joint: int) -> ComplexArray:
    """Response of one motor to its own voltage while the other joints' loops are closed.

    `plants` (n_plants, n_omega, n_joints, n_joints) are responses of motor angles to voltages,
    `controllers` (n_omega, n_joints) those of voltages to motor angles, without sign. `joint`
    counts from 0. Returns (n_plants, n_omega).
    """
    others: IntArray = np.delete(np.arange(plants.shape[-1]), joint)
    own = plants[..., joint, joint]
    if not len(others):
        return own
    # u_o = -C_o y_o: y_o = (1 + P_oo C_o)^-1 P_oi u_i
    closed = (
        np.eye(len(others)) + plants[..., others[:, None], others] * controllers[:, None, others]
    )
    caused = np.linalg.solve(closed, plants[..., others, joint][..., None])[..., 0]
    back = plants[..., joint, others] * controllers[:, others]
    return np.asarray(own - (back * caused).sum(axis=-1))
