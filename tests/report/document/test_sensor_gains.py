"""Predicted benefit of link sensors, stated only where it is significant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from results import arm_model, identification
from strainwave.domain import Identification, Parameter, SensorGain
from strainwave.io.results import to_document
from strainwave.report.document import render
from strainwave.report.document.rig import gain_sentences

STIFFNESS = Parameter("gear_stiffness", 2, 6100.0, 28.0, "N m/rad", "tuned", (6045.0, 6155.0))
DAMPING = Parameter("gear_damping", 2, 4.0, 0.08, "N m s/rad", "tuned", (3.84, 4.16))


def gain(parameter: Parameter, share: float, sensor: str, link: int) -> SensorGain:
    assert parameter.value is not None
    assert parameter.std is not None
    return SensorGain(
        sensor,
        link,
        "some data sheet",
        parameter.name,
        parameter.joint,
        parameter.value,
        parameter.std,
        share * parameter.std,
    )


def run_with(*gains: SensorGain) -> Identification:
    parameters = (STIFFNESS, DAMPING)
    covariance = np.diag([p.std**2 for p in parameters if p.std is not None])
    whole_arm = replace(arm_model(parameters, covariance), sensor_gains=gains)
    return replace(identification(), whole_arm=whole_arm, stages=("rigid", "decoupled", "tuned"))


def test_the_largest_improvement_is_first() -> None:
    gains = [gain(p, 0.22, "accelerometer", 2) for p in (STIFFNESS, DAMPING)]
    (clause,) = gain_sentences(run_with(*gains))
    assert clause == (
        "an accelerometer on link 2 (some data sheet) would shrink the 95 % half-width of"
        " gear_damping 2 from 3.9 to 0.86 %, and of gear_stiffness 2 from 0.9 to 0.2 %"
    )


def test_each_kind_of_sensor_is_named_on_its_best_link() -> None:
    gains = [
        gain(STIFFNESS, 0.5, "accelerometer", 1),
        gain(STIFFNESS, 0.2, "accelerometer", 2),
        gain(STIFFNESS, 0.6, "gyro", 1),
    ]
    first, second = gain_sentences(run_with(*gains))
    assert first.startswith("an accelerometer on link 2")
    assert second.startswith("a gyro on link 1")


def test_a_small_improvement_is_not_listed() -> None:
    narrow = replace(gain(STIFFNESS, 0.1, "accelerometer", 2), std=1.0, predicted_std=0.1)
    assert gain_sentences(run_with(gain(STIFFNESS, 0.7, "gyro", 2), narrow)) == []
    assert gain_sentences(run_with()) == []


def test_report_and_result_have_the_improvement() -> None:
    run = run_with(gain(STIFFNESS, 0.22, "accelerometer", 2))
    assert "half-width of gear_stiffness 2 from 0.9 to 0.2 %" in render(run)
    (entry,) = to_document(run)["stages"]["tuned"]["sensor_gains"]
    assert entry["name"] == "gear_stiffness"
    assert entry["predicted_std"] == 0.22 * 28.0
