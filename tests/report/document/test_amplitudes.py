"""Amplitude dependence: responses, equivalent stiffness with its trend test, link motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_results import BAND, elastic_identification, record_model, response
from figure_parts import line, names
from strainwave.domain import (
    Delay,
    Fusion,
    Identification,
    LinkSummary,
    Prbs,
    RecordModel,
    Sweep,
    SweepPoint,
    Use,
)
from strainwave.report.document import elastic, render


def recorded(name: str, use: Use, amplitude: float) -> RecordModel:
    one = record_model(name, 0.5)
    prbs = Prbs(9, 1e-3, 3, amplitude)
    experiment = replace(one.signals.experiment, use=use, prbs=prbs)
    return replace(one, signals=replace(one.signals, experiment=experiment))


def swept() -> Identification:
    records = [recorded("prbs-j1", "frequency", 10.0), recorded("slow", "sweep", 2.0)]
    link = LinkSummary(
        experiment="slow",
        joint=1,
        source="accelerometer",
        fusion=Fusion(0.2, 2),
        fusion_error=5e-4,
        bias=0.36,
        sensor_delay=Delay(4.2e-5, 2e-5),
        drive_delay=None,
    )
    return replace(elastic_identification(), records=tuple(records), links=(link,))


def test_joint_models_are_drawn_by_amplitude_within_their_band() -> None:
    figure = elastic.response_figure(elastic.swept_records(swept())[1])
    assert names(figure) == names(figure, 1) == ["2 V, slow", "10 V, prbs-j1"]
    slow = line(figure, "2 V, slow")
    f = slow.x
    assert f[0] >= 0.999 * BAND[0]
    assert f[-1] <= 1.001 * BAND[1]
    true = 20.0 * np.log10(np.abs(response(f)))
    assert slow.y == pytest.approx(true, abs=1e-6)


def test_without_a_sweep_there_is_no_figure() -> None:
    assert elastic.swept_records(elastic_identification()) == {}


@pytest.mark.parametrize(
    ("rise", "trend"), [(300.0, "hardening"), (-300.0, "softening"), (1.0, "no significant trend")]
)
def test_the_stated_trend_follows_from_the_printed_number(rise: float, trend: str) -> None:
    volts = (2.0, 4.0, 6.0, 8.0)
    points = tuple(
        SweepPoint(f"{v:g} V", v, 6000.0 + rise * v, 50.0, 4.0 * (6000.0 + rise * v), 200.0)
        for v in volts
    )
    std = 50.0 / np.sqrt(np.sum((np.array(volts) - 5.0) ** 2))
    verdict = "no-trend" if trend.startswith("no") else trend
    sweep = Sweep(1, points, rise, std, verdict)  # type: ignore[arg-type]
    title, caption = elastic.trend_title(sweep), elastic.describe_trend(sweep)
    assert title == f"{trend} ({abs(rise) / std:.1f} standard errors)"
    assert f"{abs(rise) / std:.1f} standard errors from zero" in caption
    assert "significant from 3 standard errors" in caption
    figure = elastic.stiffness_figure(sweep)
    # the line of the squared anti-resonance, scaled to the stiffness, passes through the points
    line_ = line(figure, "weighted line")
    assert line_.y == pytest.approx([4.0 * (6000.0 + rise * v) for v in (2.0, 8.0)])


def test_each_link_has_a_row() -> None:
    row = ("1", "slow", "accelerometer", "0.36", "0.0005", "0.042 ± 0.020", "")
    assert elastic.link_rows(swept()) == [row]


def test_the_page_has_both() -> None:
    page = render(swept())
    assert "Joint 1, response by amplitude" in page
    assert "Link motion of each record" in page
    assert "0.042 ± 0.020" in page
