"""What of an array is drawn: rows that keep every peak, decibels, and labels of ticks."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray, IntArray

MOST_POINTS = 1200  # of a line; one with more is thinned: a screen is no wider


def _engineering(value: float) -> str:
    """A number with the prefix of its thousand: 500m, 2, 10k."""
    exponent = int(np.floor(np.log10(value) / 3.0 + 1e-9))
    prefix = {-3: "n", -2: "µ", -1: "m", 0: "", 1: "k", 2: "M"}[exponent]
    return f"{value / 1e3**exponent:g}{prefix}"


_TICKS = [float(f"{one}e{decade}") for decade in range(-6, 7) for one in (1, 2, 5)]
TICKS = {value: _engineering(value) for value in _TICKS}
"""Of logarithmic horizontal axes, each with its whole label."""


def thinned(y: FloatArray, most: int = MOST_POINTS) -> IntArray:
    """Rows to draw: lowest and highest of each bin, so that no peak is lost; NaN stays a gap.

    Parameters
    ----------
    y : (n_samples,) or (n_samples, n_lines)
        Of several lines that share their rows, each keeps its own peaks.
    most : int
        Rows, about.

    Returns
    -------
    (n_rows,)
    """
    columns = y.reshape(len(y), -1)
    n, count = columns.shape
    if n <= most:
        return np.arange(n)
    edges = np.linspace(0, n, max(1, most // (2 * count)) + 1).astype(np.intp)
    low, last = edges[:-1, None], edges[1:, None] - 1
    bins = np.minimum(low + np.arange(np.diff(edges).max()), last)  # short ones end in repetition
    inside = columns[bins]
    gap = np.isnan(inside)
    gaps = bool(gap.any())
    least = np.argmin(np.where(gap, np.inf, inside) if gaps else inside, axis=1)
    greatest = np.argmax(np.where(gap, -np.inf, inside) if gaps else inside, axis=1)
    chosen = np.zeros(n, dtype=bool)
    chosen[low + least] = chosen[low + greatest] = True
    return np.flatnonzero(chosen)


def decibel(size: FloatArray) -> FloatArray:
    """20 log10 of a modulus; of nothing, very little."""
    return np.asarray(20.0 * np.log10(np.maximum(size, 1e-300)))
