"""The responses over the amplitude, and how each link's motion was found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_results import BAND, elastic_identification, record_model, response
from figure_parts import line, names
from strainwave.domain import Delay, Fusion, Identification, LinkSummary, Prbs, RecordModel, Use
from strainwave.presentation.report import amplitudes, elastic, render


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


def test_models_are_drawn_by_amplitude_within_their_band() -> None:
    drawn = amplitudes.responses(amplitudes.swept(swept())[1])
    assert names(drawn) == names(drawn, 1) == ["2 V, slow", "10 V, prbs-j1"]
    slow = line(drawn, "2 V, slow")
    f = slow.x
    assert f[0] >= 0.999 * BAND[0]
    assert f[-1] <= 1.001 * BAND[1]
    # a held input's model is that of the joint where it rings
    true = 20.0 * np.log10(np.abs(response(f)))
    assert np.max(np.abs(slow.y - true)) < 1.0


def test_without_a_sweep_nothing_is_drawn() -> None:
    assert amplitudes.swept(elastic_identification()) == {}


def test_links_have_a_row_each() -> None:
    row = ("1", "slow", "accelerometer", "0.36", "0.0005", "0.042 ± 0.020", "")
    assert elastic.link_rows(swept()) == [row]


def test_the_page_shows_both() -> None:
    page = render(swept())
    assert "Joint 1 over the amplitude" in page
    assert "motion was found" in page
    assert "0.042 ± 0.020" in page
