"""Outlines of long signals: the lowest and highest value of each bin as a line of an SVG."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray

WIDTH, HEIGHT = 240, 100  # of the view of a line; a bin is one unit wide


@dataclass(frozen=True, slots=True)
class Outline:
    """A signal as lowest and highest value of each bin."""

    samples: int
    low: float  # NaN if it has no number
    high: float
    points: str  # of an SVG polyline in WIDTH x HEIGHT


def outline(values: FloatArray) -> Outline:
    """The outline of a signal (n_samples,); missing and infinite values are left out."""
    finite = np.where(np.isfinite(values), values, np.nan)
    edges = np.unique(np.linspace(0, len(values), WIDTH + 1)[:-1].astype(int))
    low, high = np.fmin.reduceat(finite, edges), np.fmax.reduceat(finite, edges)
    rows = np.flatnonzero(np.isfinite(low))
    if not len(rows):
        return Outline(len(values), np.nan, np.nan, "")
    bottom, top = float(low[rows].min()), float(high[rows].max())
    scale = HEIGHT / (top - bottom) if top > bottom else 0.0
    x = edges[rows] * WIDTH / len(values)
    lower, upper = ((HEIGHT - scale * (each[rows] - bottom)) for each in (low, high))
    if not scale:
        lower = upper = np.full(len(rows), HEIGHT / 2)
    points = np.column_stack([x, lower, x, upper]).reshape(-1, 2).round(1)
    return Outline(len(values), bottom, top, " ".join(f"{a:g},{b:g}" for a, b in points))
