"""Numbers behind the drawings: decimated rows, decibels, tick labels."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, IntArray

MAX_POINTS = 1200  # points of one line: two per pixel column of a figure 600 px wide
MIN_BAND_SHARE = 1e-2  # of a modulus: a lower band edge of zero has no value in dB


def _engineering(value: float) -> str:
    """A number with its SI prefix: 500m, 2, 10k."""
    exponent = int(np.floor(np.log10(value) / 3.0 + 1e-9))
    prefix = {-3: "n", -2: "µ", -1: "m", 0: "", 1: "k", 2: "M"}[exponent]
    return f"{value / 1e3**exponent:g}{prefix}"


_TICKS = [float(f"{one}e{decade}") for decade in range(-6, 7) for one in (1, 2, 5)]
FREQUENCY_TICKS = {value: _engineering(value) for value in _TICKS}
"""Ticks of logarithmic horizontal axes and their labels."""


def decimate(y: FloatArray, limit: int = MAX_POINTS) -> IntArray:
    """Rows to draw: minimum and maximum of each bin, so that every peak stays; NaN stays a gap.

    `y` has shape (n_samples,) or (n_samples, n_lines); lines that share their rows each keep their
    peaks. About `limit` rows are returned.
    """
    columns = y.reshape(len(y), -1)
    n, count = columns.shape
    if n <= limit:
        return np.arange(n)
    edges = np.linspace(0, n, max(1, limit // (2 * count)) + 1).astype(np.intp)
    low, last = edges[:-1, None], edges[1:, None] - 1
    bins = np.minimum(low + np.arange(np.diff(edges).max()), last)  # short bins repeat their end
    inside = columns[bins]
    gap = np.isnan(inside)
    has_gaps = bool(gap.any())
    least = np.argmin(np.where(gap, np.inf, inside) if has_gaps else inside, axis=1)
    greatest = np.argmax(np.where(gap, -np.inf, inside) if has_gaps else inside, axis=1)
    is_selected = np.zeros(n, dtype=bool)
    is_selected[low + least] = is_selected[low + greatest] = True
    return np.flatnonzero(is_selected)


def spread_evenly(f: FloatArray, low: float, high: float, limit: int) -> IntArray:
    """Indices of frequencies from `low` to `high`, at most `limit`, even over log frequency."""
    inside = np.flatnonzero((f >= low) & (f <= high))
    if len(inside) <= limit:
        return inside
    targets = np.geomspace(f[inside[0]], f[inside[-1]], limit)
    return np.unique(np.searchsorted(f, targets).clip(inside[0], inside[-1]))


def decibel(modulus: FloatArray) -> FloatArray:
    """20 log10 of a modulus; -6000 dB for zero."""
    return np.asarray(20.0 * np.log10(np.maximum(modulus, 1e-300)))
