"""Limits of motor encoders: reasons for uncertain gear parameters, on arms chosen accordingly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import ArmModel
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm import fit_whole_arm
from strainwave.virtual.experiments import derived
from tuning_runs import joint_models, rigid_model, shaken_study, simulated_logs, truth

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))
CODE = "motor-side-limit"


def said(
    name: str, factor: float, counts: float, amplitude: float = 4.0, *, sensors: bool = False
) -> dict[str, list[str]]:
    """Messages per joint; one parameter of joint 1 is a multiple of that of the rig."""
    study, values = truth()
    values = derived(values | {(name, 1): factor * values[name, 1]}, study.arm)
    joints = tuple(replace(joint, encoder_counts=counts) for joint in study.arm.joints)
    short_study = shaken_study(
        replace(study, arm=replace(study.arm, joints=joints)), amplitude, order=8
    )
    study, logs = simulated_logs(short_study, values, noise=SensorNoise())
    if not sensors:
        motor = ("u1", "u2", "theta_m1", "theta_m2")
        logs = tuple(replace(log, channels={c: log.channels[c] for c in motor}) for log in logs)
    model = fit_whole_arm(
        logs,
        rigid_model(study, values, 0.01),
        joint_models(study, values, 0.02, FACTORS),
        Arm.of(study.arm),
    )
    return by_place(model)


def by_place(model: ArmModel) -> dict[str, list[str]]:
    messages: dict[str, list[str]] = {}
    for warning in model.warnings:
        if warning.code == CODE:
            messages.setdefault(warning.where, []).append(warning.message)
    return messages


@pytest.mark.parametrize(
    ("name", "factor", "counts", "reason"),
    [
        ("gear_stiffness", 100.0, 2000.0, "the gear is very stiff: its resonance, 2"),
        ("gear_damping", 60.0, 2000.0, "the gear is very damped: with a damping ratio of 3"),
        ("gear_stiffness", 1.0, 500.0, "the rounding of its 500 counts per turn"),
    ],
)
def test_a_gear_that_is_known_badly_has_the_reason(
    name: str, factor: float, counts: float, reason: str
) -> None:
    assert any(reason in text for text in said(name, factor, counts)["joint 1"])


def test_an_ordinary_gear_has_no_such_reason() -> None:
    """Only the individual viscous frictions are not identifiable."""
    texts = [
        text for messages in said("gear_stiffness", 1.0, 8192.0, 10.0).values() for text in messages
    ]
    assert texts
    assert all("only the sum d_M + n^2 d_L" in text for text in texts)
    assert not any("gear" in text for text in texts)


def test_links_with_sensors_have_no_warning() -> None:
    assert said("gear_stiffness", 1.0, 500.0, sensors=True) == {}
