"""Figures as data: decimation keeps peaks and gaps; each name is one legend entry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from figure_parts import line, marks
from results import prediction
from strainwave.report.document import predictions
from strainwave.report.figures import (
    MAX_POINTS,
    Area,
    Axis,
    Colour,
    Figure,
    HeatMap,
    Line,
    Panel,
    decimate,
)
from virtual_arms import rigid_drive


def test_decimation_keeps_every_peak_of_every_line() -> None:
    long = prediction("motion", 90.0)
    long.measured[3333, 0] = 50.0
    long.measured[4444, 0] = -50.0
    long.predicted[2222, 0] = 70.0
    figure = predictions.prediction_figure(long)
    measured = line(figure, "measured").y
    assert (measured.max(), measured.min()) == (50.0, -50.0)
    assert line(figure, "model").y.max() == 70.0
    assert line(figure, "residual", 1).y.min() < -68.0
    assert len(measured) <= MAX_POINTS


def test_a_short_line_is_not_decimated() -> None:
    assert decimate(np.arange(100.0)).tolist() == list(range(100))
    assert len(decimate(np.arange(5000.0), 300)) <= 300


def test_gaps_stay_gaps() -> None:
    gappy = prediction("motion", 90.0)
    gappy.measured[100:200] = np.nan
    assert np.isnan(line(predictions.prediction_figure(gappy), "measured").y).any()


def test_each_channel_has_its_residuals_below() -> None:
    two = prediction("motion", 90.0, 80.0)
    figure = predictions.prediction_figure(two)
    titles = [panel.axis.title for panel in figure.panels]
    assert titles == ["torque1 [N m]", "residual [N m]", "torque2 [N m]", "residual [N m]"]
    for k in (0, 2):
        measured, model = line(figure, "measured", k), line(figure, "model", k)
        residual = line(figure, "residual", k + 1)
        assert residual.x is measured.x
        assert residual.y == pytest.approx(measured.y - model.y)
        assert figure.panels[k + 1].height < figure.panels[k].height
    assert figure.legend == ["measured", "model", "residual"]


def test_one_channel_can_be_selected() -> None:
    two = prediction("motion", 90.0, 80.0)
    figure = predictions.prediction_figure(two, channels=("torque2",))
    assert [panel.axis.title for panel in figure.panels] == ["torque2 [N m]", "residual [N m]"]
    assert line(figure, "measured").y[0] == two.measured[0, 1]


def test_a_prismatic_joint_has_forces() -> None:
    prismatic = [replace(rigid_drive().arm.joints[0], motion="prismatic")]
    assert predictions.unit_of("torque1") == "N m"
    assert predictions.unit_of("torque1", prismatic) == "N"
    assert predictions.unit_of("omega_m2", prismatic) == "rad/s"


def test_a_legend_lists_names_that_differ() -> None:
    x = np.arange(3.0)
    a, b = Line(x, x, "a", Colour.MODEL), Line(x, x, "b", Colour.MODEL)
    band = Area(x, x, x, Colour.MODEL, "c")
    panel = Panel(Axis("y"), (a, band))
    assert Figure(Axis("x"), (panel, panel)).legend == []
    both = Figure(Axis("x"), (panel, Panel(Axis("y"), (b, replace(b, name="d", legend=False)))))
    assert both.legend == ["a", "b"]


def test_the_height_follows_from_panels_or_row_names() -> None:
    x = np.arange(3.0)
    lines = (Line(x, x, "a", Colour.MODEL),)
    panels = (Panel(Axis("y"), lines), Panel(Axis("y"), lines, 0.5))
    assert Figure(Axis("x"), panels).height == 1.5
    names = tuple(f"{k}" for k in range(30))
    heat = HeatMap(names, np.eye(30), -1.0, 1.0, (Colour.MODEL, Colour.MODEL, Colour.MODEL))
    figure = Figure(Axis(""), (Panel(Axis(""), (heat,)),))
    assert figure.height == 6.0  # thirty names, six in a panel, and one panel for the names below
    assert marks(figure, HeatMap) == [heat]
