"""Filter bands around the resonances of a joint, limited to what its records contain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import Decoupled, JointModel, LinkSignals, Modes

Band = tuple[float, float]
"""Lower and upper edge [Hz]."""

FIRST_BAND_HZ: Band = (3.0, 60.0)
"""Initial band of a search: resonances of strain-wave gears with links of about 1 m."""

MIN_PERIODS = 6.0
"""Minimum number of periods of the lower edge in a record."""

_MAX_HIGH_EDGE_TO_RATE = 0.4  # upper edge over the sampling rate
_MAX_HIGH_EDGE_TO_BANDWIDTH = 0.8  # upper edge over the bandwidth of a filter of the signals


def resonances_of(modes: Modes | JointModel | None) -> Band | None:
    """Frequencies [Hz] of anti-resonance and resonance; None unless both are known."""
    if modes is None or modes.anti_resonance is None or modes.resonance is None:
        return None
    return modes.anti_resonance.frequency_hz, modes.resonance.frequency_hz


def limit_band(
    band: Band,
    records: Sequence[LinkSignals | Decoupled],
    lengths: Sequence[int],
    min_edge_ratio: float,
) -> Band:
    """Limit a band to the frequencies that records contain.

    `lengths` are the usable samples of each record, `min_edge_ratio` the least ratio of the edges.
    """
    low, high = band
    for record, length in zip(records, lengths, strict=True):
        T = record.sample_time
        low = max(low, MIN_PERIODS / (length * T))
        bandwidth = record.bandwidth_hz or np.inf
        high = min(high, _MAX_HIGH_EDGE_TO_RATE / T, _MAX_HIGH_EDGE_TO_BANDWIDTH * bandwidth)
    return min(low, high / min_edge_ratio), high


def neighbouring_bands(band: Band, by: float) -> tuple[Band, Band]:
    """A narrower and a wider band. Changes of estimates with the band measure the model error."""
    low, high = band
    return (low * by, high / by), (low / by, high * by)


def same_band(band: Band, other: Band, within: float) -> bool:
    """Whether both edges of two bands agree to the relative difference `within`."""
    return all(abs(a / b - 1.0) < within for a, b in zip(band, other, strict=True))
