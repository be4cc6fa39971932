"""Stiffness curves: torsion and stiffness are consistent, and so are their bands and knees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_results import curve_parameters, elastic_identification, joint_model
from figure_parts import line, marks
from strainwave.domain import FloatArray
from strainwave.report.document import gears
from strainwave.report.document.gears import StiffnessCurve
from strainwave.report.figures import Bars, Markers


def curve() -> StiffnessCurve:
    gear = gears.stiffness_curves(elastic_identification())
    assert [one.joint for one in gear] == [1]  # joint 2 has no identified parameter
    return gear[0]


def test_the_torsion_integrates_the_compliance() -> None:
    torque: FloatArray = np.linspace(0.0, 60.0, 6001)
    gear = curve()
    torsion = gear.law.torsion(gear.values, torque)
    slope = np.gradient(torque, torsion)
    for low, high, expected in ((0.0, 6.9, 16000.0), (7.1, 24.9, 25000.0), (25.1, 60.0, 29000.0)):
        inside = (torque > low) & (torque < high)
        assert slope[inside] == pytest.approx(expected, rel=1e-9)


def test_unidentified_parameters_are_not_drawn() -> None:
    one = elastic_identification()
    assert one.whole_arm is not None
    parameters, covariance = curve_parameters(gear_stiffness_k3=None, gear_knee_t2=None)
    two = replace(
        one, whole_arm=replace(one.whole_arm, parameters=parameters, covariance=covariance)
    )
    gear = gears.stiffness_curves(two)[0]
    assert gear.values == {
        "gear_stiffness_k1": 16000.0,
        "gear_stiffness_k2": 25000.0,
        "gear_knee_t1": 7.0,
    }
    assert gear.knees.tolist() == [7.0]
    assert gear.covariance.shape == (3, 3)


def test_without_a_whole_arm_fit_one_stiffness_is_drawn() -> None:
    gear = gears.stiffness_curves(replace(elastic_identification(), whole_arm=None))[0]
    assert gear.values == {"gear_stiffness": 25000.0}
    assert gear.is_equivalent
    assert gear.covariance[0, 0] == pytest.approx(joint_model().covariance[4, 4])
    assert gear.loads is None
    assert "One equivalent stiffness" in gears.describe(gear)
    assert len(gears.stiffness_figure(gear).panels) == 1


def test_knees_are_vertices_of_both_curves() -> None:
    slope, torsion = gears.stiffness_figure(curve()), gears.torsion_figure(curve())
    assert [one.x for one in slope.uprights] == [7.0, 25.0]
    knees = [1e3 * 7.0 / 16000.0, 1e3 * (7.0 / 16000.0 + 18.0 / 25000.0)]
    (markers,) = marks(torsion, Markers)
    assert np.asarray(markers.x) == pytest.approx(knees)
    assert markers.y.tolist() == [7.0, 25.0]
    figure = line(torsion, "identified curve")
    for x, y in zip(knees, (7.0, 25.0), strict=True):
        vertex = np.argmin(np.abs(figure.y - y))
        assert (figure.x[vertex], figure.y[vertex]) == (pytest.approx(x), pytest.approx(y))
    (bars,) = marks(slope, Bars, 1)
    assert bars.y.sum() == pytest.approx(100.0)
    assert line(slope, "stiffness").y.tolist() == [
        16000.0,
        16000.0,
        25000.0,
        25000.0,
        29000.0,
        29000.0,
    ]


def test_the_caption_has_slopes_knees_and_the_largest_torque() -> None:
    caption = gears.describe(curve())
    assert "16000 ± 160, then 25000 ± 250, then 29000 ± 900 N m/rad" in caption
    assert "7.00 ± 0.20 and 25.0 ± 1.0 N m" in caption
    assert "largest gear torque in the records is 60 N m" in caption
    assert "N/m" in gears.describe(replace(curve(), is_prismatic=True))


def test_a_knee_above_the_largest_torque_is_not_part_of_the_curve() -> None:
    short = replace(curve(), largest_torque=20.0)
    figure = line(gears.torsion_figure(short), "identified curve")
    assert figure.y.max() == pytest.approx(20.0)
    assert (np.diff(figure.x) >= 0.0).all()
