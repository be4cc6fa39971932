"""Figures by Matplotlib: every mark is chart in its place."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

from elastic_results import elastic_identification
from results import identification
from strainwave.errors import InvalidInput
from strainwave.report.document import figures_of
from strainwave.report.figures import Axis, Figure, Line, Mark, Markers, Panel, curves
from strainwave.report.matplotlib_backend import draw, images, require_matplotlib

pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")


def figure(*marks: Mark, x: str = "time [s]", y: str = "torque [N m]", **more: Any) -> Figure:
    return Figure(Axis(x), (Panel(Axis(y), marks),), **more)


def test_lines_points_and_gaps_are_drawn() -> None:
    x = np.array([0.0, 1.0, 2.0])
    chart = draw(
        figure(
            Line(x, np.array([1.0, np.nan, 3.0]), "a", "#0072B2", (6.0, 3.0)),
            Markers(np.array([0.5]), np.array([2.0]), "b", "#D55E00"),
        )
    )
    (axes,) = chart.axes
    line, points = axes.get_lines()
    assert np.asarray(line.get_xdata()).tolist() == [0.0, 1.0, 2.0]
    assert np.isnan(np.asarray(line.get_ydata())).tolist() == [False, True, False]
    assert (line.get_color(), points.get_linestyle(), points.get_marker()) == (
        "#0072B2",
        "None",
        "o",
    )
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time [s]", "torque [N m]")
    (legend,) = chart.legends
    assert [text.get_text() for text in legend.get_texts()] == ["a", "b"]


def test_a_bode_plot_has_panels_bands_and_labels() -> None:
    chart = draw(figures_of(elastic_identification())["bode-joint-1"])
    assert [axes.get_ylabel() for axes in chart.axes] == [
        "dB re rad/s/(N m)",
        "phase [°]",
        "coherence",
    ]
    assert all(axes.get_xscale() == "log" for axes in chart.axes)
    assert chart.axes[2].get_ylim() == (0.0, 1.05)
    assert len(chart.axes[0].collections) == 2  # bands of the measured points and the joint model
    labels = [text for axes in chart.axes for text in axes.texts]
    assert [text.get_text().split()[0] for text in labels] == ["anti-resonance", "resonance"]
    marked: Any = labels[0]
    assert marked.xy[0] == pytest.approx(12.9, abs=0.1)  # [Hz], not its logarithm
    assert marked.axes is chart.axes[1]
    tops = [axes.get_position().y0 for axes in chart.axes]
    assert tops == sorted(tops, reverse=True)


def test_bars_and_heat_maps_are_drawn() -> None:
    figures = figures_of(elastic_identification())
    slope = draw(figures["gear-joint-1-slope"]).axes
    assert len(slope[1].patches) == 60
    assert slope[1].get_yscale() == "log"
    correlations = draw(figures["correlations"])
    (image,) = correlations.axes[0].images
    assert image.get_clim() == (-1.0, 1.0)
    assert correlations.axes[0].get_yticklabels()[0].get_text() == "gear stiffness k1 1"


def test_error_bars_are_drawn() -> None:
    points = curves.Series("a", np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([0.1, 0.2]))
    (axes,) = draw(curves.scatter([points], "x", "y", "caption")).axes
    (bars,) = axes.containers
    assert bars.has_yerr  # type: ignore[attr-defined]


def test_every_figure_is_written_reproducibly_as_png_and_svg() -> None:
    for name, each in figures_of(elastic_identification()).items():
        files = images(each)
        assert files["png"].startswith(b"\x89PNG"), name
        assert b"<svg" in files["svg"], name
    once, again = (images(figures_of(identification())["check-check"]) for _ in range(2))
    assert once == again


def test_names_are_not_parsed_as_formulas() -> None:
    lines = [Line(np.arange(2.0), np.ones(2), name, "#0072B2") for name in ("$x", "$y$")]
    svg = images(figure(*lines, x="$t$", y="$q"))["svg"].decode()
    for text in ("$x", "$y$", "$t$", "$q"):
        assert text in svg


def test_the_caption_and_category_names_have_room() -> None:
    points = Markers(("one", "two"), np.array([1.0, 2.0]), "a", "#0072B2")
    plain = Markers(np.array([1.0, 2.0]), np.array([1.0, 2.0]), "a", "#0072B2")
    chart = draw(figure(points, caption="caption"))
    assert chart.get_suptitle() == "caption"
    assert chart.get_figheight() > draw(figure(plain)).get_figheight()
    labels = chart.axes[0].get_xticklabels()
    assert [(label.get_text(), label.get_rotation()) for label in labels] == [
        ("one", 90.0),
        ("two", 90.0),
    ]


def test_without_matplotlib_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InvalidInput, match="pip install matplotlib"):
        require_matplotlib()
