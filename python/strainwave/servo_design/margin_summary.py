"""The smallest and the median margin of a loop over all plants, and where the smallest is."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.servo_design.margins import Margins, Requirements


@dataclass(frozen=True, slots=True)
class MarginSummary:
    """One margin of one loop."""

    name: str
    unit: str
    required: float | None
    least: float  # infinite for a loop without crossing
    median: float
    hz: float | None  # of the smallest margin
    plant: int  # with the smallest margin

    @property
    def share(self) -> float:
        """The smallest margin over the required one; infinite if none is required."""
        return self.least / self.required if self.required else math.inf


def margin_summaries(margins: Margins, required: Requirements) -> Iterator[MarginSummary]:
    """Gain, phase and modulus margins, and the bandwidth."""
    yield _summary("gain", "dB", required.gain_db, margins.gain_db, margins.gain_hz)
    yield _summary("phase", "deg", required.phase_deg, margins.phase_deg, margins.phase_hz)
    yield _summary("modulus", "1", required.modulus, margins.modulus, margins.modulus_hz)
    yield _summary("bandwidth", "Hz", None, margins.bandwidth_hz, None)


def _summary(
    name: str, unit: str, required: float | None, values: FloatArray, hz: FloatArray | None
) -> MarginSummary:
    plant = int(np.argmin(values))
    where = None if hz is None else float(hz[plant])
    return MarginSummary(
        name, unit, required, float(values[plant]), float(np.median(values)), where, plant
    )
