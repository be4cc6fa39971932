"""Types of link sensors in the fit: a joint torque sensor, and a type from outside the package."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pytest

from extensions import added
from strainwave.domain import ArmModel, Channel, Joint, Log
from strainwave.domain.arm import link_sensors
from strainwave.domain.arm.link_sensors import LinkSensor, optional_constants
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.arm.parameters import parameter_descriptions
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm import fit_whole_arm
from tuning_runs import joint_models, rigid_model, shaken_study, simulated_logs, truth

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))
GEARS = ("gear_stiffness", "gear_damping", "motor_inertia", "link_inertia")


@dataclass(frozen=True)
class FastGyro(LinkSensor):
    """A second gyro with a bandwidth of its own, with the minimum of definitions."""

    hz: float | None = 60.0

    name = "fast_gyro"
    noun = "fast gyro"
    channel_kinds = ("spin",)
    unit = "rad/s"
    measurand = "link rate"
    by_channel = True

    @classmethod
    def of_joint(cls, joint: Joint) -> Self:
        return cls()

    def quantities(self) -> tuple[Quantity, ...]:
        return ("angular_rate_z",)

    def low_passes(self) -> Mapping[str, float | None]:
        return {"imu_gyro_hz": self.hz}


@pytest.fixture
def registered() -> Iterator[type[FastGyro]]:
    with added(link_sensors.TYPES, FastGyro):
        yield FastGyro


def fit(kind: str, noise: float, scale: float = 1.0) -> tuple[ArmModel, Values, tuple[Log, ...]]:
    """Fit to open-loop records of 0.5 s with one sensor on each link; the first has a scale."""
    study, true_values = truth()
    joints = (replace(j, accelerometer_distance=None, gyro_hz=None) for j in study.arm.joints)
    channels = {f"{kind}{i}": Channel(f"{kind}{i}") for i in (1, 2)}
    study = replace(study, arm=study.arm.with_joints(joints), channels=channels)
    _, logs = simulated_logs(shaken_study(study, 10.0), true_values, noise=SensorNoise())
    rng = np.random.default_rng(3)
    records = []
    for log in logs:
        size = len(log)
        read = {name: log.channels[name] + rng.normal(0.0, noise, size) for name in channels}
        read[f"{kind}1"] = scale * read[f"{kind}1"]
        records.append(replace(log, channels={**log.channels, **read}))
    models = joint_models(study, true_values, 0.05, FACTORS)
    rigid = rigid_model(study, true_values, 0.01, 1.0)
    return fit_whole_arm(records, rigid, models, Arm.of(study.arm)), true_values, logs


def check(model: ArmModel, true_values: Mapping[tuple[str, int | None], float]) -> None:
    """Check that the gears agree with the true values within four standard deviations."""
    assert model.status == "converged"
    assert not [w for w in model.warnings if w.code == "residual-not-noise"]
    for p in model.parameters:
        if p.name in GEARS:
            assert p.value is not None
            assert p.std is not None
            assert p.std < 5e-3 * p.value, p
            assert abs(p.value - true_values[p.name, p.joint]) < 4.0 * p.std, p


def test_a_joint_torque_sensor_identifies_the_gears() -> None:
    model, true_values, _ = fit("tau_l", 0.0)
    check(model, true_values)
    assert {"tau_l1", "tau_l2"} <= set(next(iter(model.fit_percent.values())))


def test_a_type_from_elsewhere_is_simulated_and_fitted(registered: type[FastGyro]) -> None:
    model, true_values, logs = fit("spin", 2e-3, scale=1.03)
    assert "fast_gyro_delay" in optional_constants()
    assert {"spin1", "spin2"} <= set(logs[0].channels)
    check(model, true_values)
    sensed = {(p.name, p.joint): p for p in model.parameters if registered.name in p.name}
    assert set(sensed) == {("fast_gyro_scale", 1)}
    assert sensed["fast_gyro_scale", 1].value == pytest.approx(1.03, abs=2e-3)
    (warning,) = [w for w in model.warnings if w.code == "sensor-scale"]
    assert warning.message.startswith("the fast gyro reads 1.03")
    assert (
        parameter_descriptions()["fast_gyro_scale"].description == "scale factor of the fast gyro"
    )
