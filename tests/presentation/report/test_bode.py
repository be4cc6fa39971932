"""Bode plots: three ways to one response agree, the band is the parameters', marks are the modes."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeGuard

import numpy as np
import pytest

from elastic_results import BAND, JOINT, SPREAD, joint_model, measured, response, sampled
from figure_parts import marks, names
from strainwave.domain import Diagnostic
from strainwave.identification.joint_model.agreement import motor_response
from strainwave.presentation.figures import MEASURED, RESIDUAL, Band, Figure, Line, Mark, Markers
from strainwave.presentation.report import bode

RATIO = JOINT.gear_ratio


def line_of(drawn: Figure, name: str, panel: int = 0) -> tuple[np.ndarray, np.ndarray]:
    (found,) = (m for m in drawn.panels[panel].marks if _is_point(m) and m.name == name)
    assert isinstance(found, Line | Markers)
    return np.asarray(found.x), found.y


def _is_point(mark: Mark) -> TypeGuard[Line | Markers]:
    return isinstance(mark, Line | Markers)


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
        _, phase = line_of(drawn, name, 1)
        assert phase == pytest.approx(np.rad2deg(np.angle(truth)), abs=errors[1])


def test_the_band_is_that_of_the_parameters() -> None:
    """Drawn parameters scatter as the delta method says."""
    drawn = bode.bode(joint_model(), RATIO, None)
    (band,) = marks(drawn, Band)
    f, low, high = band.x, band.low, band.high
    rng = np.random.default_rng(3)
    A = [
        motor_response(JOINT.vector * (1.0 + SPREAD * rng.standard_normal(6)), JOINT.gear_ratio, f)
        for _ in range(2000)
    ]
    std = np.std(np.abs(A), axis=0) / np.abs(response(f))
    # away from dip and peak, where two per cent are much, first order holds
    plain = np.abs(f[:, None] - [joint.frequency_hz for joint in _modes()]).min(axis=1) > 6.0
    # 2000 draws give a deviation to 1.6 %, their largest error among many to some 5 %
    assert (10 ** (high / 20) / np.abs(response(f)) - 1.0)[plain] == pytest.approx(
        1.96 * std[plain], rel=0.08
    )
    assert (low <= high).all()


def _modes() -> list:  # type: ignore[type-arg]
    model = joint_model()
    return [model.anti_resonance, model.resonance]


def test_no_band_without_a_covariance() -> None:
    unknown = replace(joint_model(), covariance=np.full((6, 6), np.nan))
    drawn = bode.bode(unknown, RATIO, None)
    assert not any(marks(drawn, Band, panel) for panel in (0, 1))


def test_what_is_not_coherent_is_grey() -> None:
    drawn = bode.bode(joint_model(), RATIO, measured())
    sure, grey = marks(drawn, Markers)
    assert (sure.name, grey.name) == ("measured", "measured, doubtful")
    assert (grey.colour, sure.colour) == (RESIDUAL, MEASURED)
    assert np.min(np.asarray(grey.x)) > 60.0
    f, _ = line_of(drawn, "measured")
    assert max(f) <= 60.0
    assert names(drawn, 2) == ["coherence"]
    assert "coherence" not in drawn.legend
    unknown = bode.bode(joint_model(), RATIO, replace(measured(), coherence=None))
    assert len(unknown.panels) == 2
    assert max(line_of(unknown, "measured")[0]) > 100.0


def test_modes_are_marked_where_the_response_dips_and_peaks() -> None:
    drawn = bode.bode(joint_model(), RATIO, None)
    words = {one.text.split(" ")[0]: one.x for one in drawn.uprights}
    f, size = line_of(drawn, "physical model")
    assert words["anti-resonance"] == pytest.approx(f[np.argmin(size[f < 20])], rel=0.02)
    peak = f[f > 15.0][np.argmax(size[f > 15.0])]
    assert words["resonance"] == pytest.approx(peak, rel=0.02)
    assert [one.x for one in drawn.uprights[2:]] == list(BAND)


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
    assert drawn.panels[0].axis.title == "dB re m/s/N"


def test_the_whole_arm_fit_is_drawn_over_pale_measured_points() -> None:
    tuned = {name: 1.1 * value for name, value in joint_model().values.items()}
    drawn = bode.bode(joint_model(), RATIO, measured(), tuned=tuned)
    f, size = line_of(drawn, "whole-arm fit")
    expected = motor_response(1.1 * JOINT.vector, JOINT.gear_ratio, f)
    assert size == pytest.approx(20.0 * np.log10(np.abs(expected)), abs=0.005)
    order = names(drawn)
    assert order.index("measured") < order.index("physical model")  # the line lies on top
    assert marks(drawn, Markers)[0].opacity < 0.5


def test_the_words_repeat_the_warning_that_model_and_points_differ() -> None:
    apart = Diagnostic("response-apart", "joint 1", "they differ near 7 Hz")
    said = bode.words(replace(joint_model(), warnings=(apart,)), measured())
    assert said.endswith("Warning: they differ near 7 Hz.")
    assert "Warning" not in bode.words(joint_model(), measured())
