"""Bode plots: three ways to one response agree, the band is the parameters', marks are the modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_results import BAND, JOINT, SPREAD, joint_model, measured, response, sampled
from strainwave.domain import Diagnostic
from strainwave.identification.joint_model.agreement import motor_response
from strainwave.presentation.report import bode
from strainwave.presentation.report.figures import RESIDUAL, Figure

RATIO = JOINT.gear_ratio


def traces(drawn: Figure, name: str, panel: str = "y") -> list[Figure]:
    return [t for t in drawn["data"] if t["name"] == name and t["yaxis"] == panel]


def line_of(drawn: Figure, name: str, panel: str = "y") -> tuple[np.ndarray, np.ndarray]:
    (found,) = traces(drawn, name, panel)
    return np.array(found["x"]), np.array(found["y"])


def test_measured_and_both_models_are_one_curve() -> None:
    drawn = bode.bode(joint_model(), RATIO, measured(), [("prbs", sampled())])
    # numbers of a figure have five digits; the held input of a sampled model costs half a sample,
    # 9 degrees at the band's upper edge, and hardly any size
    exact, held = (0.005, 0.1), (0.2, 10.0)
    for name, errors in (
        ("measured", exact),
        ("physical model", exact),
        ("state space, prbs", held),
    ):
        f, size = line_of(drawn, name)
        truth = response(f)
        assert size == pytest.approx(20.0 * np.log10(np.abs(truth)), abs=errors[0])
        _, phase = line_of(drawn, name, "y2")
        assert phase == pytest.approx(np.rad2deg(np.angle(truth)), abs=errors[1])


def test_the_band_is_that_of_the_parameters() -> None:
    """Drawn parameters scatter as the delta method says."""
    drawn = bode.bode(joint_model(), RATIO, None)
    (fill,) = (t for t in drawn["data"] if t.get("fill") and t["yaxis"] == "y")
    half = len(fill["x"]) // 2
    low, high = np.array(fill["y"][:half]), np.array(fill["y"][half:])[::-1]
    f = np.array(fill["x"][:half])
    rng = np.random.default_rng(3)
    A = [
        motor_response(JOINT.vector * (1.0 + SPREAD * rng.standard_normal(6)), JOINT.gear_ratio, f)
        for _ in range(2000)
    ]
    std = np.std(np.abs(A), axis=0) / np.abs(response(f))
    # away from dip and peak, where two per cent are much, first order holds
    plain = np.abs(f[:, None] - [joint.frequency_hz for joint in _modes()]).min(axis=1) > 6.0
    # 2000 draws tell a deviation to 1.6 %, their largest error among many to some 5 %
    assert (10 ** (high / 20) / np.abs(response(f)) - 1.0)[plain] == pytest.approx(
        1.96 * std[plain], rel=0.08
    )
    assert (low <= high).all()


def _modes() -> list:  # type: ignore[type-arg]
    model = joint_model()
    return [model.anti_resonance, model.resonance]


def test_no_band_without_a_covariance() -> None:
    unknown = replace(joint_model(), covariance=np.full((6, 6), np.nan))
    assert not any(t.get("fill") for t in bode.bode(unknown, RATIO, None)["data"])


def test_what_is_not_coherent_is_grey() -> None:
    drawn = bode.bode(joint_model(), RATIO, measured())
    (grey,) = traces(drawn, "measured, doubtful")
    assert grey["marker"]["color"] == RESIDUAL
    assert min(grey["x"]) > 60.0
    f, _ = line_of(drawn, "measured")
    assert max(f) <= 60.0
    assert len(traces(drawn, "coherence", "y3")) == 1
    unknown = bode.bode(joint_model(), RATIO, replace(measured(), coherence=None))
    assert "yaxis3" not in unknown["layout"]
    assert max(line_of(unknown, "measured")[0]) > 100.0


def test_modes_are_marked_where_the_response_dips_and_peaks() -> None:
    drawn = bode.bode(joint_model(), RATIO, None)
    words = {a["text"].split(" ")[0]: 10.0 ** a["x"] for a in drawn["layout"]["annotations"]}
    f, size = line_of(drawn, "physical model")
    assert words["anti-resonance"] == pytest.approx(f[np.argmin(size[f < 20])], rel=0.02)
    peak = f[f > 15.0][np.argmax(size[f > 15.0])]
    assert words["resonance"] == pytest.approx(peak, rel=0.02)
    assert [s["x0"] for s in drawn["layout"]["shapes"][2:]] == list(BAND)


def test_a_long_response_is_thinned_evenly_on_its_axis() -> None:
    f = np.linspace(0.1, 2000.0, 100_000)
    G = response(f)[:, None, None]
    found = replace(measured(), frequencies_hz=f, response=G, coherence=None)
    x, _ = line_of(bode.bode(joint_model(), RATIO, found), "measured")
    assert 300 < len(x) <= 500
    steps = np.diff(np.log(x[x > 10.0]))
    assert steps.max() < 2.0 * steps.min()


def test_the_words_say_where_it_rings_and_what_was_seen() -> None:
    said = bode.words(joint_model(), measured())
    assert said.startswith("Anti-resonance at 12.")
    assert "100 % of the measured lines" in said


def test_a_sliding_joint_has_its_own_units() -> None:
    drawn = bode.bode(joint_model(), RATIO, None, straight=True)
    title = drawn["layout"]["yaxis"]["title"]["text"]
    assert title == "dB re m/s/N"


def test_the_whole_arm_fit_is_drawn_over_pale_measured_points() -> None:
    tuned = {name: 1.1 * value for name, value in joint_model().values.items()}
    drawn = bode.bode(joint_model(), RATIO, measured(), tuned=tuned)
    f, size = line_of(drawn, "whole-arm fit")
    expected = motor_response(1.1 * JOINT.vector, JOINT.gear_ratio, f)
    assert size == pytest.approx(20.0 * np.log10(np.abs(expected)), abs=0.005)
    names = [t["name"] for t in drawn["data"]]
    assert names.index("measured") < names.index("physical model")  # the line lies on top
    assert traces(drawn, "measured")[0]["marker"]["opacity"] < 0.5


def test_the_words_repeat_the_warning_that_model_and_points_differ() -> None:
    apart = Diagnostic("response-apart", "joint 1", "they differ near 7 Hz")
    said = bode.words(replace(joint_model(), warnings=(apart,)), measured())
    assert said.endswith("Warning: they differ near 7 Hz.")
    assert "Warning" not in bode.words(joint_model(), measured())


def test_frequencies_have_whole_labels_with_prefixes() -> None:
    axis = bode.bode(joint_model(), RATIO, None)["layout"]["xaxis"]
    shown = dict(zip(axis["tickvals"], axis["ticktext"], strict=True))
    assert [shown[v] for v in (0.05, 0.1, 2.0, 50.0, 1e3, 2e4, 5e6)] == [
        "50m", "100m", "2", "50", "1k", "20k", "5M",
    ]  # fmt: skip
