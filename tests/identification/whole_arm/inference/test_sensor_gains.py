"""Predicted benefit of an additional link sensor, against the actual one on a virtual arm."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from strainwave.domain import ArmModel, Log, Parameter
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm import fit_whole_arm
from tuning_runs import joint_models, rigid_model, shaken

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))
GEARS = [(name, joint) for name in ("gear_stiffness", "gear_damping") for joint in (1, 2)]


def without_links(logs: tuple[Log, ...], joints: set[int]) -> list[Log]:
    """Records without the link channels of some joints."""
    removed = {f"{name}{i}" for name in ("a", "gyro") for i in joints}
    return [
        replace(log, channels={n: x for n, x in log.channels.items() if n not in removed})
        for log in logs
    ]


@cache
def whole_arm(*missing: int, spring: str = "linear") -> ArmModel:
    study, true_values, logs = shaken(spring)
    records = without_links(logs, set(missing))
    joints = joint_models(study, true_values, 0.05, FACTORS)
    return fit_whole_arm(
        records, rigid_model(study, true_values, 0.01, 1.0), joints, Arm.of(study.arm)
    )


def std_of(model: ArmModel, name: str, joint: int) -> float:
    parameters: dict[tuple[str, int | None], Parameter] = {
        (p.name, p.joint): p for p in model.parameters
    }
    std = parameters[name, joint].std
    assert std is not None
    return std


def predicted(model: ArmModel, link: int, name: str, joint: int) -> float:
    gains = [
        g.predicted_std
        for g in model.sensor_gains
        if (g.sensor, g.link, g.name, g.joint) == ("accelerometer", link, name, joint)
    ]
    assert len(gains) == 1
    return gains[0]


@pytest.mark.parametrize("link", [1, 2])
def test_an_additional_accelerometer_gives_the_predicted_gain(link: int) -> None:
    without, with_it = whole_arm(1, 2), whole_arm(3 - link)
    ratios = [predicted(without, link, *gear) / std_of(with_it, *gear) for gear in GEARS]
    assert all(1.0 / 1.5 < ratio < 1.5 for ratio in ratios), ratios


def test_an_accelerometer_at_a_still_point_gives_no_gain() -> None:
    """At 0.27 m, the accelerometer is near the centre of percussion of the second link."""
    without, with_it = whole_arm(1, 2), whole_arm(1)
    for gear in GEARS:
        assert predicted(without, 2, *gear) > 0.8 * std_of(without, *gear)
        assert std_of(with_it, *gear) > 0.8 * std_of(without, *gear)


def test_a_link_with_a_sensor_needs_no_other() -> None:
    assert whole_arm().sensor_gains == ()
    assert {gain.link for gain in whole_arm(1).sensor_gains} == {1}


def test_no_sensor_makes_an_interval_wider() -> None:
    gains = whole_arm(1, 2).sensor_gains
    assert {gain.sensor for gain in gains} == {"accelerometer", "link-encoder", "gyro"}
    assert all(0.0 < gain.predicted_std <= gain.std for gain in gains)
