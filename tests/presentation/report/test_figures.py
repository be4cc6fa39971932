"""Figures lose no peak, keep gaps, and stack without overlap."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from results import prediction
from strainwave.presentation.report import figures, predictions
from strainwave.presentation.report.figures import Figure
from virtual_arms import rigid_drive


def trace(drawn: Figure, name: str) -> Figure:
    found: Figure = next(t for t in drawn["data"] if t["name"] == name)
    return found


def test_thinning_keeps_every_peak_of_every_line() -> None:
    long = prediction("motion", 90.0)
    long.measured[3333, 0] = 50.0
    long.measured[4444, 0] = -50.0
    long.predicted[2222, 0] = 70.0
    drawn = predictions.of_prediction(long)
    assert (max(trace(drawn, "measured")["y"]), min(trace(drawn, "measured")["y"])) == (50.0, -50.0)
    assert max(trace(drawn, "model")["y"]) == 70.0
    assert min(trace(drawn, "difference")["y"]) < -68.0
    assert len(trace(drawn, "measured")["x"]) <= figures.MOST_POINTS


def test_a_short_line_is_left_alone() -> None:
    assert figures.thinned(np.arange(100.0)).tolist() == list(range(100))
    assert len(figures.thinned(np.arange(5000.0), 300)) <= 300


def test_gaps_stay_gaps() -> None:
    gappy = prediction("motion", 90.0)
    gappy.measured[100:200] = np.nan
    assert None in trace(predictions.of_prediction(gappy), "measured")["y"]


def test_each_channel_has_a_panel_and_the_legend_one_entry_a_name() -> None:
    drawn = predictions.of_prediction(prediction("motion", 90.0, 80.0))
    assert {t["yaxis"] for t in drawn["data"]} == {"y", "y2"}
    shown = [t["name"] for t in drawn["data"] if t["showlegend"]]
    assert shown == ["difference", "measured", "model"]


def test_one_channel_can_be_asked_for() -> None:
    two = prediction("motion", 90.0, 80.0)
    drawn = predictions.of_prediction(two, channels=("torque2",))
    assert drawn["layout"]["yaxis"]["title"]["text"] == "torque2 [N m]"
    assert {t["yaxis"] for t in drawn["data"]} == {"y"}
    assert trace(drawn, "measured")["y"][0] == pytest.approx(two.measured[0, 1], abs=1e-5)


def test_panels_do_not_overlap() -> None:
    layout = figures.panels("x", ["a", "b", "c"], heights=[2.0, 1.0, 1.0])
    domains = [layout[name]["domain"] for name in ("yaxis", "yaxis2", "yaxis3")]
    assert (domains[0][1], domains[2][0]) == (1.0, pytest.approx(0.0, abs=1e-4))
    for upper, lower in pairwise(domains):
        assert upper[0] > lower[1]
    sizes = [high - low for low, high in domains]
    assert sizes[0] == pytest.approx(2.0 * sizes[1], abs=1e-3)
    assert layout["xaxis"]["anchor"] == "y3"


def test_a_sliding_joint_has_newtons() -> None:
    slides = [replace(rigid_drive().arm.joints[0], motion="prismatic")]
    assert predictions.unit_of("torque1") == "N m"
    assert predictions.unit_of("torque1", slides) == "N"
    assert predictions.unit_of("omega_m2", slides) == "rad/s"


def test_words_on_a_logarithmic_axis_stand_at_the_logarithm() -> None:
    mark = figures.upright(100.0, "here", log=True)
    assert (mark["shapes"][0]["x0"], mark["annotations"][0]["x"]) == (100.0, 2.0)
    assert figures.upright(100.0, "")["annotations"] == []
