"""A serial arm from its study file to the verdict: two elastic joints under gravity."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from strainwave import Result, identify
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.io.study import read_study
from strainwave.virtual.experiments import simulate_study

_STUDY = """
[arm]
kind = "serial"
gravity = [0.0, 0.0, -9.81]

[[joint]]
spring = "linear"
gear_ratio = 0.01
torque_per_volt = 0.08
current_loop_hz = 1000.0
encoder_counts = 8192
imu = { xyz = [0.05, -0.07, 0.1], rpy = [0.0, 0.0, 0.6], accelerometer_hz = 300.0, gyro_hz = 100.0 }

[[joint]]
origin = { xyz = [0.1, 0.0, 0.2], rpy = [-1.5707963267948966, 0.0, 0.2] }
spring = "linear"
gear_ratio = -0.0125
torque_per_volt = 0.05
current_loop_hz = 1000.0
encoder_counts = 8192
imu = { xyz = [0.2, 0.05, 0.03], rpy = [0.4, 0.0, 0.3], accelerometer_hz = 300.0, gyro_hz = 100.0 }

[servo]
kind = "pi-velocity"
period = 0.001
kp = [0.1, 0.08]
ki = [1.0, 0.8]
limit = 10.0
position_gain = [5.0, 5.0]
"""

_RECORDS = (
    ("motion", "motion", None),
    ("motion-check", "check", None),
    ("prbs-1", "frequency", 1),
    ("prbs-2", "frequency", 2),
)


def _experiment(name: str, use: str, joint: int | None) -> str:
    lines = [f'name = "{name}"', f'file = "{name}.csv"', f'use = "{use}"']
    lines.append('control = ["servo", "servo"]')
    if joint is not None:
        lines.append(f"joint = {joint}")
        lines.append("prbs = { order = 10, clock = 0.001, periods = 2, amplitude = 5.0 }")
    return "\n[[experiment]]\n" + "\n".join(lines) + "\n"


def _truth(arm: Arm) -> Values:
    values: Values = dict.fromkeys(arm.parameter_names, 0.0)
    for joint, mass, along in ((1, 4.0, 0.02), (2, 3.0, 0.5)):
        body = {"mass": mass, "first_moment_x": along, "first_moment_y": 0.04}
        body |= {"first_moment_z": 0.03, "inertia_xx": 0.06, "inertia_yy": 0.24}
        body |= {"inertia_zz": 0.22, "inertia_xy": 0.01, "inertia_xz": -0.008, "inertia_yz": 0.004}
        values |= {(f"link_{name}", joint): value for name, value in body.items()}
        values |= {
            ("motor_inertia", joint): 1e-4 / joint,
            ("motor_viscous_friction", joint): 2e-4,
            ("motor_coulomb_friction", joint): 0.03 / joint,
            ("link_viscous_friction", joint): 0.4,
            ("gear_stiffness", joint): 9000.0 / joint,
            ("gear_damping", joint): 5.0,
        }
    return values


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Arm, Values]:
    folder = tmp_path_factory.mktemp("serial")
    path = folder / "study.toml"
    path.write_text(_STUDY + "".join(_experiment(*record) for record in _RECORDS))
    study = read_study(path, logs_exist=False)
    arm = Arm.of(study.arm)
    values = _truth(arm)
    simulate_study(study, values, folder / "run", noise=SensorNoise(), as_recorded=False)
    return identify(folder / "run" / "study.toml"), arm, values


def test_gears_and_motors_are_accurate(identified: tuple[Result, Arm, Values]) -> None:
    result, _, values = identified
    assert result.status == "determined", result.reason
    tolerances = {"gear_stiffness": 0.003, "motor_inertia": 0.003, "motor_coulomb_friction": 0.005}
    for name, tolerance in (*tolerances.items(), ("gear_damping", 0.03)):
        for joint in (1, 2):
            estimate, truth = result[name, joint].value, values[name, joint]
            assert estimate == pytest.approx(truth, rel=tolerance), (name, joint)


def test_base_parameters_are_accurate_and_covered(
    identified: tuple[Result, Arm, Values],
) -> None:
    result, arm, values = identified
    truths = {column.key: value_of(column.parts, values) for column in arm.base.columns}
    outside = 0
    for column in arm.base.columns:
        same_unit = [abs(truths[c.key]) for c in arm.base.columns if c.unit == column.unit]
        estimate = result[column.key]
        assert estimate.value is not None, column.label
        assert abs(estimate.value - truths[column.key]) < 0.01 * max(same_unit), column.label
        low, high = estimate.ci95 or (0.0, 0.0)
        outside += not low <= truths[column.key] <= high
    assert outside <= 2  # of 95 % intervals


def test_the_published_bodies_have_the_base_parameters(
    identified: tuple[Result, Arm, Values], tmp_path: Path
) -> None:
    result, _, _ = identified
    result.save(tmp_path / "result.json")
    document = json.loads((tmp_path / "result.json").read_text())
    bodies = document["standard_parameters"]
    assert document["base_parameters"]
    for entry in document["base_parameters"]:
        total = sum(weight * bodies[name] for name, weight in entry["combination"].items())
        assert total == pytest.approx(entry["value"], abs=0.5 * entry["std"] + 1e-9), entry["name"]
