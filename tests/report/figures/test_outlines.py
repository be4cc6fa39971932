"""Outlines of long signals."""

from __future__ import annotations

import numpy as np

from strainwave.report.figures import outlines


def test_an_outline_has_the_extremes_of_every_bin() -> None:
    rng = np.random.default_rng(1)
    values = rng.standard_normal(100_000)
    values[77_777] = 50.0  # a spike of one sample
    line = outlines.outline(values)
    y = np.array([float(point.split(",")[1]) for point in line.points.split()])
    assert len(y) == 2 * outlines.WIDTH
    assert (line.low, line.high) == (values.min(), 50.0)
    assert (y.min(), y.max()) == (0.0, outlines.HEIGHT)
    assert int(np.argmin(y)) // 2 == 77_777 * outlines.WIDTH // 100_000
    assert outlines.outline(np.full(3, np.nan)).points == ""
    assert outlines.outline(np.array([1.0, np.inf, 3.0])).high == 3.0
