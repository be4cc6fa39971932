"""Objects of python-control against the control law."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from servo_arms import correct, predict
from strainwave.domain.arm.description import INPUTS
from strainwave.errors import InvalidInput
from strainwave.tune.design import ServoDesign
from strainwave.tune.handover import controllers, observers


def test_controllers_have_the_response_of_the_law(filtered: ServoDesign) -> None:
    pytest.importorskip("control", reason="python-control is not installed")
    period = filtered.clock.period
    z = np.exp(2j * np.pi * period * np.array([0.5, 5.0, 40.0, 100.0, 300.0]))
    for number, (gains, system) in enumerate(
        zip(filtered.gains, controllers(filtered), strict=True), start=1
    ):
        assert system.name == f"servo_{number}"
        assert system.dt == period
        assert system.input_labels == list(INPUTS)
        assert system.output_labels == ["voltage"]
        assert len(system.state_labels) == len(gains.law().A)
        np.testing.assert_allclose(-system(z)[0, 2], gains.law().feedback(z), rtol=1e-9)
        np.testing.assert_allclose(-system(z)[0, 2], gains.response(z), rtol=1e-9)


def test_observers_respond_as_their_recursion(design: ServoDesign) -> None:
    control = pytest.importorskip("control", reason="python-control is not installed")
    rng = np.random.default_rng(3)
    for observer, system in zip(design.observers, observers(design), strict=True):
        inputs = rng.normal(size=(50, len(observer.system.inputs)))
        x, expected = np.zeros(len(observer.A)), []
        for voltage, torque, *readings in inputs:
            estimate = correct(observer, x, np.array(readings), torque)
            expected.append(estimate[2:4])
            x = predict(observer, estimate, voltage, torque)
        response = control.forced_response(system, inputs=inputs.T)
        assert system.output_labels == ["link_angle", "link_velocity"]
        np.testing.assert_allclose(response.outputs.T, expected, rtol=1e-9, atol=1e-9)


def test_without_python_control_the_message_has_the_command(
    design: ServoDesign, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(InvalidInput, match=r"Remedy: pip install control\."):
        controllers(design)
