"""Charts of results side by side: models of one joint."""

from __future__ import annotations

import numpy as np
import pytest

from figure_parts import line, marks, names
from strainwave.dynamics.two_inertia import TwoInertia
from strainwave.report.figures import Markers
from strainwave.report.figures.comparison import poles_and_zeros, ratios, step_responses
from strainwave.report.figures.curves import Curve

JOINT = TwoInertia(1e-4, 1e-3, 2.0, 0.0, 800.0, 1.0, 0.01)


def test_zeros_are_those_of_the_link_on_the_spring() -> None:
    figure = poles_and_zeros({"a": JOINT})
    poles, zeros = marks(figure, Markers)
    assert names(figure) == ["a, poles", "a, zeros"]
    assert len(poles.x) == 3
    modulus = np.abs(np.asarray(zeros.x) + 1j * zeros.y)
    assert modulus == pytest.approx(np.sqrt([800.0 / 2.0] * 2))


def test_a_step_accelerates_the_motor_first() -> None:
    motor, link = (line(step_responses({"a": JOINT}), "a", panel) for panel in (0, 1))
    assert motor.y[0] == link.y[0] == 0.0
    assert motor.y[1] / motor.x[1] == pytest.approx(1.0 / JOINT.motor_inertia, rel=0.1)
    assert link.y[1] < 1e-3 * motor.y[1]


def test_a_step_ends_at_the_velocity_that_friction_allows() -> None:
    joint = TwoInertia(1e-4, 0.2, 1e-4, 0.0, 800.0, 0.1, 1.0)
    motor, link = (line(step_responses({"a": joint}), "a", panel) for panel in (0, 1))
    assert motor.y[-1] == pytest.approx(5.0, rel=1e-2)
    assert link.y[-1] == pytest.approx(5.0, rel=1e-2)


def test_ratios_are_at_the_frequencies_of_the_first() -> None:
    f = np.geomspace(1.0, 100.0, 20)
    first = Curve("a", f, (1.0 / (1j * f)).astype(np.complex128))
    second = Curve("b", 2.0 * f, (0.25 / (1j * f)).astype(np.complex128))  # half as large
    one, half = ratios([first, second])
    assert one.response.tolist() == [1.0] * 20
    assert half.frequencies_hz.min() >= 2.0
    assert half.response == pytest.approx(np.full(len(half.response), 0.5))
