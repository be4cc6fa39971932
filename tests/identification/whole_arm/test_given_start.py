"""`identify --start`: values at which the whole-arm fit starts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import strainwave as sw
from strainwave.domain.keys import Values
from strainwave.dynamics.simulation import SensorNoise
from strainwave.errors import InvalidInput
from strainwave.pipeline.inputs import read_start
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study

HELD = ("gear_damping 1", "gear_damping 2")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("start")
    study = scara.STIFF.study(folder, "linear")
    values = scara.STIFF.parameters(spring="linear")
    simulate_study(study, values, folder, noise=SensorNoise(), as_recorded=False)
    return folder / "study.toml"


def test_held_parameters_stay_at_the_given_values(path: Path) -> None:
    start: Values = {("gear_damping", 1): 7.5, ("gear_damping", 2): 4.25}
    # a few iterations move each parameter that is not held
    options = {"tuning": {"hold": list(HELD), "rival_effort": 0.0, "max_iterations": 3}}
    result = sw.identify(path, start=start, options=options)
    fit = result.run
    assert fit is not None
    assert fit.whole_arm is not None
    values = dict(fit.whole_arm.values)
    assert values["gear_damping", 1] == pytest.approx(7.5)
    assert values["gear_damping", 2] == pytest.approx(4.25)


def test_the_minimum_does_not_depend_on_the_start(path: Path) -> None:
    usual = sw.identify(path)
    far = {key: 1.15 * value for key, value in scara.STIFF.parameters(spring="linear").items()}
    moved = sw.identify(path, start=far)
    for p in usual:
        if p.value and p.std:
            other = moved[p.key].value
            assert other == pytest.approx(p.value, abs=0.1 * p.std)


def test_a_result_is_a_start_and_foreign_values_are_refused(path: Path, tmp_path: Path) -> None:
    study = sw.read_study(path)
    sw.identify(path, stages=("rigid", "decoupled")).save(tmp_path / "result.json")
    start = read_start(tmp_path / "result.json", study)
    assert ("gear_stiffness", 1) in start
    assert ("link_inertia", 1) not in start
    (tmp_path / "other.json").write_text(json.dumps({"parameters": [{"name": "x", "value": 1.0}]}))
    with pytest.raises(InvalidInput, match="no value is a parameter"):
        read_start(tmp_path / "other.json", study)
