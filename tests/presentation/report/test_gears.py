"""Stiffness curves: torsion and slope belong together, and so do their bands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_results import CURVE, curve_parameters, elastic_identification, joint_model
from figure_parts import line, marks
from strainwave.domain import FloatArray
from strainwave.presentation.figures import Bars
from strainwave.presentation.report import gears
from strainwave.presentation.report.gears import Curve


def curve() -> Curve:
    found = gears.curves(elastic_identification())
    assert [one.joint for one in found] == [1]  # nothing is known of the other
    return found[0]


def test_the_slope_of_the_torsion_is_one_over_the_stiffness() -> None:
    torque: FloatArray = np.linspace(0.0, 60.0, 6001)
    torsion, _ = gears.torsion_at(curve(), torque)
    slope = np.gradient(torque, torsion)
    for low, high, expected in ((0.0, 6.9, 16000.0), (7.1, 24.9, 25000.0), (25.1, 60.0, 29000.0)):
        inside = (torque > low) & (torque < high)
        assert slope[inside] == pytest.approx(expected, rel=1e-9)


def test_the_torsion_scatters_as_its_deviation_says() -> None:
    rng = np.random.default_rng(5)
    torque = np.array([3.0, 15.0, 50.0])
    drawn, found = [], curve()
    for _ in range(4000):
        values = [v + s * rng.standard_normal() for v, s in CURVE.values()]
        one = replace(found, values=dict(zip(CURVE, values, strict=True)))
        drawn.append(gears.torsion_at(one, torque)[0])
    _, std = gears.torsion_at(found, torque)
    assert std == pytest.approx(np.std(drawn, axis=0), rel=0.05)  # of 4000 draws: 1.1 %


def test_what_was_not_reported_is_not_drawn() -> None:
    one = elastic_identification()
    assert one.tuned is not None
    parameters, covariance = curve_parameters(gear_stiffness_k3=None, gear_knee_t2=None)
    two = replace(one, tuned=replace(one.tuned, parameters=parameters, covariance=covariance))
    found = gears.curves(two)[0]
    assert found.values == {
        "gear_stiffness_k1": 16000.0,
        "gear_stiffness_k2": 25000.0,
        "gear_knee_t1": 7.0,
    }
    assert found.knees.tolist() == [7.0]
    assert found.covariance.shape == (3, 3)


def test_without_the_whole_arm_the_joint_shows_one_slope() -> None:
    found = gears.curves(replace(elastic_identification(), tuned=None))[0]
    assert found.values == {"gear_stiffness": 25000.0}
    assert found.is_equivalent
    assert found.covariance[0, 0] == pytest.approx(joint_model().covariance[4, 4])
    assert found.gear_loads is None
    assert "One stiffness for the whole" in gears.words(found)
    assert len(gears.slope_figure(found).panels) == 1


def test_both_figures_show_the_knees_and_the_records() -> None:
    slope, torsion = gears.slope_figure(curve()), gears.torsion_figure(curve())
    assert [one.x for one in slope.uprights] == [7.0, 25.0]
    knees = [1e3 * 7.0 / 16000.0, 1e3 * (7.0 / 16000.0 + 18.0 / 25000.0)]
    assert [one.x for one in torsion.uprights] == pytest.approx(knees)
    (bars,) = marks(slope, Bars, 1)
    assert bars.y.sum() == pytest.approx(100.0)
    assert line(slope, "slope").y.tolist() == [16000.0, 16000.0, 25000.0, 25000.0, 29000.0, 29000.0]


def test_the_words_give_slopes_knees_and_reach() -> None:
    said = gears.words(curve())
    assert "16000 ± 160, then 25000 ± 250, then 29000 ± 900 N m/rad" in said
    assert "7.00 ± 0.20 and 25.0 ± 1.0 N m" in said
    assert "up to 60 N m" in said
    assert "N/m" in gears.words(replace(curve(), straight=True))
