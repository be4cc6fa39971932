"""Simulated arms with fault-free input. Each test changes the logs or the study."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from consistency_inputs import Input
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.dynamics.simulation import SensorNoise
from strainwave.io.logs import read_logs
from strainwave.io.study import read_study
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study


def _simulated(folder: Path, *, vertical: bool) -> Input:
    """Simulate motion of the built-in arm with linear springs, and PRBS if horizontal."""
    study = scara.STIFF.study(folder, "linear")
    values = scara.STIFF.parameters(3, "linear")
    if vertical:
        study = replace(study, arm=change_arm_keys(study.arm, gravity=9.81))
        values["gravity_torque_1", None] = 45.0
        values["gravity_torque_2", None] = 9.81 * values["gamma", None] / scara.STIFF.link_length[0]
    names = {"motion", "motion-check"} if vertical else {"motion", "prbs-j1", "prbs-j2"}
    experiments = tuple(e for e in study.experiments if e.name in names)
    simulate_study(
        replace(study, experiments=experiments),
        values,
        folder,
        noise=SensorNoise(),
        as_recorded=False,
    )
    simulated = read_study(folder / "study.toml")
    return read_logs(simulated), simulated


@pytest.fixture(scope="session")
def horizontal_arm(tmp_path_factory: pytest.TempPathFactory) -> Input:
    """Arm without gravity: a motion record and a PRBS record of each joint."""
    return _simulated(tmp_path_factory.mktemp("horizontal"), vertical=False)


@pytest.fixture(scope="session")
def vertical_arm(tmp_path_factory: pytest.TempPathFactory) -> Input:
    """Arm with gravity: motion records only."""
    return _simulated(tmp_path_factory.mktemp("vertical"), vertical=True)


@pytest.fixture(scope="session", params=["horizontal", "vertical"])
def arm(request: pytest.FixtureRequest) -> Input:
    """Run the test on the horizontal and on the vertical arm."""
    selected: Input = request.getfixturevalue(f"{request.param}_arm")
    return selected


@pytest.fixture(scope="session")
def small_arm() -> Input:
    """Small arm of the repository, simulated with an independent simulator."""
    study = read_study(Path(__file__).parents[1] / "data" / "small-arm" / "study.toml")
    return read_logs(study), study
