"""One arm, simulated once; every test alters its logs or its study."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from consistency_inputs import Input
from strainwave.dynamics.simulation import SensorNoise
from strainwave.io.logs import read_logs
from strainwave.io.study import read_study
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study


@pytest.fixture(scope="session", params=["horizontal", "vertical"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Input:
    """A motion and, open loop, a PRBS record of the built-in rig with linear springs."""
    folder: Path = tmp_path_factory.mktemp(request.param)
    study = scara.study(folder, "linear")
    values = scara.parameters(3, "linear")
    if request.param == "vertical":
        study = replace(study, arm=replace(study.arm, gravity=9.81))
        values["gravity_torque_1", None] = 45.0
        values["gravity_torque_2", None] = 9.81 * values["gamma", None] / scara.LINK_LENGTH[0]
    wanted = {"motion", "motion-check"} | ({"prbs-j1"} if request.param == "horizontal" else set())
    kept = tuple(e for e in study.experiments if e.name in wanted)
    simulate_study(
        replace(study, experiments=kept), values, folder, noise=SensorNoise(), as_recorded=False
    )
    written = read_study(folder / "study.toml")
    return read_logs(written), written


@pytest.fixture(scope="session")
def small_arm() -> Input:
    """The small arm of the repository, which is not made by the program's own simulator."""
    study = read_study(Path(__file__).parents[2] / "data" / "small-arm" / "study.toml")
    return read_logs(study), study
