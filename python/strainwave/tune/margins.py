"""Stability margins of servo loops, and the bands of their responses, over many plants."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np

from strainwave.domain import BoolArray, ComplexArray, FloatArray, IntArray

Record = TypeVar("Record")


def join(parts: Sequence[Record], shared: str = "", bands: Sequence[str] = ()) -> Record:
    """A record over all plants from those of parts of them.

    `shared` is the field that all parts have in common, `bands` are those of `band_over`, of parts
    that begin with the same plant. The other fields have an entry per plant.
    """

    def joined(name: str) -> FloatArray:
        values = [getattr(part, name) for part in parts]
        if name in bands:
            low, first, high = np.moveaxis(np.array(values), 2, 0)
            return np.stack([low.min(axis=0), first[0], high.max(axis=0)], axis=1)
        return values[0] if name == shared else np.concatenate(values)

    return type(parts[0])(*(joined(field.name) for field in fields(parts[0])))  # type: ignore[arg-type]


def band_over(values: FloatArray) -> FloatArray:
    """Smallest, first and largest value (n, 3) of each column; the first row has the estimates."""
    return np.stack([values.min(axis=0), values[0], values.max(axis=0)], axis=1)


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

    def share(self, required: Requirements) -> FloatArray:
        """Smallest margin over the required one, per plant; at least one if all are kept."""
        shares = (
            self.gain_db / required.gain_db,
            self.phase_deg / required.phase_deg,
            self.modulus / required.modulus,
        )
        return np.asarray(np.minimum.reduce(shares))


def margins_of(loop: ComplexArray, omega: FloatArray) -> Margins:
    """Margins of open-loop responses (n_plants, n_omega) at frequencies [rad/s].

    Crossings are interpolated between neighbouring frequencies. A loop that never crosses has
    infinite margins.
    """
    hz, every = omega / (2.0 * np.pi), np.arange(len(loop))

    def hz_at(columns: IntArray, share: FloatArray) -> FloatArray:
        return np.asarray(hz[columns] + share[every, columns] * np.diff(hz)[columns])

    def least(values: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        columns = np.argmin(values, axis=1)
        lowest = values[every, columns]
        return lowest, np.where(np.isfinite(lowest), hz_at(columns, share), np.nan)

    # distance of the gain from one where the loop crosses the negative real axis
    crosses, share = _crossings(loop.imag)
    at_axis = loop.real[:, :-1] + share * np.diff(loop.real)
    crosses &= at_axis < 0.0
    level = np.abs(np.where(crosses, at_axis, 1.0))
    db = np.where(crosses, np.abs(20.0 * np.log10(np.maximum(level, 1e-300))), np.inf)
    gain_db, gain_hz = least(db, share)
    # distance of the phase from -180 degrees where the gain is one; the highest such place
    crosses, share = _crossings(np.log(np.maximum(np.abs(loop), 1e-300)))
    turn = np.angle(loop[:, 1:] / np.where(loop[:, :-1] == 0.0, 1.0, loop[:, :-1]))
    wrapped = (np.angle(-loop[:, :-1]) + share * turn + np.pi) % (2.0 * np.pi) - np.pi
    phase_deg, phase_hz = least(np.where(crosses, np.abs(np.degrees(wrapped)), np.inf), share)
    last = crosses.shape[1] - 1 - np.argmax(crosses[:, ::-1], axis=1)
    bandwidth = np.where(crosses.any(axis=1), hz_at(last, share), 0.0)
    distance = np.abs(1.0 + loop)
    at = np.argmin(distance, axis=1)
    return Margins(gain_db, gain_hz, phase_deg, phase_hz, distance[every, at], hz[at], bandwidth)


def _crossings(values: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Intervals (n_plants, n_omega - 1) in which values change their sign, and where in them."""
    span = np.diff(values)
    share = np.divide(-values[:, :-1], span, out=np.zeros_like(span), where=span != 0.0)
    return values[:, :-1] * values[:, 1:] <= 0.0, share


def effective_plants(plants: ComplexArray, controllers: ComplexArray) -> ComplexArray:
    """Responses of each motor to its own voltage while the other joints' loops are closed.

    `plants` (n_plants, n_omega, n_joints, n_joints) are responses of motor angles to voltages,
    `controllers` (n_omega, n_joints) those of voltages to motor angles, without sign. Returns
    (n_plants, n_omega, n_joints).
    """
    # with all loops closed, y = T u with T = (1 + P C)^-1 P; opening a loop removes T_ii C_i
    all_closed = np.linalg.solve(
        np.eye(plants.shape[-1]) + plants * controllers[:, None, :], plants
    )
    own = np.diagonal(all_closed, axis1=2, axis2=3)
    return np.asarray(own / (1.0 - own * controllers))


@dataclass(frozen=True, slots=True, eq=False)
class LoopBand:
    """One loop: its response with the estimates, and the range over all plants.

    The phase is continuous over the frequency and not positive at the first. `distance` is |1 + L|.
    """

    frequency_hz: FloatArray  # (n_omega,)
    gain_db: FloatArray  # (n_omega, 3): smallest, of the estimates, largest
    phase_deg: FloatArray  # (n_omega, 3)
    distance: FloatArray  # (n_omega, 3)

    @classmethod
    def of(cls, loop: ComplexArray, omega: FloatArray) -> LoopBand:
        """The band of responses (n_plants, n_omega); the first plant has the estimates."""
        phase = np.unwrap(np.angle(loop), axis=1)
        phase -= 2.0 * np.pi * (phase[0, 0] > 0.0)
        # resonances turn the phase differently, but all plants are alike below them
        phase -= 2.0 * np.pi * np.round((phase[:, :1] - phase[0, 0]) / (2.0 * np.pi))
        return cls(
            frequency_hz=omega / (2.0 * np.pi),
            gain_db=band_over(20.0 * np.log10(np.maximum(np.abs(loop), 1e-300))),
            phase_deg=band_over(np.degrees(phase)),
            distance=band_over(np.abs(1.0 + loop)),
        )


@dataclass(frozen=True, slots=True)
class MarginSummary:
    """One margin of one loop."""

    name: str
    unit: str
    required: float | None
    least: float  # infinite for a loop without crossing
    median: float
    frequency_hz: float | None  # of the smallest margin
    plant: int  # with the smallest margin

    @property
    def share(self) -> float:
        """The smallest margin over the required one; infinite if none is required."""
        return self.least / self.required if self.required else math.inf


def margin_summaries(margins: Margins, required: Requirements) -> Iterator[MarginSummary]:
    """Gain, phase and modulus margins, and the bandwidth."""
    of_margins: tuple[tuple[str, str, float | None, FloatArray, FloatArray | None], ...] = (
        ("gain", "dB", required.gain_db, margins.gain_db, margins.gain_hz),
        ("phase", "deg", required.phase_deg, margins.phase_deg, margins.phase_hz),
        ("modulus", "1", required.modulus, margins.modulus, margins.modulus_hz),
        ("bandwidth", "Hz", None, margins.bandwidth_hz, None),
    )
    for name, unit, limit, values, hz in of_margins:
        plant = int(np.argmin(values))
        where = None if hz is None else float(hz[plant])
        least, median = float(values[plant]), float(np.median(values))
        yield MarginSummary(name, unit, limit, least, median, where, plant)
