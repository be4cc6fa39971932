"""Figures as Plotly JSON: panels, rounding, gaps, legends and marks."""

from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import pytest

from elastic_results import elastic_identification
from strainwave.report.document import figures_of
from strainwave.report.figures import (
    DOTTED,
    SOLID,
    Area,
    Axis,
    Bars,
    Colour,
    Figure,
    HeatMap,
    Line,
    Markers,
    Panel,
    Upright,
)
from strainwave.report.plotly_backend import plotly, rounded

X = np.array([1.0, 2.0, 3.0])
LINE = Line(X, X, "a", Colour.MODEL)


def figure(*marks: object, **changed: object) -> Figure:
    return Figure(Axis("x"), (Panel(Axis("y"), marks),), **changed)  # type: ignore[arg-type]


def test_panels_have_their_relative_heights_and_do_not_overlap() -> None:
    panels = tuple(
        Panel(Axis(name), (LINE,), height) for name, height in zip("abc", (2, 1, 1), strict=True)
    )
    layout = plotly(Figure(Axis("x"), panels))["layout"]
    domains = [layout[name]["domain"] for name in ("yaxis", "yaxis2", "yaxis3")]
    assert (domains[0][1], domains[2][0]) == (1.0, pytest.approx(0.0, abs=1e-4))
    for upper, lower in pairwise(domains):
        assert upper[0] > lower[1]
    sizes = [high - low for low, high in domains]
    assert sizes[0] == pytest.approx(2.0 * sizes[1], abs=1e-3)
    assert layout["xaxis"]["anchor"] == "y3"
    assert [layout[name]["title"]["text"] for name in ("yaxis", "yaxis2", "yaxis3")] == [*"abc"]


def test_numbers_have_five_digits_of_the_largest_and_gaps_are_null() -> None:
    assert rounded(np.array([123.456789, 1.0, np.nan])) == [123.457, 1.0, None]
    assert rounded(np.array([np.nan, np.inf])) == [None, None]
    late = 1e5 + 1e-3 * np.arange(4.0)  # [s] a zoom into a long record
    assert np.diff(np.array(rounded(late), float)) == pytest.approx(1e-3)
    (trace,) = plotly(figure(Line(X, np.array([1.0, np.nan, 3.0]), "a", Colour.MODEL)))["data"]
    assert trace["y"] == [1.0, None, 3.0]


def test_each_name_is_one_legend_entry_together_with_its_band() -> None:
    other = Line(X, X, "b", Colour.MEASURED, legend=False)
    chart = Figure(
        Axis("x"),
        (
            Panel(Axis("y"), (Area(X, X, X, Colour.MODEL, "a"), LINE, other)),
            Panel(Axis("y"), (LINE, Markers(X, X, "c", Colour.MEASURED))),
        ),
    )
    data = plotly(chart)["data"]
    assert [t["name"] for t in data] == ["a", "a", "b", "a", "c"]
    assert [t["showlegend"] for t in data] == [False, True, False, False, True]
    assert [t["legendgroup"] for t in data] == ["a", "a", "b", "a", "c"]
    assert [t["yaxis"] for t in data] == ["y", "y", "y", "y2", "y2"]
    assert [t["showlegend"] for t in plotly(figure(LINE))["data"]] == [False]


def test_labels_on_a_logarithmic_axis_are_placed_at_the_logarithm() -> None:
    panels = (Panel(Axis("y"), (LINE,)), Panel(Axis("y"), (LINE,)))
    uprights = (Upright(100.0, "here", panel=1, height=0.5, dash=SOLID), Upright(10.0))
    layout = plotly(Figure(Axis("x", log=True), panels, uprights))["layout"]
    assert [shape["x0"] for shape in layout["shapes"]] == [100.0, 10.0]
    assert [shape["line"]["dash"] for shape in layout["shapes"]] == ["solid", "3px,3px"]
    (word,) = layout["annotations"]
    low, high = layout["yaxis2"]["domain"]
    assert (word["x"], word["y"]) == (2.0, pytest.approx(0.5 * (low + high)))
    assert Upright(1.0).dash == DOTTED


def test_frequency_ticks_have_complete_labels_with_prefixes() -> None:
    axis = plotly(Figure(Axis("x", log=True), (Panel(Axis("y"), (LINE,)),)))["layout"]["xaxis"]
    shown = dict(zip(axis["tickvals"], axis["ticktext"], strict=True))
    assert [shown[v] for v in (0.05, 0.1, 2.0, 50.0, 1e3, 2e4, 5e6)] == [
        "50m", "100m", "2", "50", "1k", "20k", "5M",
    ]  # fmt: skip


def test_a_band_is_a_closed_outline() -> None:
    (trace,) = plotly(figure(Area(X, X - 1.0, X + 1.0, "#102030", "a")))["data"]
    assert trace["x"] == [1.0, 2.0, 3.0, 3.0, 2.0, 1.0]
    assert trace["y"] == [0.0, 1.0, 2.0, 4.0, 3.0, 2.0]
    assert trace["fillcolor"] == "rgba(16,32,48,0.18)"
    assert trace["hoverinfo"] == "skip"


def test_bars_error_bars_and_heat_maps() -> None:
    (bars,) = plotly(figure(Bars(X, X, 0.5, "a", Colour.MEASURED)))["data"]
    assert (bars["type"], bars["width"]) == ("bar", 0.5)
    (points,) = plotly(figure(Markers(X, X, "a", Colour.MEASURED, error=0.1 * X)))["data"]
    assert points["error_y"]["array"] == pytest.approx([0.1, 0.2, 0.3])
    (joined,) = plotly(figure(Line(X, X, "a", Colour.MEASURED, size=6.0)))["data"]
    assert joined["mode"] == "lines+markers"
    heat = HeatMap(("one", "two"), np.eye(2), -1.0, 1.0, (Colour.MEASURED, "#FFFFFF", Colour.MODEL))
    chart = plotly(figure(heat))
    assert chart["data"][0]["z"] == [[1.0, 0.0], [0.0, 1.0]]
    assert [at for at, _ in chart["data"][0]["colorscale"]] == [0.0, 0.5, 1.0]
    assert chart["layout"]["yaxis"]["autorange"] == "reversed"
    assert chart["layout"]["margin"]["l"] > 10


def test_category_names_are_vertical() -> None:
    chart = plotly(figure(Markers(("one", "two"), X[:2], "a", Colour.MEASURED)))
    assert chart["data"][0]["x"] == ["one", "two"]
    assert chart["layout"]["xaxis"]["tickangle"] == -90


def test_every_figure_of_a_report_is_json() -> None:
    for name, chart in figures_of(elastic_identification()).items():
        document = plotly(chart)
        assert json.loads(json.dumps(document, allow_nan=False)) == document, name


def test_many_panels_have_two_line_titles_and_low_ones_few_ticks() -> None:
    panels = tuple(Panel(Axis("speed [rad/s]"), (LINE,), height) for height in (1.0, 0.4) * 2)
    layout = plotly(Figure(Axis("x"), panels))["layout"]
    assert layout["yaxis"]["title"]["text"] == "speed<br>[rad/s]"
    assert "nticks" not in layout["yaxis"]
    assert layout["yaxis2"]["nticks"] == 3
    few = plotly(Figure(Axis("x"), panels[:2]))["layout"]
    assert few["yaxis"]["title"]["text"] == "speed [rad/s]"


def test_lines_keep_every_vertex() -> None:
    """Plotly's simplification displaces the knees of a stiffness curve by tens of pixels."""
    for name, chart in figures_of(elastic_identification()).items():
        lines = [t["line"] for t in plotly(chart)["data"] if "lines" in t.get("mode", "")]
        bands = [line for line in lines if line["width"] == 0]
        assert all(line["simplify"] is False for line in lines if line not in bands), name


def test_symbols_and_decades() -> None:
    cross, plain = Markers(X, X, "a", Colour.MODEL, symbol="x"), Markers(X, X, "b", Colour.MODEL)
    data = plotly(figure(cross, plain))["data"]
    assert data[0]["marker"]["symbol"] == "x-thin-open"
    assert "symbol" not in data[1]["marker"]
    for top, has_digits in ((5.0, True), (500.0, False)):
        line = Line(X, np.array([1.0, 2.0, top]), "a", Colour.MODEL)
        axis = plotly(Figure(Axis("x"), (Panel(Axis("y", log=True), (line,)),)))["layout"]["yaxis"]
        assert ("dtick" not in axis) == has_digits
