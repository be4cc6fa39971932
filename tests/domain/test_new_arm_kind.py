"""A kind of arm from outside: one class, without a program of its own in the core."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from extensions import added
from strainwave import identify
from strainwave.domain import ArmDescription, Joint, Origin, Servo
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.kinds import KINDS, Fault, Kind
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.io.study import read_study
from strainwave.virtual.experiments import simulate_study

STUDY = """
[arm]
kind = "pan-tilt"
height = 0.3

[[joint]]
spring = "rigid"
gear_ratio = -0.01
torque_per_volt = 0.08
encoder_counts = 8192

[[joint]]
spring = "rigid"
gear_ratio = 0.02
torque_per_volt = 0.05
encoder_counts = 8192

[servo]
kind = "pi-velocity"
period = 0.001
kp = [0.12, 0.1]
ki = [1.5, 1.5]
limit = 10.0

[[experiment]]
name = "motion"
file = "motion.csv"
use = "motion"
control = ["servo", "servo"]
"""


@dataclass(frozen=True, slots=True)
class PanTiltTable:
    height: float  # [m] of axis 2 above the base


class PanTilt(Kind[PanTiltTable]):
    """A vertical axis, and a horizontal one above it."""

    name = "pan-tilt"
    table = PanTiltTable

    def faults(self, table: PanTiltTable, joints: Sequence[Joint]) -> Iterator[Fault]:
        if len(joints) != 2:
            yield Fault("a pan-tilt arm has two joints", "describe both", "joint")

    def construct(
        self, table: PanTiltTable, joints: Sequence[Joint], servo: Servo | None = None
    ) -> ArmDescription:
        origin = Origin((0.0, 0.0, table.height), (0.5 * np.pi, 0.0, 0.0))
        placed = (joints[0], replace(joints[1], origin=origin))
        return ArmDescription(self.name, placed, (0.0, 0.0, -9.81), servo=servo)

    def table_of(self, arm: ArmDescription) -> PanTiltTable:
        return PanTiltTable(arm.joints[1].origin.xyz[2])


@pytest.fixture
def registered() -> Iterator[None]:
    with added(KINDS, PanTilt()):
        yield


@pytest.mark.usefixtures("registered")
def test_a_new_kind_is_read_simulated_and_identified(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    study = read_study(path, logs_exist=False)
    arm = Arm.of(study.arm)
    values: Values = dict.fromkeys(arm.parameter_names, 0.0)
    body = {"mass": 3.0, "first_moment_x": 0.2, "first_moment_y": 0.05, "first_moment_z": 0.02}
    body |= {"inertia_xx": 0.1, "inertia_yy": 0.16, "inertia_zz": 0.14, "inertia_xy": 0.01}
    for joint in (1, 2):
        values |= {(f"link_{name}", joint): value for name, value in body.items()}
        values |= {("motor_inertia", joint): 1e-4, ("motor_viscous_friction", joint): 2e-4}
        values["motor_coulomb_friction", joint] = 0.03
    simulate_study(study, values, tmp_path / "run", as_recorded=False)
    result = identify(tmp_path / "run" / "study.toml", stages=("rigid",))
    for column in arm.rigid_columns:
        estimate = result[column.name, column.joint]
        truth = value_of(column.parts, values)
        assert estimate.value is not None, str(column)
        scale = max(abs(truth), 0.02)
        assert abs(estimate.value - truth) < 0.02 * scale, (str(column), estimate.value, truth)
