"""Shared charts: bands, decibels, error bars, residuals, and distinct line styles."""

from __future__ import annotations

import numpy as np
import pytest

from figure_parts import line, marks, names
from strainwave.report.figures import Area, Colour, Line, curves


def test_a_bode_plot_has_95_percent_bands_and_a_continuous_phase() -> None:
    f = np.geomspace(1.0, 100.0, 50)
    response = (1.0 / (2j * np.pi * f)).astype(np.complex128)
    size = np.abs(response)
    figure = curves.bode(
        [
            curves.Curve("truth", f, response, true=True),
            curves.Curve("model", f, response, 0.1 * size, np.full(50, 0.1)),
        ],
        "caption",
    )
    (above,), (below,) = marks(figure, Area), marks(figure, Area, 1)
    assert above.high == pytest.approx(20.0 * np.log10(1.196 * size))
    assert below.high - below.low == pytest.approx(np.full(50, np.rad2deg(2.0 * 1.96 * 0.1)))
    assert figure.legend == ["truth", "model"]
    assert line(figure, "truth").colour == Colour.RESIDUAL
    assert line(figure, "truth", 1).y == pytest.approx([-90.0] * 50)
    assert figure.caption == "caption"


def test_every_line_has_its_own_style() -> None:
    x = np.arange(3.0)
    many = [curves.Series(f"{k}", x, x) for k in range(6)]
    figure = marks(curves.lines(many, "t", "y", "caption"), Line)
    assert len({one.colour for one in figure}) == len({one.dash for one in figure}) == 6


def test_points_with_a_standard_deviation_have_error_bars() -> None:
    x = np.array([2.0, 10.0])
    points = [curves.Series("model", x, x, np.ones(2)), curves.Series("bound", x, x)]
    model, bound = marks(curves.scatter(points, "amplitude", "square", "caption"), Line)
    assert model.error is not None
    assert model.error.tolist() == [1.96, 1.96]
    assert model.size > 0.0
    assert (bound.error, bound.size) == (None, 0.0)


def test_a_spectrum_is_in_decibels_of_power() -> None:
    one = curves.Series("a", np.array([0.0, 1.0, 10.0]), np.array([5.0, 1.0, 100.0]))
    figure = curves.spectrum([one], "V²/Hz", "caption")
    assert figure.x.log
    assert line(figure, "a").x.tolist() == [1.0, 10.0]
    assert line(figure, "a").y.tolist() == [0.0, 20.0]


def test_a_pair_has_its_difference_below() -> None:
    t = np.arange(4.0)
    figure = curves.pair(
        curves.Series("arm", t, t), curves.Series("model", t, 0.5 * t), "v", "caption"
    )
    assert names(figure) == ["arm", "model"]
    assert line(figure, "difference", 1).y.tolist() == [0.0, 0.5, 1.0, 1.5]
