"""Residual analysis: correlations of check records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_results import SAMPLE, elastic_identification, log, record_model
from figure_parts import line, marks
from strainwave.domain import Identification, ModelCheck, Prediction
from strainwave.report.document import residuals
from strainwave.report.document.blocks import FigureName, Fold, Plot
from strainwave.report.figures import Area


def checked(delay: int) -> Identification:
    """A check record whose residual is the voltage, `delay` samples later, and noise."""
    one = log("check")
    drive = np.random.default_rng(5).standard_normal(len(one))
    channels = dict(one.channels) | {"u1": drive}
    noise = 0.1 * np.random.default_rng(6).standard_normal(len(one))
    left = np.concatenate([np.zeros(delay), drive[: len(drive) - delay]]) + noise
    zero = np.zeros((len(one), 1))
    prediction = Prediction("check", one.time, ("a1",), left[:, None], zero, {"a1": 50.0})
    logs = (log("prbs-j1"), replace(one, channels=channels))
    return replace(elastic_identification(), checks=(prediction,), logs=logs)


def test_check_records_have_their_correlations_at_the_lags_of_the_fit() -> None:
    plots = [p for p in residuals.residual_correlations(checked(10)) if isinstance(p, Plot)]
    (plot,) = plots
    assert plot.name == FigureName("correlation", experiment="check")
    auto = line(plot.figure, "autocorrelation")
    assert np.diff(auto.x) == pytest.approx(5.0)  # [ms] lag time of the fitted record
    assert auto.y[len(auto.y) // 2] == pytest.approx(1.0)
    cross = line(plot.figure, "input of joint 1", 1)
    assert cross.x[np.argmax(cross.y)] == pytest.approx(1e3 * 10 * SAMPLE)
    band = next(b for b in marks(plot.figure, Area, 1) if b.name == "input of joint 1")
    assert cross.y.max() > 5.0 * band.high[0]  # far outside the limits


def test_limits_of_the_autocorrelation_need_the_same_sample_time() -> None:
    one = checked(0)
    (plot,) = (p for p in residuals.residual_correlations(one) if isinstance(p, Plot))
    assert len(marks(plot.figure, Area)) == 1
    fitted = replace(one.logs[0], sample_time=2.0 * SAMPLE)
    other = replace(one, logs=(fitted, one.logs[1]))
    (plot,) = (p for p in residuals.residual_correlations(other) if isinstance(p, Plot))
    assert marks(plot.figure, Area) == []


def test_fitted_records_and_state_space_models_are_folded() -> None:
    check = ModelCheck(
        fit_percent=(99.0, 99.0),
        prediction_fit_percent=(99.0, 99.0),
        tests=(),
        autocorrelation=np.exp(-np.arange(26.0))[:, None, None] * np.eye(2),
        cross_correlation=np.zeros((51, 2, 2)),
        confidence_99=0.1,
    )
    record = replace(record_model("prbs-j1", 0.5), check=check)
    one = replace(elastic_identification(), records=(record,), checks=())
    fitted, models = residuals.residual_correlations(one)
    assert isinstance(fitted, Fold)
    assert isinstance(models, Fold)
    (plot,) = models.blocks
    assert isinstance(plot, Plot)
    assert len(plot.figure.panels) == 4  # two outputs, each with auto- and cross-correlation
    (band,) = marks(plot.figure, Area)
    assert band.high[0] == pytest.approx(0.1)
    assert line(plot.figure, "autocorrelation").y[25] == 1.0
