"""Impulses of an input shaper on the clock of a servo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.servo_design.design import ServoDesign
from strainwave.servo_design.shaper_ranking import RankedShaper


@dataclass(frozen=True, slots=True)
class ShaperSummary:
    """The impulses that are not zero."""

    title: str
    samples: list[int]  # periods after the first
    times: list[float]  # [s]
    amplitudes: list[float]  # sum 1
    duration: float  # [s]
    vibration: float  # the largest share that remains

    @classmethod
    def of(cls, ranked: RankedShaper) -> ShaperSummary:
        """The impulses of a shaper."""
        impulses = ranked.impulses
        at = np.flatnonzero(impulses.amplitudes)
        parts = [f"{one.kind} at {one.omega / (2.0 * np.pi):.4g} Hz" for one in ranked.shapers]
        return cls(
            title=" and ".join(parts),
            samples=at.tolist(),
            times=impulses.times[at].tolist(),
            amplitudes=impulses.amplitudes[at].tolist(),
            duration=impulses.duration,
            vibration=ranked.vibration,
        )


def chosen_shaper(design: ServoDesign) -> ShaperSummary | None:
    """The best shaper of a design; None for an arm without elastic modes."""
    return ShaperSummary.of(design.shapers[0]) if design.shapers else None
