"""Parameters of ros2_control: valid YAML with gains that are those of the cascade."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from strainwave.tune.closed_loop import Clock, low_pass, notch
from strainwave.tune.design import ServoDesign
from strainwave.tune.handover.texts import low_pass_hz, to_ros2_control


def parsed(text: str) -> dict[str, Any]:
    """Block mappings by two blanks; keys and values are scalars or lists of JSON, or words."""
    root: dict[str, Any] = {}
    levels = [root]
    for line in text.splitlines():
        content = line.split("  #")[0].rstrip()
        if not content or content.startswith("#"):
            continue
        depth, odd = divmod(len(content) - len(content.lstrip()), 2)
        key, colon, value = content.strip().partition(":")
        assert colon
        assert not odd
        assert depth < len(levels)
        del levels[depth + 1 :]
        name = scalar(key)
        assert name not in levels[depth], line
        levels[depth][name] = scalar(value.strip()) if value.strip() else {}
        if not value.strip():
            levels.append(levels[depth][name])
    return root


def scalar(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


def test_the_file_is_yaml(filtered: ServoDesign) -> None:
    """The check of this file agrees with PyYAML, which is not a dependency."""
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    text = to_ros2_control(filtered)
    assert yaml.safe_load(text) == parsed(text)


def test_the_controller_has_rate_joints_and_gains(design: ServoDesign) -> None:
    document = parsed(to_ros2_control(design))
    manager = document["controller_manager"]["ros__parameters"]
    assert manager["update_rate"] == 1000
    kind = "joint_trajectory_controller/JointTrajectoryController"
    assert manager["joint_trajectory_controller"]["type"] == kind
    controller = document["joint_trajectory_controller"]["ros__parameters"]
    assert controller["joints"] == ["joint1", "joint2"]
    assert controller["command_interfaces"] == ["effort"]
    for i, gains in enumerate(controller["gains"].values()):
        drive = design.arm.joint(i + 1)
        effort = drive.torque_per_command * design.limits[0] / abs(drive.gear_ratio)
        assert gains["u_clamp_max"] == -gains["u_clamp_min"] == gains["i_clamp"]
        assert gains["i_clamp"] == pytest.approx(effort)


@pytest.mark.parametrize("ratio", [0.01, -0.02])
def test_the_pid_is_the_cascade(design: ServoDesign, ratio: float) -> None:
    """Effort p e + i T sum e + d de/dt of the link, by the torque of the motor over n."""
    arm = design.arm.study.arm.with_joint(1, gear_ratio=ratio)
    source = replace(design.arm, study=replace(design.arm.study, arm=arm))
    document = parsed(to_ros2_control(replace(design, arm=source)))
    gains = document["joint_trajectory_controller"]["ros__parameters"]["gains"]["joint1"]
    T = design.clock.period
    z = np.exp(2j * np.pi * T * np.array([0.5, 5.0, 50.0, 200.0]))
    difference = (1.0 - 1.0 / z) / T
    effort = gains["p"] + gains["i"] / difference + gains["d"] * difference  # per link angle
    torque = arm.joints[0].torque_per_command * design.gains[0].law().feedback(z)
    np.testing.assert_allclose(effort * ratio * ratio, torque, rtol=1e-9)


def test_filters_are_noted_and_low_passes_replaced(filtered: ServoDesign) -> None:
    text = to_ros2_control(filtered)
    assert "# Omitted: filters of the input of joint 1:" in text
    document = parsed(text)
    entry = document["low_pass_1"]["ros__parameters"]
    chain = entry["filter_chain"]
    assert list(chain) == ["filter1"]
    assert chain["filter1"]["type"] == "control_filters/LowPassFilterDouble"
    params = chain["filter1"]["params"]
    assert params["sampling_frequency"] == 1000.0
    assert params["damping_frequency"] == low_pass_hz(filtered.gains[0].filters[1], 1e-3)


@pytest.mark.parametrize("hz", [20.0, 100.0, 190.0])
def test_the_substitute_delays_slow_signals_equally(hz: float) -> None:
    T = 1e-3
    one = low_pass(hz, T)
    corner = low_pass_hz(one, T)
    assert corner is not None
    a = np.exp(-2.0 * np.pi * corner * T)
    omega = 0.1  # [rad/s]
    z = np.array([np.exp(1j * omega * T)])
    substitute = (1.0 - a) / (z - a)  # y_k = (1 - a) x_k-1 + a y_k-1
    delays = [float(-np.angle(response)[0]) / omega for response in (substitute, one.response(z))]
    assert delays[0] == pytest.approx(delays[1], rel=1e-5)  # the phase is 1e-3 and smaller


def test_filters_without_substitute() -> None:
    assert low_pass_hz(low_pass(250.0, 1e-3), 1e-3) is None  # delays by less than a period
    assert low_pass_hz(notch(40.0, 0.5, 0.1, 1e-3), 1e-3) is None


def test_notes_name_the_assumptions(design: ServoDesign) -> None:
    plain = to_ros2_control(design)
    assert "update_rate is an integer" not in plain
    assert "couples" not in plain
    clocked = to_ros2_control(replace(design, clock=Clock(0.9e-3, 0.0)))
    assert "rounded from 1111.11 Hz" in clocked
    arm = design.arm.study.arm.with_joint(2, torque_per_volt="unknown", gear_ratio=0.01)
    source = replace(design.arm, study=replace(design.arm.study, arm=arm))
    unknown = to_ros2_control(replace(design, arm=source))
    assert "joint 2 is the input of the drive [V]" in unknown
    assert "# [V/rad]" in unknown


def test_gains_of_coupled_joints_are_those_of_the_motors(design: ServoDesign) -> None:
    arm = replace(design.arm.study.arm, coupling=((1.0, 0.0), (0.5, 1.0)))
    source = replace(design.arm, study=replace(design.arm.study, arm=arm))
    text = to_ros2_control(replace(design, arm=source))
    assert "couples joints" in text
    document = parsed(text)
    gains = document["joint_trajectory_controller"]["ros__parameters"]["gains"]["joint1"]
    assert gains["d"] == pytest.approx(arm.joints[0].torque_per_command * design.gains[0].kp)
