"""Stability margins of servo loops, and the bands of their responses, over many plants."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np

from strainwave import _core
from strainwave.domain import ComplexArray, FloatArray, IntArray

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
    encirclements: IntArray  # of -1, clockwise, over both signs of the frequency

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
    infinite margins. Encirclements are counted for loops with an integrator, which close at their
    first frequency through the lower half plane. By Nyquist's criterion, they differ between two
    stable control laws of a plant by the difference of the numbers of unstable closed-loop poles.
    """
    pairs = np.ascontiguousarray(loop).view(np.float64)
    margins, encirclements = _core.loop_margins(pairs, (omega / (2.0 * np.pi)).tolist())
    return Margins(*[*margins.T, encirclements])


def open_loops(responses: ComplexArray, factors: ComplexArray) -> ComplexArray:
    """Loops of all joints (n_joints, n_plants, n_omega), each with the other joints' loops closed.

    `responses` (n_plants, n_pairs, n_omega) are the symmetric S of pairs of joints, and `factors`
    (n_joints, n_omega) those f by which S diag(f) are the responses of all open loops. The loop of
    joint i is

        L_i = 1 / [(1 + g S g)^-1]_ii - 1,   g = diag(sqrt(f))
    """
    pairs, roots = (
        np.ascontiguousarray(each).view(np.float64) for each in (responses, np.sqrt(factors))
    )
    return _core.open_loops(pairs, roots).view(np.complex128)


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
        phase, turn = np.angle(loop), 2.0 * np.pi
        # continuous, not positive at first; all plants are alike below their resonances
        first = turn * (phase[0, 0] > 0.0)
        first += turn * np.round((phase[:, 0] - phase[0, 0]) / turn)
        turns = np.rint(np.diff(phase) / turn)
        phase[:, 1:] -= turn * np.cumsum(turns, axis=1)
        size = band_over(np.abs(loop))
        return cls(
            frequency_hz=omega / turn,
            gain_db=20.0 * np.log10(np.maximum(size, 1e-300)),
            phase_deg=np.degrees(band_over(phase - first[:, None])),
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
