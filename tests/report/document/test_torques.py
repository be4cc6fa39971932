"""Interaction torques: the record with the largest share, and spectra at known lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_results import decoupled, elastic_identification, record_model
from figure_parts import marks
from strainwave.report.document import elastic
from strainwave.report.figures import Line


def test_the_record_with_the_largest_share_is_shown() -> None:
    (record,) = elastic.interaction_records(elastic_identification())
    assert record.experiment.name == "prbs-j1"
    assert elastic.interaction_share(record) == pytest.approx(0.5, rel=1e-6)
    assert "50 % of the motor torque" in elastic.describe_interaction(record)


def test_sweeps_and_joints_without_interaction_are_left_out() -> None:
    high_variance = replace(
        record_model("sweep", 9.0), signals=decoupled("sweep", 9.0, use="sweep")
    )
    single = decoupled("single", 9.0)
    alone = replace(high_variance, signals=replace(single, inputs=single.inputs[:, :1]))
    assert (
        elastic.interaction_records(
            replace(elastic_identification(), records=(high_variance, alone))
        )
        == []
    )


def test_both_torques_are_drawn_at_the_motor() -> None:
    motor, other = marks(elastic.torque_figure(decoupled("a", 0.5)), Line)
    assert motor.x.max() <= 0.5
    # decimated rows hold the extremes of either line in each bin
    assert (motor.y.max(), other.y.max()) == pytest.approx((1.0, 0.5), rel=3e-3)


def test_the_spectra_peak_at_the_frequencies_of_the_torques() -> None:
    figure = marks(elastic.torque_spectrum(decoupled("a", 0.5)), Line)
    for one, line in zip(figure, (10.0, 20.0), strict=True):
        f, density = one.x, one.y
        assert f[np.argmax(density)] == pytest.approx(line, abs=f[1] - f[0])
        assert f.max() <= 200.0  # five times the band in which the motor moves
