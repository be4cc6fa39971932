"""Bode plots: measured response and models agree, bands follow the covariance, modes are marked."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeGuard

import numpy as np
import pytest

from elastic_results import BAND, JOINT, SPREAD, joint_model, measured, response, sampled
from figure_parts import marks, names
from strainwave.domain import Diagnostic, Place
from strainwave.identification.joint_model.agreement import motor_response
from strainwave.report.document import bode
from strainwave.report.figures import Area, Colour, Figure, Line, Mark, Markers

RATIO = JOINT.gear_ratio


def line_of(figure: Figure, name: str, panel: int = 0) -> tuple[np.ndarray, np.ndarray]:
    (mark,) = (m for m in figure.panels[panel].marks if _is_point(m) and m.name == name)
    assert isinstance(mark, Line | Markers)
    return np.asarray(mark.x), mark.y


def _is_point(mark: Mark) -> TypeGuard[Line | Markers]:
    return isinstance(mark, Line | Markers)


def test_measured_response_and_models_agree() -> None:
    figure = bode.bode(joint_model(), RATIO, measured(), {"prbs": sampled()})
    # the held input of a sampled model adds a delay of half a sample: 9 degrees at the upper edge
    # of the band, and a small change of the modulus
    exact, held = (0.005, 0.1), (0.2, 10.0)
    for name, errors in (
        ("measured", exact),
        ("joint model", exact),
        ("state space, prbs", held),
    ):
        f, size = line_of(figure, name)
        truth = response(f)
        assert size == pytest.approx(20.0 * np.log10(np.abs(truth)), abs=errors[0])
        _, phase = line_of(figure, name, 1)
        assert phase == pytest.approx(np.rad2deg(np.angle(truth)), abs=errors[1])


def test_the_band_follows_from_the_covariance_of_the_parameters() -> None:
    """The response of random parameters scatters as the delta method predicts."""
    figure = bode.bode(joint_model(), RATIO, None)
    (band,) = marks(figure, Area)
    f, low, high = band.x, band.low, band.high
    rng = np.random.default_rng(3)
    A = [
        motor_response(JOINT.vector * (1.0 + SPREAD * rng.standard_normal(6)), JOINT.gear_ratio, f)
        for _ in range(2000)
    ]
    std = np.std(np.abs(A), axis=0) / np.abs(response(f))
    # first order holds away from the dip and the peak, where the response is steep
    plain = np.abs(f[:, None] - [joint.frequency_hz for joint in _modes()]).min(axis=1) > 6.0
    # 2000 draws estimate a standard deviation to 1.6 %, and the largest of many to about 5 %
    assert (10 ** (high / 20) / np.abs(response(f)) - 1.0)[plain] == pytest.approx(
        1.96 * std[plain], rel=0.08
    )
    assert (low <= high).all()


def _modes() -> list:  # type: ignore[type-arg]
    model = joint_model()
    return [model.anti_resonance, model.resonance]


def test_without_a_covariance_there_is_no_band() -> None:
    unknown = replace(joint_model(), covariance=np.full((6, 6), np.nan))
    figure = bode.bode(unknown, RATIO, None)
    assert not any(marks(figure, Area, panel) for panel in (0, 1))


def test_points_of_low_coherence_are_grey() -> None:
    figure = bode.bode(joint_model(), RATIO, measured())
    reliable, grey = marks(figure, Markers)
    assert (reliable.name, grey.name) == ("measured", "measured, unreliable")
    assert (grey.colour, reliable.colour) == (Colour.RESIDUAL, Colour.MEASURED)
    assert np.min(np.asarray(grey.x)) > 60.0
    f, _ = line_of(figure, "measured")
    assert max(f) <= 60.0
    assert names(figure, 2) == ["coherence"]
    assert "coherence" not in figure.legend
    unknown = bode.bode(joint_model(), RATIO, replace(measured(), coherence=None))
    assert len(unknown.panels) == 2
    assert max(line_of(unknown, "measured")[0]) > 100.0


def test_modes_are_marked_at_the_dip_and_the_peak() -> None:
    figure = bode.bode(joint_model(), RATIO, None)
    labels = {one.text.split(" ")[0]: one.x for one in figure.uprights}
    f, size = line_of(figure, "joint model")
    assert labels["anti-resonance"] == pytest.approx(f[np.argmin(size[f < 20])], rel=0.02)
    peak = f[f > 15.0][np.argmax(size[f > 15.0])]
    assert labels["resonance"] == pytest.approx(peak, rel=0.02)
    assert [one.x for one in figure.uprights[2:]] == list(BAND)


def test_a_long_response_is_decimated_evenly_over_log_frequency() -> None:
    f = np.linspace(0.1, 2000.0, 100_000)
    G = response(f)[:, None, None]
    response_ = replace(measured(), frequencies_hz=f, response=G, coherence=None)
    x, _ = line_of(bode.bode(joint_model(), RATIO, response_), "measured")
    assert 300 < len(x) <= 500
    steps = np.diff(np.log(x[x > 10.0]))
    assert steps.max() < 2.0 * steps.min()


def test_the_caption_has_the_modes_and_the_share_of_reliable_lines() -> None:
    caption = bode.describe(joint_model(), measured())
    assert caption.startswith("Anti-resonance 12.")
    assert "100 % of the measured lines" in caption


def test_a_prismatic_joint_has_its_own_units() -> None:
    figure = bode.bode(joint_model(), RATIO, None, is_prismatic=True)
    assert figure.panels[0].axis.title == "dB re m/s/N"


def test_the_whole_arm_fit_is_drawn_with_its_band_on_pale_measured_points() -> None:
    covariance = np.diag((0.01 * JOINT.vector) ** 2)
    whole_arm = bode.FittedJoint(1.1 * JOINT.vector, covariance)
    figure = bode.bode(joint_model(), RATIO, measured(), whole_arm=whole_arm)
    f, size = line_of(figure, "whole-arm fit")
    expected = motor_response(1.1 * JOINT.vector, JOINT.gear_ratio, f)
    assert size == pytest.approx(20.0 * np.log10(np.abs(expected)), abs=0.005)
    order = names(figure)
    assert order.index("measured") < order.index("joint model")  # the line is on top
    assert marks(figure, Markers)[0].opacity < 0.5
    assert {band.name for band in marks(figure, Area)} >= {"joint model", "whole-arm fit"}
    without = bode.bode(joint_model(), RATIO, None, whole_arm=replace(whole_arm, covariance=None))
    assert [band.name for band in marks(without, Area)] == ["joint model"]


def test_measured_points_have_the_band_of_their_scatter_or_coherence() -> None:
    """The relative standard deviation is that of simulated noise of uncertain variance."""
    noisy = replace(measured(), noise_variance=0.02**2 * np.abs(measured().response) ** 2)
    assert bode.relative_std(noisy) == pytest.approx(np.full(499, 0.02 / np.sqrt(2.0)))
    (band, _) = marks(bode.bode(joint_model(), RATIO, noisy), Area)
    assert band.name == "measured"
    width = np.log(10.0) / 40.0 * (band.high - band.low)  # half-width relative to the modulus
    assert width == pytest.approx(np.full(len(width), 1.96 * 0.02 / np.sqrt(2.0)), rel=1e-3)
    # 8 averages at a coherence of 0.99: sqrt(0.01 / (16 * 0.99))
    by_coherence = bode.relative_std(measured())
    assert by_coherence is not None
    assert by_coherence[0] == pytest.approx(0.02513, rel=1e-3)
    assert bode.relative_std(replace(measured(), coherence=None)) is None


def test_a_state_space_model_has_the_band_of_its_covariance() -> None:
    model = sampled()
    entries = sum(m.size for m in (model.A, model.B, model.C, model.D, model.K))
    uncertain = replace(model, covariance=1e-8 * np.eye(entries))
    figure = bode.bode(joint_model(), RATIO, None, {"prbs": uncertain})
    assert "state space, prbs" in {band.name for band in marks(figure, Area)}
    figure = bode.bode(joint_model(), RATIO, None, {"prbs": model})
    assert "state space, prbs" not in {band.name for band in marks(figure, Area)}


def test_the_caption_repeats_the_warning_that_model_and_response_differ() -> None:
    apart = Diagnostic(
        "response-apart", Place(joint=1), share=0.5, difference_db=3.0, frequency_hz=7.0
    )
    caption = bode.describe(replace(joint_model(), warnings=(apart,)), measured())
    assert caption.endswith("by 3 dB near 7 Hz.")
    assert "Warning" not in bode.describe(joint_model(), measured())
