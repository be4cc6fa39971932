"""Confidence intervals predicted before the experiment, against those of fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import Log, Parameter, Study
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm import fit_whole_arm, predicted_parameters
from tuning_runs import joint_models, rigid_model, shaken

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))
MOTOR = ("u1", "u2", "theta_m1", "theta_m2")


def replace_records(study: Study, logs: tuple[Log, ...], channels: tuple[str, ...]) -> list[Log]:
    return [replace(log, channels={c: log.channels[c] for c in channels}) for log in logs]


def relative(parameters: tuple[Parameter, ...]) -> dict[tuple[str, int | None], float]:
    """Relative standard deviations of gears and inertias."""
    prefixes = ("gear_", "motor_inertia", "link_inertia")
    return {
        (p.name, p.joint): p.std / p.value
        for p in parameters
        if p.name.startswith(prefixes) and p.value and p.std
    }


@pytest.mark.parametrize("spring", ["linear", "three-slope"])
@pytest.mark.parametrize("channels", [MOTOR, (*MOTOR, "a1", "a2")])
def test_a_fit_s_intervals_are_those_predicted(spring: str, channels: tuple[str, ...]) -> None:
    study, true_values, logs = shaken(spring)
    records = replace_records(study, logs, channels)
    predicted = relative(predicted_parameters(records, Arm.of(study.arm), true_values))
    joints = joint_models(study, true_values, 0.02, FACTORS)
    estimated = relative(
        fit_whole_arm(
            records, rigid_model(study, true_values, 0.002), joints, Arm.of(study.arm)
        ).parameters
    )
    shared = predicted.keys() & estimated.keys()
    assert len(shared) >= 8
    for key in shared:
        # integration errors and model errors make the intervals of a fit slightly wider
        assert 0.5 < predicted[key] / estimated[key] < 1.5, key


def test_without_link_sensors_gears_are_known_less_well() -> None:
    study, known_values, logs = shaken()
    motor_only, with_accelerometers = (
        relative(
            predicted_parameters(
                replace_records(study, logs, channels), Arm.of(study.arm), known_values
            )
        )
        for channels in (MOTOR, (*MOTOR, "a1", "a2"))
    )
    for joint in (1, 2):
        assert (
            motor_only["gear_stiffness", joint] > 1.5 * with_accelerometers["gear_stiffness", joint]
        )
        assert motor_only["gear_damping", joint] > 1.5 * with_accelerometers["gear_damping", joint]


def test_records_without_gear_excitation_give_no_prediction() -> None:
    study, true_values, logs = shaken()
    motion = [replace(log, experiment=replace(log.experiment, use="motion")) for log in logs]
    assert predicted_parameters(motion, Arm.of(study.arm), true_values) == ()
