"""Bands of open-loop responses over many plants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LoopBand:
    """One loop: its response with the estimates, and the range over all plants.

    The phase is continuous over the frequency and not positive at the first. `distance` is |1 + L|.
    """

    hz: FloatArray  # (n_omega,)
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
            hz=omega / (2.0 * np.pi),
            gain_db=_range(20.0 * np.log10(np.maximum(np.abs(loop), 1e-300))),
            phase_deg=_range(np.degrees(phase)),
            distance=_range(np.abs(1.0 + loop)),
        )

    @classmethod
    def join(cls, parts: Sequence[LoopBand]) -> LoopBand:
        """The band over all plants of bands that begin with the same plant."""

        def widest(name: str) -> FloatArray:
            low, first, high = np.moveaxis(np.array([getattr(part, name) for part in parts]), 2, 0)
            return np.stack([low.min(axis=0), first[0], high.max(axis=0)], axis=1)

        return cls(parts[0].hz, *map(widest, ("gain_db", "phase_deg", "distance")))


def _range(values: FloatArray) -> FloatArray:
    """Smallest, first and largest value of each column."""
    return np.stack([values.min(axis=0), values[0], values.max(axis=0)], axis=1)
