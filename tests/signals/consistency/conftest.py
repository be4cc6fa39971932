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


def _simulated(folder: Path, *, vertical: bool) -> Input:
    """Motions and, of the horizontal arm, a PRBS record of the built-in rig with linear springs."""
    study = scara.study(folder, "linear")
    values = scara.parameters(3, "linear")
    if vertical:
        study = replace(study, arm=replace(study.arm, gravity=9.81))
        values["gravity_torque_1", None] = 45.0
        values["gravity_torque_2", None] = 9.81 * values["gamma", None] / scara.LINK_LENGTH[0]
    wanted = {"motion", "motion-check"} | (set() if vertical else {"prbs-j1", "prbs-j2"})
    kept = tuple(e for e in study.experiments if e.name in wanted)
    simulate_study(
        replace(study, experiments=kept), values, folder, noise=SensorNoise(), as_recorded=False
    )
    written = read_study(folder / "study.toml")
    return read_logs(written), written


@pytest.fixture(scope="session")
def horizontal_arm(tmp_path_factory: pytest.TempPathFactory) -> Input:
    """Without gravity, with a PRBS record of either joint."""
    return _simulated(tmp_path_factory.mktemp("horizontal"), vertical=False)


@pytest.fixture(scope="session")
def vertical_arm(tmp_path_factory: pytest.TempPathFactory) -> Input:
    """Under gravity, with motions alone."""
    return _simulated(tmp_path_factory.mktemp("vertical"), vertical=True)


@pytest.fixture(scope="session", params=["horizontal", "vertical"])
def arm(request: pytest.FixtureRequest) -> Input:
    """Either arm."""
    given: Input = request.getfixturevalue(f"{request.param}_arm")
    return given


@pytest.fixture(scope="session")
def small_arm() -> Input:
    """The small arm of the repository, which is not made by the program's own simulator."""
    study = read_study(Path(__file__).parents[2] / "data" / "small-arm" / "study.toml")
    return read_logs(study), study
